//! Notices that the computer's date was set while a session runs.
//!
//! Nothing here goes by the date: stamps are those of the monotonic clock, and the recording's times follow from the date at the start.
//! Who compares them with the times of other programs must know that these have leapt.

use posebridge_telemetry::Span;

/// Less than this is the steady correction of a clock, not a leap.
const LEAP: Span = Span::from_millis(1_000);

/// Compares the date with the session's clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct CalendarWatch {
    told: Span,
}

impl CalendarWatch {
    /// Takes by how much the date runs ahead of the session's clock, and says by how much it has leapt since it was last told.
    pub fn leap(&mut self, ahead: Span) -> Option<Span> {
        let leapt = ahead - self.told;
        if leapt < LEAP && leapt > -LEAP {
            return None;
        }
        self.told = ahead;
        Some(leapt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_that_is_set_is_told_once_and_a_slow_correction_is_not() {
        let mut watch = CalendarWatch::default();
        assert_eq!(watch.leap(Span::from_millis(400)), None);
        let hour = Span::from_millis(3_600_000);
        assert_eq!(watch.leap(hour), Some(hour));
        assert_eq!(watch.leap(hour + Span::from_millis(300)), None);
        let back = watch.leap(Span::ZERO);
        assert_eq!(back, Some(-hour));
        assert_eq!(watch.leap(Span::ZERO), None);
    }
}
