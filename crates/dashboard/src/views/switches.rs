//! The sensors that are switched off, of the first robot and of each.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::retained_series::MAX_ROBOTS;
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::Frame;

/// The ids of the sensors that are switched off.
pub(super) struct Switches {
    /// Of the first robot; `None` before the first status.
    switched_off: Option<Vec<u8>>,
    robots: BTreeMap<RobotId, RobotSwitches>,
    has_changed: bool,
}

/// Those of one robot.
#[derive(Default)]
struct RobotSwitches {
    switched_off: Option<Vec<u8>>,
    /// Whether it has an estimate: only then it is shown.
    is_estimated: bool,
}

impl Switches {
    pub(super) const fn new(_setting: &ViewConfig) -> Self {
        Self { switched_off: None, robots: BTreeMap::new(), has_changed: false }
    }

    fn robot(&mut self, robot: RobotId) -> Option<&mut RobotSwitches> {
        let has_room = self.robots.contains_key(&robot) || self.robots.len() < MAX_ROBOTS;
        has_room.then(|| self.robots.entry(robot).or_default())
    }
}

impl View for Switches {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::EstimateUpdated { robot, .. }) => {
                let is_new = self.robot(*robot).is_some_and(|known| !std::mem::replace(&mut known.is_estimated, true));
                self.has_changed |= is_new;
            }
            ViewInput::Status(standing) => {
                self.has_changed |= self.switched_off.as_ref() != Some(&standing.switched_off);
                self.switched_off = Some(standing.switched_off.clone());
                for status in &standing.robots {
                    let Some(known) = self.robot(status.robot) else {
                        continue;
                    };
                    let has_changed = known.switched_off.as_ref() != Some(&status.switched_off);
                    known.switched_off = Some(status.switched_off.clone());
                    self.has_changed |= has_changed;
                }
            }
            ViewInput::Event(_) | ViewInput::Truth(_) => {}
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
        for (robot, known) in self.robots.iter().filter(|(_, known)| known.is_estimated) {
            if known.switched_off.is_some() {
                history.robot(&robot_name(*robot)).switched_off.clone_from(&known.switched_off);
            }
        }
    }
}
