//! The station's status: tunables, simulated brick, disabled sensors, and the calibration of each robot.

use posebridge_telemetry::{Event, HostClock, RobotId, Timestamp};

use super::retained_series::{BoundedMap, OlderPolicy, PointPriority, RetainedSeries};
use super::view::{FrameContent, RetentionPolicy, View, ViewConfig, ViewInput, robot_name};
use crate::feed::StationStatus;
use crate::model::{CalibrationRow, Frame, ParameterValue, SetupRow, SimulatorNow, seconds_of};

/// A part of the status that is sent when it changes, and once a second.
pub(super) struct StatusPart<T> {
    current: Option<T>,
    has_changed: bool,
    read: fn(&StationStatus) -> Option<T>,
    write: fn(&mut Frame, Option<T>),
}

impl<T> StatusPart<T> {
    const fn new(read: fn(&StationStatus) -> Option<T>, write: fn(&mut Frame, Option<T>)) -> Self {
        Self { current: None, has_changed: false, read, write }
    }
}

pub(super) fn parameters() -> StatusPart<Vec<ParameterValue>> {
    StatusPart::new(
        |status| (!status.parameters.is_empty()).then(|| status.parameters.clone()),
        |frame, values| frame.parameters = values,
    )
}

pub(super) fn is_comparing() -> StatusPart<bool> {
    StatusPart::new(|status| Some(status.is_comparing), |frame, is_comparing| frame.is_comparing = is_comparing)
}

/// The steps of setting up each robot; none in a recording.
pub(super) fn setup() -> StatusPart<Vec<SetupRow>> {
    StatusPart::new(|status| (!status.setup.is_empty()).then(|| status.setup.clone()), |frame, rows| frame.setup = rows)
}

/// Steering source and link profile of the simulated brick.
pub(super) fn simulator() -> StatusPart<SimulatorNow> {
    StatusPart::new(|status| status.simulator.clone(), |frame, settings| frame.simulator = settings)
}

impl<T: Clone + PartialEq + Send> View for StatusPart<T> {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        if let ViewInput::Status(status) = input {
            let reported = (self.read)(status);
            self.has_changed |= reported != self.current;
            self.current = reported;
        }
    }

    fn take_change(&mut self) -> bool {
        std::mem::take(&mut self.has_changed)
    }

    fn add_history(&self, history: &mut Frame) {
        (self.write)(history, self.current.clone());
    }
}

#[derive(Default)]
pub(super) struct Switches {
    /// Of the first robot; `None` before the first status.
    switched_off: Option<Vec<u8>>,
    robots: BoundedMap<RobotId, RobotSwitches>,
    has_changed: bool,
}

#[derive(Default)]
struct RobotSwitches {
    switched_off: Option<Vec<u8>>,
    /// Only robots with an estimate are shown.
    is_estimated: bool,
}

impl View for Switches {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::EstimateUpdated { robot, .. } | Event::QuantityUpdated { robot, .. }) => {
                let known = self.robots.get_or_insert(*robot, RobotSwitches::default);
                self.has_changed |= known.is_some_and(|known| !std::mem::replace(&mut known.is_estimated, true));
            }
            ViewInput::Status(status) => {
                self.has_changed |= self.switched_off.as_ref() != Some(&status.switched_off);
                self.switched_off = Some(status.switched_off.clone());
                for one in &status.robots {
                    if let Some(known) = self.robots.get_or_insert(one.robot, RobotSwitches::default) {
                        self.has_changed |= known.switched_off.as_ref() != Some(&one.switched_off);
                        known.switched_off = Some(one.switched_off.clone());
                    }
                }
            }
            ViewInput::Event(_) | ViewInput::Truth(_) => {}
        }
    }

    fn take_change(&mut self) -> bool {
        std::mem::take(&mut self.has_changed)
    }

    fn add_history(&self, history: &mut Frame) {
        history.switched_off.clone_from(&self.switched_off);
        for (robot, known) in self.robots.entries.iter().filter(|(_, known)| known.is_estimated) {
            if known.switched_off.is_some() {
                history.robot(&robot_name(*robot)).switched_off.clone_from(&known.switched_off);
            }
        }
    }
}

/// Divisor of a recording's points, because a calibration has about eight numbers.
const CALIBRATION_SHARE: usize = 8;

/// Of a live session.
const OLDER_CALIBRATIONS: usize = 200;

pub(super) struct Calibrations {
    policy: RetentionPolicy,
    robots: BoundedMap<RobotId, RobotCalibration>,
}

struct RobotCalibration {
    rows: Vec<CalibrationRow>,
    /// Once a second; of a long session fewer.
    history: RetainedSeries<Vec<CalibrationRow>>,
    /// Only robots with an estimate are shown.
    is_estimated: bool,
    has_changed: bool,
}

impl Calibrations {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        // Live one is current; the others are older.
        let policy = setting.retention.for_seconds(1, CALIBRATION_SHARE);
        Self { policy, robots: BoundedMap::default() }
    }

    fn robot(&mut self, robot: RobotId) -> Option<&mut RobotCalibration> {
        self.robots.get_or_insert(robot, || RobotCalibration::new(self.policy));
        let robots = self.robots.entries.len();
        let policy = self.policy.shared_by(robots);
        let known = self.robots.entries.get_mut(&robot)?;
        known.history.set_policy(policy);
        known.history.share_older(robots);
        Some(known)
    }
}

impl RobotCalibration {
    fn new(policy: RetentionPolicy) -> Self {
        // As many as the page keeps of the beginning; they change slowly.
        let older = OlderPolicy { max_points: OLDER_CALIBRATIONS, weight: |_: &Vec<CalibrationRow>| 0.0 };
        let history = RetainedSeries::new(policy).with_older(Some(older));
        Self { rows: Vec::new(), history, is_estimated: false, has_changed: false }
    }

    fn push_rows(&mut self, now: Timestamp<HostClock>, rows: &[CalibrationRow]) {
        let t_s = seconds_of(now);
        let rows: Vec<CalibrationRow> = rows.iter().map(|row| CalibrationRow { t_s, ..row.clone() }).collect();
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
            ViewInput::Status(status) => {
                for one in &status.robots {
                    if let Some(known) = self.robot(one.robot) {
                        known.push_rows(now, &one.calibration);
                    }
                }
            }
            ViewInput::Event(_) | ViewInput::Truth(_) => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        for (robot, known) in self.robots.entries.iter_mut().filter(|(_, known)| known.is_estimated) {
            let is_due = std::mem::take(&mut known.has_changed) || content == FrameContent::DeltaAndSummary;
            if is_due && !known.rows.is_empty() {
                frame.robot(&robot_name(*robot)).calibration = Some(known.rows.clone());
            }
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, known) in self.robots.entries.iter().filter(|(_, known)| known.is_estimated) {
            let rows = known.history.retained().concat();
            if !rows.is_empty() {
                history.robot(&robot_name(*robot)).calibration = Some(rows);
            }
        }
    }

    fn dropped(&self) -> u64 {
        self.robots.ignored
    }
}
