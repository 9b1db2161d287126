//! The sensors that are switched off.

use posebridge_telemetry::{HostClock, Timestamp};

use super::view::{FrameContent, View, ViewConfig, ViewInput};
use crate::model::Frame;

/// The ids of the sensors that are switched off; `None` before the first status.
pub(super) struct Switches {
    switched_off: Option<Vec<u8>>,
    has_changed: bool,
}

impl Switches {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { switched_off: None, has_changed: false }
    }
}

impl View for Switches {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        if let ViewInput::Status(standing) = input
            && self.switched_off.as_ref() != Some(&standing.switched_off)
        {
            self.switched_off = Some(standing.switched_off.clone());
            self.has_changed = true;
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        // Once a second as well: a reader that was slow may have missed the change.
        if std::mem::take(&mut self.has_changed) || content == FrameContent::DeltaAndSummary {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.switched_off.clone_from(&self.switched_off);
    }
}
