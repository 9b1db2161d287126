//! The current tunables.

use posebridge_telemetry::{HostClock, Timestamp};

use super::view::{FrameContent, View, ViewConfig, ViewInput};
use crate::model::{Frame, ParameterValue};

/// Their values.
pub(super) struct Parameters {
    values: Vec<ParameterValue>,
    has_changed: bool,
}

impl Parameters {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { values: Vec::new(), has_changed: false }
    }
}

impl View for Parameters {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        if let ViewInput::Status(standing) = input
            && standing.parameters != self.values
        {
            self.values.clone_from(&standing.parameters);
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
        if !self.values.is_empty() {
            history.parameters = Some(self.values.clone());
        }
    }
}
