//! The log lines about links that come up and go down: each of them, until a link does so too often; then one line a minute.

use std::collections::BTreeMap;

use posebridge_telemetry::{HostClock, LinkId, LinkState, TimeDelta, Timestamp};

/// The period of the limit, and of the summaries.
const PERIOD: TimeDelta = TimeDelta::from_millis(60_000);
/// Lines of one link in a period: three losses and returns, each loss with a second reason.
const MAX_LINES: u32 = 9;

/// Decides which changes of links are logged.
#[derive(Debug, Default)]
pub struct LinkLog(BTreeMap<LinkId, RecentChanges>);

#[derive(Debug)]
struct RecentChanges {
    period_start: Timestamp<HostClock>,
    logged: u32,
    /// Losses that were not logged, and the state after the last change that was not.
    suppressed_losses: u64,
    suppressed_state: Option<LinkState>,
}

impl LinkLog {
    /// Whether this change is to be logged.
    pub fn admits(&mut self, now: Timestamp<HostClock>, link: LinkId, state: LinkState) -> bool {
        let changes = self.0.entry(link).or_insert(RecentChanges {
            period_start: now,
            logged: 0,
            suppressed_losses: 0,
            suppressed_state: None,
        });
        if changes.suppressed_state.is_none() && now - changes.period_start >= PERIOD {
            (changes.period_start, changes.logged) = (now, 0);
        }
        if changes.logged < MAX_LINES {
            changes.logged += 1;
            return true;
        }
        let was_up = changes.suppressed_state != Some(LinkState::Down);
        changes.suppressed_losses += u64::from(state == LinkState::Down && was_up);
        changes.suppressed_state = Some(state);
        false
    }

    /// The summaries that are due, each with its link.
    pub fn take_due(&mut self, now: Timestamp<HostClock>) -> Vec<(LinkId, String)> {
        let mut due = Vec::new();
        for (link, changes) in &mut self.0 {
            if now - changes.period_start < PERIOD {
                continue;
            }
            let Some(state) = changes.suppressed_state.take() else {
                continue;
            };
            let state = match state {
                LinkState::Up => "up",
                LinkState::Down => "down",
            };
            let losses = changes.suppressed_losses;
            due.push((*link, format!("the link was lost {losses} more times within a minute; it is {state}")));
            // The next period may log only what it summarises, as long as the link goes on like this.
            (changes.period_start, changes.suppressed_losses) = (now, 0);
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINK: LinkId = LinkId(3);

    /// What is logged of a link that is lost and returns every `period_ms` for `cycles` cycles: changes, and summaries.
    fn logged(log: &mut LinkLog, start_ms: i64, period_ms: i64, cycles: i64) -> (usize, Vec<String>) {
        let (mut changes, mut summaries) = (0, Vec::new());
        for cycle in 0..cycles {
            let down_ms = start_ms + cycle * period_ms;
            for (state, ms) in [(LinkState::Down, down_ms), (LinkState::Up, down_ms + period_ms / 2)] {
                let now = Timestamp::from_millis(ms);
                changes += usize::from(log.admits(now, LINK, state));
                summaries.extend(log.take_due(now).into_iter().map(|(_, text)| text));
            }
        }
        (changes, summaries)
    }

    #[test]
    fn a_link_that_flaps_for_an_hour_has_a_line_a_minute() {
        let mut log = LinkLog::default();
        let (changes, summaries) = logged(&mut log, 0, 600, 6_000);
        assert_eq!((changes, summaries.len()), (9, 59), "{summaries:?}");
        assert_eq!(summaries[0], "the link was lost 96 more times within a minute; it is down");
        assert_eq!(summaries[1], "the link was lost 100 more times within a minute; it is down");
        // It is steady again, and is lost once an hour later: what was not said is said, and the loss, too.
        let after = log.take_due(Timestamp::from_millis(3_700_000));
        assert_eq!(after.len(), 1);
        assert!(after[0].1.ends_with("it is up"), "{after:?}");
        assert_eq!(logged(&mut log, 7_200_000, 1_000, 1), (2, Vec::new()));
    }

    #[test]
    fn a_link_that_is_lost_every_half_minute_is_logged_each_time() {
        assert_eq!(logged(&mut LinkLog::default(), 0, 30_000, 100), (200, Vec::new()));
    }
}
