//! Biases and calibration with their sigmas.

use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::retained_series::RetentionPolicy;
use super::retained_series::{PointPriority, RetainedSeries};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::{CalibrationRow, Frame, seconds_of};

/// The share of a recording's points for the calibration, which has about eight numbers.
const POINT_SHARE: usize = 8;

/// The estimated constants.
pub(super) struct Calibrations {
    robot: Option<RobotId>,
    rows: Vec<CalibrationRow>,
    /// Each second of a recording; of a live session the current values.
    history: RetainedSeries<Vec<CalibrationRow>>,
    has_changed: bool,
}

impl Calibrations {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        let keep = match setting.retention {
            RetentionPolicy::SlidingWindow { duration: span, .. } => {
                RetentionPolicy::SlidingWindow { duration: span, max_points: 1 }
            }
            RetentionPolicy::WholeSession { max_points: most } => {
                RetentionPolicy::WholeSession { max_points: most / POINT_SHARE }
            }
        };
        Self { robot: None, rows: Vec::new(), history: RetainedSeries::new(keep), has_changed: false }
    }
}

impl Calibrations {
    fn push_rows(&mut self, now: Timestamp<HostClock>, rows: &[CalibrationRow]) {
        let t_s = seconds_of(now);
        let rows = rows.iter().map(|row| CalibrationRow { t_s, ..row.clone() });
        let rows: Vec<CalibrationRow> = rows.collect();
        let is_same = |(row, known): (&CalibrationRow, &CalibrationRow)| {
            (&row.name, row.value, row.sigma) == (&known.name, known.value, known.sigma)
        };
        self.has_changed |= rows.len() != self.rows.len() || !rows.iter().zip(&self.rows).all(is_same);
        self.rows.clone_from(&rows);
        // All of them: there is one status a second.
        self.history.push(now, rows, PointPriority::Keep);
        drop(self.history.take_pending());
    }

    fn add_rows(&self, frame: &mut Frame, rows: Vec<CalibrationRow>) {
        if let (Some(robot), false) = (self.robot, rows.is_empty()) {
            frame.robot(&robot_name(robot)).calibration = Some(rows);
        }
    }
}

impl View for Calibrations {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::EstimateUpdated { robot, .. }) => self.robot = Some(*robot),
            ViewInput::Status(standing) => self.push_rows(now, &standing.calibration),
            ViewInput::Event(_) | ViewInput::Truth(_) => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        if std::mem::take(&mut self.has_changed) || content == FrameContent::DeltaAndSummary {
            self.add_rows(frame, self.rows.clone());
        }
    }

    fn add_history(&self, history: &mut Frame) {
        self.add_rows(history, self.history.retained().concat());
    }
}
