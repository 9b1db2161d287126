//! Further estimators of a robot, which follow it beside the one whose estimates are sent.
//!
//! Gets what the robot's own estimator gets, gives events alone. The inputs wait here until the robot has its estimate:
//! no comparison delays that.

use posebridge_estimator::{FilterCommand, FilterConfig, FilterEntry, Initialization};
use posebridge_telemetry::{DriveGeometry, Estimate, Event, Observation, RobotId, SensorId, SensorSwitch, StartPose};

use crate::estimator::Estimator;

/// An input of an estimator, or the instant to report its estimate.
#[derive(Clone, Debug)]
pub(crate) enum EstimatorInput {
    Observation(Observation),
    /// The robot's own estimate was published. `start` is its pose, for filters that are still without one.
    Published {
        start: Option<StartPose>,
    },
    SetPose(StartPose),
    Command(Box<FilterCommand>),
    SwitchSensor(SensorId, SensorSwitch),
    SetGeometry(DriveGeometry),
    RestartClock,
}

/// The estimators in the order of the configuration, and their common inputs, oldest first.
#[derive(Default)]
pub(crate) struct ComparedEstimators {
    estimators: Vec<ComparedEstimator>,
    pending: Vec<EstimatorInput>,
}

struct ComparedEstimator {
    estimator: Estimator,
    /// It uses no fixes and has no start yet.
    needs_start: bool,
}

impl ComparedEstimators {
    pub(crate) fn new(entries: &[&'static FilterEntry], config: &FilterConfig) -> Self {
        let estimators = entries.iter().map(|entry| ComparedEstimator {
            estimator: Estimator::new(entry, config),
            needs_start: entry.initialization == Initialization::Start && config.start.is_none(),
        });
        Self { estimators: estimators.collect(), pending: Vec::new() }
    }

    pub(crate) fn filters(&self) -> impl Iterator<Item = &'static str> {
        self.estimators.iter().map(|compared| compared.estimator.entry.name)
    }

    /// Queues an input until [`Self::process`].
    pub(crate) fn push(&mut self, input: EstimatorInput) {
        if !self.estimators.is_empty() {
            self.pending.push(input);
        }
    }

    /// Queues the publication of the robot's own estimate.
    pub(crate) fn push_published(&mut self, own: &Estimate) {
        let needs_start = self.estimators.iter().any(|compared| compared.needs_start);
        self.push(EstimatorInput::Published { start: if needs_start { own.start_pose() } else { None } });
    }

    pub(crate) const fn has_pending(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Passes the queued inputs to every estimator.
    pub(crate) fn process(&mut self, robot: RobotId, mut emit: impl FnMut(Event)) {
        for input in self.pending.drain(..) {
            for compared in &mut self.estimators {
                compared.handle(robot, &input, &mut emit);
            }
        }
    }
}

impl ComparedEstimator {
    fn handle(&mut self, robot: RobotId, input: &EstimatorInput, emit: &mut impl FnMut(Event)) {
        let estimator = &mut self.estimator;
        let filter = estimator.entry.name;
        match input {
            EstimatorInput::Observation(observation) => {
                let record = estimator.observe(observation).record;
                emit(Event::ObservationCompared { robot, filter, record });
            }
            EstimatorInput::Published { start } => {
                if let Some(start) = start.filter(|_| std::mem::take(&mut self.needs_start)) {
                    estimator.set_pose(&start);
                }
                if let Some(estimate) = estimator.latest_estimate() {
                    emit(Event::EstimateCompared { robot, filter, estimate });
                }
            }
            // A command that a filter does not support leaves it as it is; the robot's own filter has answered.
            EstimatorInput::SetPose(pose) => {
                estimator.set_pose(pose);
            }
            EstimatorInput::Command(command) => {
                estimator.apply(command);
            }
            EstimatorInput::SwitchSensor(sensor, to) => estimator.switch_sensor(*sensor, *to),
            EstimatorInput::SetGeometry(geometry) => estimator.set_geometry(*geometry),
            EstimatorInput::RestartClock => estimator.restart_clock(),
        }
    }
}
