//! Which robots there are: the chooser. Every message that tells anything of a robot names it.

use posebridge_telemetry::{Event, HostClock, RobotId, Stamp};

use super::trail::MOST_ROBOTS;
use super::{Pace, Setting, Told, View, robot_name};
use crate::model::Frame;

/// The robots in the order in which they were heard.
pub(super) struct Robots {
    heard: Vec<RobotId>,
    ignored: u64,
    has_news: bool,
}

impl Robots {
    pub(super) const fn new(_setting: &Setting) -> Self {
        Self { heard: Vec::new(), ignored: 0, has_news: false }
    }
}

impl View for Robots {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        // Not everybody who is heard is a robot: cameras and ground stations are heard as well.
        let Told::Event(Event::Estimated { robot, .. }) = told else {
            return;
        };
        if self.heard.contains(robot) {
            return;
        }
        if self.heard.len() >= MOST_ROBOTS {
            self.ignored += 1;
            return;
        }
        self.heard.push(*robot);
        self.has_news = true;
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        if std::mem::take(&mut self.has_news) {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for robot in &self.heard {
            history.robot(&robot_name(*robot));
        }
    }

    fn dropped(&self) -> u64 {
        self.ignored
    }
}
