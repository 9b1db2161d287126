//! How often a station hears a robot, and whether it still does.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::config::OwnershipConfig;
use crate::io::Reception;

/// Gaps that the interval is taken from.
const WINDOW: usize = 8;
/// Reads that follow each other faster are parts of one message.
const SHORTEST_GAP: TimeDelta = TimeDelta::from_millis(5);
/// A longer gap is a break and not an interval.
const LONGEST_GAP: TimeDelta = TimeDelta::from_millis(2_000);
/// Until enough gaps are known, a robot counts as a slow one.
const DEFAULT_INTERVAL: TimeDelta = TimeDelta::from_millis(500);
const FEWEST_GAPS: usize = 3;
/// Up to this much longer than its interval may a robot take between two messages.
const MOST_JITTER: TimeDelta = TimeDelta::from_millis(200);

/// Thresholds adapt to the robot: one of 2 Hz is not silent after the time that is long for one of 100 Hz.
#[derive(Clone, Debug)]
pub(crate) struct ReceptionMonitor {
    /// Of the present visit.
    first: Option<Timestamp<HostClock>>,
    /// Also of an earlier visit.
    last: Option<Timestamp<HostClock>>,
    gaps: [TimeDelta; WINDOW],
    gap_count: usize,
    interval: TimeDelta,
}

impl ReceptionMonitor {
    pub(crate) const fn new() -> Self {
        Self { first: None, last: None, gaps: [TimeDelta::ZERO; WINDOW], gap_count: 0, interval: DEFAULT_INTERVAL }
    }

    pub(crate) fn hear(&mut self, now: Timestamp<HostClock>, config: &OwnershipConfig) {
        if self.at(now, config) == Reception::Silent {
            self.first = Some(now);
        }
        if let Some(last) = self.last
            && now - last < SHORTEST_GAP
        {
            return;
        }
        let gap = self.last.map(|last| now - last).filter(|gap| *gap <= LONGEST_GAP);
        if let Some(gap) = gap
            && let Some(slot) = self.gaps.get_mut(self.gap_count % WINDOW)
        {
            *slot = gap;
            self.gap_count += 1;
            self.interval = self.median_gap();
        }
        self.last = Some(now);
    }

    /// The station was not running for this long, which says nothing of the robot.
    pub(crate) fn skip(&mut self, duration: TimeDelta) {
        self.first = self.first.map(|first| first + duration);
        self.last = self.last.map(|last| last + duration);
    }

    /// The link closed: the robot is not heard, however short the time.
    pub(crate) const fn close(&mut self) {
        self.first = None;
    }

    pub(crate) fn at(&self, now: Timestamp<HostClock>, config: &OwnershipConfig) -> Reception {
        if self.silent_at(config).is_some_and(|silent_at| now < silent_at) {
            Reception::Heard
        } else {
            Reception::Silent
        }
    }

    /// When the robot is silent if it is not heard again; `None` where it is not heard now.
    pub(crate) fn silent_at(&self, config: &OwnershipConfig) -> Option<Timestamp<HostClock>> {
        self.first.and(self.last).map(|last| last + self.silent_after(config))
    }

    /// Since when the robot is heard without a break.
    pub(crate) fn heard_for(&self, now: Timestamp<HostClock>) -> TimeDelta {
        self.first.map_or(TimeDelta::ZERO, |first| now - first)
    }

    /// When the robot was heard last, in this visit or an earlier one.
    pub(crate) const fn last(&self) -> Option<Timestamp<HostClock>> {
        self.last
    }

    /// After which time without a message the robot is elsewhere, for a station that has heard it for `heard_for`. `None` if it is so
    /// now.
    pub(crate) fn departs_in(
        &self,
        now: Timestamp<HostClock>,
        heard_for: TimeDelta,
        config: &OwnershipConfig,
    ) -> Option<TimeDelta> {
        let age = now - self.first.and(self.last)?;
        let is_heard_by_both = age < heard_for;
        let limit = if is_heard_by_both { self.silent_after(config) } else { self.departed_after(config) };
        (age < limit).then(|| limit - age)
    }

