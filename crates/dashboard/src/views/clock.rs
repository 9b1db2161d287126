//! The alignment of the robot's clock.

use posebridge_telemetry::{Event, HostClock, Stamp};

use super::{Pace, Setting, Told, View};
use crate::model::{ClockRow, Frame};

/// The last alignment.
pub(super) struct Clock {
    row: Option<ClockRow>,
}

impl Clock {
    pub(super) const fn new(_setting: &Setting) -> Self {
        Self { row: None }
    }
}

impl View for Clock {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        let Told::Event(Event::BrickClockAligned { offset, skew_ppm, uncertainty, round_trip, .. }) = told else {
            return;
        };
        // Between two answers the alignment is also refined by what arrives by itself.
        let has_answered = round_trip.is_some() || self.row.as_ref().is_some_and(|row| row.method == TWO_WAY);
        let method = if has_answered { TWO_WAY } else { ONE_WAY };
        self.row = Some(ClockRow {
            offset_s: offset.as_secs_f64(),
            skew_ppm: (*skew_ppm).into(),
            uncertainty_ms: uncertainty.as_millis_f64().into(),
            method: method.to_owned(),
        });
    }

    fn add_news(&mut self, frame: &mut Frame, pace: Pace) {
        if pace == Pace::Second {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.clock.clone_from(&self.row);
    }
}

/// The brick answers questions for its time.
const TWO_WAY: &str = "two-way";
/// It is only heard.
const ONE_WAY: &str = "one-way";
