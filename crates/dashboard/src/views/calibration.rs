//! Biases and calibration with their sigmas.

use posebridge_telemetry::{Event, HostClock, RobotId, Stamp};

use super::trail::{Trail, Weight};
use super::{Keep, Pace, Setting, Told, View, robot_name};
use crate::model::{CalibrationRow, Frame, seconds_of};

/// The share of a recording's points that these have: there are about eight numbers.
const SHARE: usize = 8;

/// What was learned about the robot.
pub(super) struct Calibrations {
    robot: Option<RobotId>,
    rows: Vec<CalibrationRow>,
    /// Each second of a recording, and of a live session what stands.
    kept: Trail<Vec<CalibrationRow>>,
    has_news: bool,
}

impl Calibrations {
    pub(super) fn new(setting: &Setting) -> Self {
        let keep = match setting.keep {
            Keep::Latest { span, .. } => Keep::Latest { span, most: 1 },
            Keep::Whole { most } => Keep::Whole { most: most / SHARE },
        };
        Self { robot: None, rows: Vec::new(), kept: Trail::new(keep), has_news: false }
    }
}

impl Calibrations {
    fn take_rows(&mut self, now: Stamp<HostClock>, told: &[CalibrationRow]) {
        let t_s = seconds_of(now);
        let rows = told.iter().map(|row| CalibrationRow { t_s, ..row.clone() });
        let rows: Vec<CalibrationRow> = rows.collect();
        let is_same = |(row, known): (&CalibrationRow, &CalibrationRow)| {
            (&row.name, row.value, row.sigma) == (&known.name, known.value, known.sigma)
        };
        self.has_news |= rows.len() != self.rows.len() || !rows.iter().zip(&self.rows).all(is_same);
        self.rows.clone_from(&rows);
        // Every one of them: what is told comes once a second.
        self.kept.push(now, rows, Weight::Rare);
        drop(self.kept.take_news());
    }

    fn add(&self, frame: &mut Frame, rows: Vec<CalibrationRow>) {
        if let (Some(robot), false) = (self.robot, rows.is_empty()) {
            frame.robot(&robot_name(robot)).calibration = Some(rows);
        }
    }
}

impl View for Calibrations {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Event(Event::Estimated { robot, .. }) => self.robot = Some(*robot),
            Told::Standing(standing) => self.take_rows(now, &standing.calibration),
            Told::Event(_) | Told::Truth(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, pace: Pace) {
        if std::mem::take(&mut self.has_news) || pace == Pace::Second {
            self.add(frame, self.rows.clone());
        }
    }

    fn add_history(&self, history: &mut Frame) {
        self.add(history, self.kept.kept().concat());
    }
}
