//! Biases and calibration with their sigmas.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::retained_series::{MAX_ROBOTS, PointPriority, RetainedSeries, RetentionPolicy};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::{CalibrationRow, Frame, seconds_of};

/// The share of a recording's points for the calibration, which has about eight numbers.
const POINT_SHARE: usize = 8;

/// The estimated constants of each robot.
pub(super) struct Calibrations {
    policy: RetentionPolicy,
    robots: BTreeMap<RobotId, RobotCalibration>,
    /// Statuses of robots beyond [`MAX_ROBOTS`].
    ignored: u64,
}

/// Those of one robot.
struct RobotCalibration {
    rows: Vec<CalibrationRow>,
    /// Each second of a recording; of a live session the current values.
    history: RetainedSeries<Vec<CalibrationRow>>,
    /// Whether it has an estimate: only then it is shown.
    is_estimated: bool,
    has_changed: bool,
}

impl Calibrations {
    pub(super) const fn new(setting: &ViewConfig) -> Self {
        let policy = match setting.retention {
            // Live the current values are all that is needed.
            RetentionPolicy::SlidingWindow { duration, .. } => {
                RetentionPolicy::SlidingWindow { duration, max_points: 1 }
            }
            RetentionPolicy::WholeSession { max_points } => {
                RetentionPolicy::WholeSession { max_points: max_points / POINT_SHARE }
            }
        };
        Self { policy, robots: BTreeMap::new(), ignored: 0 }
    }

    fn robot(&mut self, robot: RobotId) -> Option<&mut RobotCalibration> {
        if !self.robots.contains_key(&robot) {
            if self.robots.len() >= MAX_ROBOTS {
                self.ignored += 1;
                return None;
            }
            let policy = self.policy.shared_by(self.robots.len() + 1);
            self.robots.insert(robot, RobotCalibration::new(policy));
            for known in self.robots.values_mut() {
                known.history.set_policy(policy);
            }
        }
        self.robots.get_mut(&robot)
    }
}

impl RobotCalibration {
    const fn new(policy: RetentionPolicy) -> Self {
        Self { rows: Vec::new(), history: RetainedSeries::new(policy), is_estimated: false, has_changed: false }
    }

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
}

impl View for Calibrations {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::EstimateUpdated { robot, .. }) => {
                if let Some(known) = self.robot(*robot) {
                    known.is_estimated = true;
                }
            }
            ViewInput::Status(standing) => {
                for status in &standing.robots {
                    if let Some(known) = self.robot(status.robot) {
                        known.push_rows(now, &status.calibration);
                    }
                }
            }
            ViewInput::Event(_) | ViewInput::Truth(_) => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        for (robot, known) in self.robots.iter_mut().filter(|(_, known)| known.is_estimated) {
            let is_due = std::mem::take(&mut known.has_changed) || content == FrameContent::DeltaAndSummary;
            if is_due && !known.rows.is_empty() {
                frame.robot(&robot_name(*robot)).calibration = Some(known.rows.clone());
            }
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, known) in self.robots.iter().filter(|(_, known)| known.is_estimated) {
            let rows = known.history.retained().concat();
            if !rows.is_empty() {
                history.robot(&robot_name(*robot)).calibration = Some(rows);
            }
        }
    }

    fn dropped(&self) -> u64 {
        self.ignored
    }
}
