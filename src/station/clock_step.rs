//! Notices that the computer's date was set while a session runs.
//!
//! Nothing here goes by the date: stamps are those of the monotonic clock, and the recording's times follow from the date at the start.
//! Who compares them with the times of other programs must know that these have leapt.

use posebridge_telemetry::TimeDelta;

/// Less than this is the steady correction of a clock, not a leap.
const STEP_THRESHOLD: TimeDelta = TimeDelta::from_millis(1_000);

/// Compares the date with the session's clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClockStepDetector {
    reported: TimeDelta,
}

impl ClockStepDetector {
    /// Takes by how much the date runs ahead of the session's clock, and returns by how much it has leapt since the last report.
    pub fn detect(&mut self, ahead: TimeDelta) -> Option<TimeDelta> {
        let leapt = ahead - self.reported;
        if leapt < STEP_THRESHOLD && leapt > -STEP_THRESHOLD {
            return None;
        }
        self.reported = ahead;
        Some(leapt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_that_is_set_is_told_once_and_a_slow_correction_is_not() {
        let mut watch = ClockStepDetector::default();
        assert_eq!(watch.detect(TimeDelta::from_millis(400)), None);
        let hour = TimeDelta::from_millis(3_600_000);
        assert_eq!(watch.detect(hour), Some(hour));
        assert_eq!(watch.detect(hour + TimeDelta::from_millis(300)), None);
        let back = watch.detect(TimeDelta::ZERO);
        assert_eq!(back, Some(-hour));
        assert_eq!(watch.detect(TimeDelta::ZERO), None);
    }
}
