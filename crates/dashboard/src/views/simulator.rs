//! The settings of the simulated brick: its steering source and its link profile.

use posebridge_telemetry::{HostClock, Timestamp};

use super::view::{FrameContent, View, ViewConfig, ViewInput};
use crate::model::{Frame, SimulatorNow};

/// The settings; `None` without a simulated brick.
pub(super) struct Simulator {
    status: Option<SimulatorNow>,
    has_changed: bool,
}

impl Simulator {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { status: None, has_changed: false }
    }
}

impl View for Simulator {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        if let ViewInput::Status(standing) = input
            && standing.simulator != self.status
        {
            self.status.clone_from(&standing.simulator);
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
        history.simulator.clone_from(&self.status);
    }
}
