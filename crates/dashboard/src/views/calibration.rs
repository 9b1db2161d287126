//! Biases and calibration with their sigmas.

use posebridge_telemetry::{Event, HostClock, RobotId, Stamp};

use super::{Pace, Setting, Told, View, robot_name};
use crate::model::{CalibrationRow, Frame};

/// What was learned about the robot.
pub(super) struct Calibrations {
    robot: Option<RobotId>,
    rows: Vec<CalibrationRow>,
    has_news: bool,
}

impl Calibrations {
    pub(super) const fn new(_setting: &Setting) -> Self {
        Self {
            robot: None,
            rows: Vec::new(),
            has_news: false,
        }
    }
}

impl View for Calibrations {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Event(Event::Estimated { robot, .. }) => self.robot = Some(*robot),
            Told::Standing(standing) if standing.calibration != self.rows => {
                self.rows.clone_from(&standing.calibration);
                self.has_news = true;
            }
            Told::Event(_) | Told::Truth(_) | Told::Standing(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, pace: Pace) {
        if std::mem::take(&mut self.has_news) || pace == Pace::Second {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        if let (Some(robot), false) = (self.robot, self.rows.is_empty()) {
            history.robot(&robot_name(robot)).calibration = Some(self.rows.clone());
        }
    }
}
