//! The alignment of the robot's clock.

use posebridge_telemetry::{Event, HostClock, Timestamp};

use super::view::{FrameContent, View, ViewConfig, ViewInput};
use crate::model::{ClockRow, Frame};

/// The last alignment.
pub(super) struct Clock {
    row: Option<ClockRow>,
}

impl Clock {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { row: None }
    }
}

impl View for Clock {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        let ViewInput::Event(Event::BrickClockAligned { offset, skew_ppm, uncertainty, round_trip, .. }) = input else {
            return;
        };
        // Between two replies the alignment is also refined by one-way messages.
        let has_answered = round_trip.is_some() || self.row.as_ref().is_some_and(|row| row.method == TWO_WAY);
        let method = if has_answered { TWO_WAY } else { ONE_WAY };
        self.row = Some(ClockRow {
            offset_s: offset.as_secs_f64(),
            skew_ppm: (*skew_ppm).into(),
            uncertainty_ms: uncertainty.as_millis_f64().into(),
            method: method.to_owned(),
        });
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        if content == FrameContent::DeltaAndSummary {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.clock.clone_from(&self.row);
    }
}

/// The brick answers time requests.
const TWO_WAY: &str = "two-way";
/// One-way messages only.
const ONE_WAY: &str = "one-way";
