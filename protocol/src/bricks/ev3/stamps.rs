//! Plausibility of the clock in a reply, which has no checksum: it was read between request and reply.
//!
//! ```text
//! sent2 - answered1  <=  (stamp2 - stamp1) mod 2^32  <=  answered2 - sent1,   both widened by 1 % and 5 ms
//! ```
//! What does not fit is refused once. If the next answer fits the refused one and not the one before, the clock was set
//! (TIMER_READ_US follows the brick's calendar).

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

const PERIOD_MICROS: i128 = 1 << 32;
/// Largest rate error of a clock, in per cent: the station's limit for any brick.
const LARGEST_SKEW_PERCENT: i64 = 1;
/// Below half a period the counter's difference is unambiguous.
const UNAMBIGUOUS: TimeDelta = TimeDelta::from_millis(2_000_000);
/// Resolution of both clocks and jitter of the brick's scheduler.
const MARGIN: TimeDelta = TimeDelta::from_millis(5);

/// A stamp with the instants of its request and reply.
#[derive(Clone, Copy, Debug)]
pub(super) struct BrickStamp {
    pub(super) micros: u32,
    pub(super) sent: Timestamp<HostClock>,
    pub(super) answered: Timestamp<HostClock>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StampAdvance {
    /// The clock continued, with about this much time since the last stamp; zero for the first one.
    Continuous(TimeDelta),
    /// The clock was set, or the brick was restarted; the host's time since the last accepted stamp.
    Stepped(TimeDelta),
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StampChecker {
    last: Option<BrickStamp>,
    suspect: Option<BrickStamp>,
}

impl StampChecker {
    /// Checks a stamp and returns the time since the last accepted one; `None` if this one is rejected.
    pub(super) fn push(&mut self, stamp: BrickStamp) -> Option<StampAdvance> {
        let passed = match (self.last, self.suspect) {
            (None, _) => StampAdvance::Continuous(TimeDelta::ZERO),
            (Some(last), _) if stamp.is_plausible_after(&last) => StampAdvance::Continuous(stamp.since(&last)),
            (Some(last), Some(suspect)) if stamp.is_plausible_after(&suspect) => {
                StampAdvance::Stepped(stamp.answered - last.answered)
            }
            _ => {
                self.suspect = Some(stamp);
                return None;
            }
        };
        self.suspect = None;
        self.last = Some(stamp);
        Some(passed)
    }
}

impl BrickStamp {
    /// The time since an earlier stamp: the longer of what both clocks give. The host's is too short for replies that
    /// were delayed together, the brick's for a damaged stamp that was accepted.
    fn since(&self, last: &Self) -> TimeDelta {
        let on_host = self.answered - last.answered;
        let by_brick = self.micros.wrapping_sub(last.micros) as i32;
        if on_host < UNAMBIGUOUS { on_host.max(TimeDelta::from_micros(i64::from(by_brick))) } else { on_host }
    }

    fn is_plausible_after(&self, last: &Self) -> bool {
        let longest = self.answered - last.sent;
        let tolerance =
            TimeDelta::from_nanos(longest.as_nanos() / 100 * LARGEST_SKEW_PERCENT).max(TimeDelta::ZERO) + MARGIN;
        let least = micros(self.sent - last.answered - tolerance);
        let most = micros(longest + tolerance);
        let ran = i128::from(self.micros.wrapping_sub(last.micros));
        (ran - least).rem_euclid(PERIOD_MICROS) <= most - least
    }
}

const fn micros(duration: TimeDelta) -> i128 {
    (duration.as_nanos() / 1_000) as i128
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Asked each 30 ms and answered 30 ms later; read in the middle.
    fn nth(n: i64, start_micros: u32) -> BrickStamp {
        BrickStamp {
            micros: start_micros.wrapping_add((n * 30_000 + 15_000) as u32),
            sent: Timestamp::from_millis(n * 30),
            answered: Timestamp::from_millis((n + 1) * 30),
        }
    }

    #[test]
    fn a_counter_runs_on_across_its_wrap() {
        let mut stamps = StampChecker::default();
        let taken: Vec<_> = (0..6).map(|n| stamps.push(nth(n, u32::MAX - 70_000))).collect();
        let ran = |millis| Some(StampAdvance::Continuous(TimeDelta::from_millis(millis)));
        let cycle = ran(30);
        assert_eq!(taken, [ran(0), cycle, cycle, cycle, cycle, cycle]);
    }

    #[test]
    fn one_damaged_stamp_is_refused_and_a_clock_that_was_set_is_followed() {
        for bit in 17..32 {
            let mut stamps = StampChecker::default();
            stamps.push(nth(0, 5_000_000));
            let mut damaged = nth(1, 5_000_000);
            damaged.micros ^= 1 << bit;
            assert_eq!(stamps.push(damaged), None, "bit {bit}");
            let since = stamps.push(nth(2, 5_000_000));
            let ran = StampAdvance::Continuous(TimeDelta::from_millis(60));
            assert_eq!(since, Some(ran), "bit {bit}");
        }
        let mut stamps = StampChecker::default();
        stamps.push(nth(0, 5_000_000));
        assert_eq!(stamps.push(nth(1, 900_000_000)), None);
        let stepped = stamps.push(nth(2, 900_000_000));
        assert_eq!(stepped, Some(StampAdvance::Stepped(TimeDelta::from_millis(60))));
    }

    #[test]
    fn a_silence_of_hours_is_no_damage() {
        let mut stamps = StampChecker::default();
        stamps.push(nth(0, 77));
        assert!(stamps.push(nth(700_000, 77)).is_some());
    }
}
