//! The list of robots. Every message with data of a robot names it.

use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::retained_series::MAX_ROBOTS;
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::Frame;

/// The robots in the order of detection.
pub(super) struct Robots {
    known: Vec<RobotId>,
    ignored: u64,
    has_changed: bool,
}

impl Robots {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { known: Vec::new(), ignored: 0, has_changed: false }
    }
}

impl View for Robots {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        // Not every sender is a robot: cameras and ground stations send too.
        let ViewInput::Event(Event::EstimateUpdated { robot, .. }) = input else {
            return;
        };
        if self.known.contains(robot) {
            return;
        }
        if self.known.len() >= MAX_ROBOTS {
            self.ignored += 1;
            return;
        }
        self.known.push(*robot);
        self.has_changed = true;
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        if std::mem::take(&mut self.has_changed) {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for robot in &self.known {
            history.robot(&robot_name(*robot));
        }
    }

    fn dropped(&self) -> u64 {
        self.ignored
    }
}
