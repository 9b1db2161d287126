//! The list of robots, with their names and which of them are lost. Every message with data of a robot has its id.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::retained_series::MAX_ROBOTS;
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::{Frame, seconds_of};

/// Longest name, in characters: it stands beside the robot on a map.
const MAX_NAME_CHARS: usize = 60;

/// The robots in the order of their first estimates.
pub(super) struct Robots {
    known: Vec<KnownRobot>,
    /// A robot is named before its first estimate.
    names: BTreeMap<RobotId, String>,
    ignored: u64,
    has_changed: bool,
}

struct KnownRobot {
    robot: RobotId,
    /// When it was lost; `None` while it is heard.
    lost: Option<Timestamp<HostClock>>,
}

impl Robots {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { known: Vec::new(), names: BTreeMap::new(), ignored: 0, has_changed: false }
    }

    fn on_estimate(&mut self, robot: RobotId) {
        if let Some(known) = self.known.iter_mut().find(|known| known.robot == robot) {
            known.lost = None;
            return;
        }
        if self.known.len() >= MAX_ROBOTS {
            self.ignored += 1;
            return;
        }
        self.known.push(KnownRobot { robot, lost: None });
        self.has_changed = true;
    }

    fn on_name(&mut self, robot: RobotId, name: &str) {
        if !self.names.contains_key(&robot) && self.names.len() >= MAX_ROBOTS {
            self.ignored += 1;
            return;
        }
        self.names.insert(robot, name.chars().take(MAX_NAME_CHARS).collect());
        self.has_changed = true;
    }

    fn on_loss(&mut self, now: Timestamp<HostClock>, robot: RobotId) {
        if let Some(known) = self.known.iter_mut().find(|known| known.robot == robot) {
            known.lost = Some(now);
            self.has_changed = true;
        }
    }
}

impl View for Robots {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            // Not every sender is a robot: cameras and ground stations send too.
            ViewInput::Event(Event::EstimateUpdated { robot, .. }) => self.on_estimate(*robot),
            ViewInput::Event(Event::RobotNamed { robot, name }) => self.on_name(*robot, name),
            ViewInput::Event(Event::RobotLost { robot, .. }) => self.on_loss(now, *robot),
            ViewInput::Event(_) | ViewInput::Truth(_) | ViewInput::Status(_) => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        // Once a second as well: a reader that was slow may have missed the change.
        if std::mem::take(&mut self.has_changed) || content == FrameContent::DeltaAndSummary {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for known in &self.known {
            let part = history.robot(&robot_name(known.robot));
            part.name = self.names.get(&known.robot).cloned();
            part.lost_t_s = known.lost.map(seconds_of);
        }
    }

    fn dropped(&self) -> u64 {
        self.ignored
    }
}
