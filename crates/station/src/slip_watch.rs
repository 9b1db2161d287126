//! When wheels begin to slip: one line for people, not one for each window of the gyro.

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

/// Wheels that have not slipped for longer than this begin anew: ten of the gyro's usual windows of 0.2 s.
const SLIP_TIMEOUT: TimeDelta = TimeDelta::from_millis(2_000);
/// Number of windows in a row that are no coincidence. One alone is chance once in a thousand, or play that is crossed where a
/// wheel turns back.
const MIN_CONSECUTIVE: u32 = 3;

/// Counts the observations of motion with slip.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SlipWatch {
    last: Option<Timestamp<BrickClock>>,
    consecutive: u32,
}

impl SlipWatch {
    /// Records an observation with slip, and returns whether people should be warned.
    pub(crate) fn observe(&mut self, stamp: Timestamp<BrickClock>) -> bool {
        let last = self.last.replace(stamp);
        // A brick that was restarted begins with an earlier stamp.
        let goes_on = last.is_some_and(|last| (TimeDelta::ZERO..=SLIP_TIMEOUT).contains(&(stamp - last)));
        self.consecutive = if goes_on { self.consecutive.saturating_add(1) } else { 1 };
        self.consecutive == MIN_CONSECUTIVE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_told_once_and_a_single_one_never() {
        let mut watch = SlipWatch::default();
        let told = [0, 100, 250, 400, 2_400, 4_401, 9_000, 9_200, 9_300, 50, 60, 70]
            .map(|millis| watch.observe(Timestamp::from_millis(millis)));
        let expected = [false, false, true, false, false, false, false, false, true, false, false, true];
        assert_eq!(told, expected);
    }
}