    fn silent_after(&self, config: &OwnershipConfig) -> TimeDelta {
        config.silent_after.max(TimeDelta::from_nanos(self.interval.as_nanos() / 2 * 9))
    }

    fn departed_after(&self, config: &OwnershipConfig) -> TimeDelta {
        let jitter = TimeDelta::from_nanos(self.interval.as_nanos() / 10 * 3).min(MOST_JITTER);
        config.departed_after.max(self.interval + jitter)
    }

    fn median_gap(&self) -> TimeDelta {
        if self.gap_count < FEWEST_GAPS {
            return DEFAULT_INTERVAL;
        }
        let mut sorted = self.gaps;
        let known = self.gap_count.min(WINDOW);
        let (known_gaps, _) = sorted.split_at_mut(known);
        known_gaps.sort_unstable();
        known_gaps.get(known / 2).copied().unwrap_or(DEFAULT_INTERVAL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard_every(interval_ms: i64, until_ms: i64) -> ReceptionMonitor {
        let config = OwnershipConfig::default();
        let mut monitor = ReceptionMonitor::new();
        for now_ms in (0..=until_ms).step_by(usize::try_from(interval_ms).unwrap()) {
            monitor.hear(Timestamp::from_millis(now_ms), &config);
        }
        monitor
    }

    #[test]
    fn a_slow_robot_is_silent_later_than_a_fast_one() {
        let config = OwnershipConfig::default();
        let silent_after_ms = |interval_ms| {
            let silent_at = heard_every(interval_ms, 4_000).silent_at(&config).unwrap();
            (silent_at - Timestamp::from_millis(4_000)).as_millis_f64()
        };
        assert_eq!([10, 100, 500].map(silent_after_ms), [300.0, 450.0, 2_250.0]);
    }

    #[test]
    fn a_robot_that_came_to_the_asker_departs_sooner_than_one_that_both_hear() {
        let config = OwnershipConfig::default();
        let departs_in_ms = |interval_ms, heard_for_ms, now_ms| {
            let heard_for = TimeDelta::from_millis(heard_for_ms);
            let left = heard_every(interval_ms, 4_000).departs_in(Timestamp::from_millis(now_ms), heard_for, &config);
            left.map(TimeDelta::as_millis_f64)
        };
        // Gone after 150 ms at 100 Hz, after 650 ms at 2 Hz.
        assert_eq!(departs_in_ms(10, 0, 4_100), Some(50.0));
        assert_eq!(departs_in_ms(10, 0, 4_150), None);
        assert_eq!(departs_in_ms(500, 0, 4_600), Some(50.0));
        assert_eq!(departs_in_ms(500, 0, 4_650), None);
        // The asker heard it before the owner did last.
        assert_eq!(departs_in_ms(10, 1_000, 4_200), Some(100.0));
        assert_eq!(departs_in_ms(10, 1_000, 4_300), None);
    }

    #[test]
    fn parts_of_a_message_and_breaks_are_no_intervals_and_a_closed_link_is_silence() {
        let config = OwnershipConfig::default();
        let mut monitor = ReceptionMonitor::new();
        for message in 0..6 {
            for part in 0..4 {
                monitor.hear(Timestamp::from_millis(message * 200 + part), &config);
            }
        }
        assert_eq!(monitor.interval, TimeDelta::from_millis(200));
        let back = Timestamp::from_millis(60_000);
        monitor.hear(back, &config);
        assert_eq!(monitor.interval, TimeDelta::from_millis(200));
        assert_eq!(monitor.heard_for(back), TimeDelta::ZERO);
        assert_eq!(monitor.at(back, &config), Reception::Heard);
        monitor.close();
        assert_eq!(monitor.at(back, &config), Reception::Silent);
        assert_eq!(monitor.departs_in(back, TimeDelta::ZERO, &config), None);
    }
}
