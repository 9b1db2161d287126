//! Every filter: a trait, a file each, and the one table that names them.

pub mod dynamic;
pub mod ekf5;
pub mod ekf5_corrected;
pub mod indirect;
pub(crate) mod intake;
pub mod odometry;
pub mod paper1;
pub mod pose;
pub mod range_kf;
mod records;
mod sampled;
pub mod thermometer;
mod timeline;
pub mod ukf5;
pub mod velocity_kf;
pub mod wheel_kf;

use std::sync::Arc;

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, DriveGeometry, Estimate, FusionRecord, Learning, Observation, Pose, ScalarEstimate,
    SensorNoise, Stamp, Verdict, World,
};

use self::ekf5::{Fixes, SpeedOrder};
use crate::params::Params;

/// What every filter does.
pub trait Filter: Send {
    /// Uses an observation at its own time, however late it came, and says what became of it.
    fn observe(&mut self, observation: &Observation) -> FusionRecord;

    /// Moves the estimate, after everything that was observed up to [`Filter::latest`]; counted as a reset.
    ///
    /// [`Verdict::ResetTo`], or [`Verdict::Malformed`] when a number is not finite or a standard deviation is negative:
    /// nothing is then changed.
    #[must_use]
    fn set_pose(&mut self, start: &StartPose) -> Verdict;

    /// Changes what the filter goes by, after everything that was observed up to [`Filter::latest`].
    ///
    /// [`Verdict::Accepted`], or [`Verdict::Unused`] from a filter that cannot do this while it runs: nothing is then changed.
    #[must_use]
    fn adjust(&mut self, adjustment: &Adjustment) -> Verdict {
        let _ = adjustment;
        Verdict::Unused
    }

    /// The brick's clock starts anew: what was observed is forgotten, the pose is kept with more doubt.
    fn restart_clock(&mut self);

    /// The latest instant of which an observation spoke.
    fn latest(&self) -> Option<Stamp<BrickClock>>;

    /// The belief for an instant: past ones as far as the history reaches, later ones by prediction. `None` before the first
    /// observation and for instants older than the history.
    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate>;

    /// What it has learned about the robot; `None` for a filter that learns nothing.
    fn calibration(&self) -> Option<Calibration> {
        None
    }

    /// The belief of a filter that follows one quantity instead of a pose, for an instant; `None` for the others.
    fn scalar_at(&self, stamp: Stamp<BrickClock>) -> Option<ScalarEstimate> {
        let _ = stamp;
        None
    }
}

/// Where a robot starts, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartPose {
    /// The pose.
    pub pose: Pose<Arena>,
    /// One standard deviation of x and of y, in metres.
    pub position_sigma_m: f64,
    /// One standard deviation of the heading, in radians.
    pub heading_sigma_rad: f64,
}

/// What a person changes about a filter that runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Adjustment {
    /// Go by these tunables from now on. What comes late after this is used with them, too, and so is what it makes the filter go
    /// through again.
    Params(Params),
    /// Know no longer where the robot is; counted as a reset. The next fixes decide.
    ForgetPose,
    /// Take the robot's constants as they stand, or learn them further.
    Learning(Learning),
    /// Forget what was learned about the robot, its gyro's bias included: begin again from the configured calibration.
    ForgetCalibration,
}

/// What a filter is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterConfig {
    /// The robot's nominal geometry.
    pub geometry: DriveGeometry,
    /// The noise of its sensors and motion.
    pub noise: SensorNoise,
    /// Where it starts; without it the first fixes decide.
    pub start: Option<StartPose>,
    /// The tunables.
    pub params: Params,
    /// What is known beforehand about systematic errors, and how well. A sigma of zero: taken as given, not estimated.
    pub calibration: Calibration,
    /// What stands in the arena.
    pub world: Arc<World>,
}

/// One row of [`FILTERS`].
pub struct FilterEntry {
    /// Its name in the configuration and in reports.
    pub name: &'static str,
    /// What it is, in one line.
    pub summary: &'static str,
    /// What it estimates.
    pub estimates: Estimates,
    /// What it does with an observation that comes late.
    pub late: Late,
    /// How it comes to know where the robot is.
    pub placing: Placing,
    /// Builds one.
    pub build: fn(&FilterConfig) -> Box<dyn Filter>,
}

/// What a filter estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimates {
    /// The robot's pose, by [`Filter::estimate_at`].
    Pose,
    /// One quantity, by [`Filter::scalar_at`].
    Scalar,
}

/// How a filter comes to know where the robot is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placing {
    /// By the first fix, or by [`FilterConfig::start`].
    Fix,
    /// By [`FilterConfig::start`] or [`Filter::set_pose`] alone: it uses no fixes, and without either its pose is never valid.
    Start,
    /// It estimates no pose.
    Nowhere,
}

/// What a filter does with an observation that comes late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Late {
    /// It is used at its own time: the order of arrival does not matter.
    Replayed,
    /// It is used when it comes, as the paper does it.
    OnArrival,
}

/// Every filter. Adding one: a file beside this one and a line here.
pub const FILTERS: &[FilterEntry] = &[
    FilterEntry {
        name: "odometry",
        summary: "dead reckoning by the wheels alone, as a brick does it",
        estimates: Estimates::Pose,
        late: Late::Replayed,
        placing: Placing::Start,
        build: |config| Box::new(odometry::OdometryFilter::new(config)),
    },
    FilterEntry {
        name: "pose",
        summary: "error-state EKF on SE(2) that learns gyro bias, wheels and track, with exact replay of late fixes",
        estimates: Estimates::Pose,
        late: Late::Replayed,
        placing: Placing::Fix,
        build: pose::build,
    },
    FilterEntry {
        name: "wheel-kf",
        summary: "paper 1: a Kalman filter per wheel, then odometry",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Start,
        build: wheel_kf::build,
    },
    FilterEntry {
        name: "velocity-kf",
        summary: "paper 1: a Kalman filter for both speeds with the accelerations as input, then odometry",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Start,
        build: velocity_kf::build,
    },
    FilterEntry {
        name: "ekf5",
        summary: "paper 1: pose and speeds in one EKF, with integrated headings as observations",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Start,
        build: |config| ekf5::build(config, SpeedOrder::Printed, Fixes::Unused),
    },
    FilterEntry {
        name: "ekf5-camera",
        summary: "paper 1 and its outlook: ekf5 with gated fixes, used when they come",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Fix,
        build: |config| ekf5::build(config, SpeedOrder::Printed, Fixes::Used),
    },
    FilterEntry {
        name: "ekf5-corrected",
        summary: "ekf5 with the errors of its integrated headings as states and configured noise",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Start,
        build: ekf5_corrected::build,
    },
    FilterEntry {
        name: "ukf5",
        summary: "ekf5 with sigma points in place of the Jacobian",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Start,
        build: ukf5::build,
    },
    FilterEntry {
        name: "dynamic",
        summary: "paper 2: the final value of a slow thermometer, from its approach",
        estimates: Estimates::Scalar,
        late: Late::OnArrival,
        placing: Placing::Nowhere,
        build: |config| Box::new(dynamic::DynamicFilter::new(config)),
    },
    FilterEntry {
        name: "dynamic-live",
        summary: "paper 2 left running: finds each new approach, and learns how slow the thermometer is",
        estimates: Estimates::Scalar,
        late: Late::OnArrival,
        placing: Placing::Nowhere,
        build: |config| {
            let settings = thermometer::ThermometerSettings::default();
            Box::new(thermometer::Thermometer::new(config, &settings))
        },
    },
    FilterEntry {
        name: "range-kf",
        summary: "paper 3: distance to a wall from time of flight and motor input, as printed",
        estimates: Estimates::Scalar,
        late: Late::OnArrival,
        placing: Placing::Nowhere,
        build: |config| Box::new(range_kf::RangeFilter::new(config, range_kf::Variant::Paper)),
    },
    FilterEntry {
        name: "range-kf-corrected",
        summary: "paper 3 with noise per second, an exact hold and readings at their own time",
        estimates: Estimates::Scalar,
        late: Late::OnArrival,
        placing: Placing::Nowhere,
        build: |config| Box::new(range_kf::RangeFilter::new(config, range_kf::Variant::Corrected)),
    },
    FilterEntry {
        name: "indirect",
        summary: "paper 4: errors of the wheels' path by accelerometers and gyro, fed forward",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Fix,
        build: |config| {
            let correction = indirect::Correction::FeedForward;
            Box::new(indirect::IndirectFilter::new(config, correction))
        },
    },
    FilterEntry {
        name: "indirect-feedback",
        summary: "the same with the errors fed back into the path",
        estimates: Estimates::Pose,
        late: Late::OnArrival,
        placing: Placing::Fix,
        build: |config| {
            let correction = indirect::Correction::Feedback;
            Box::new(indirect::IndirectFilter::new(config, correction))
        },
    },
];

/// The row with this name.
#[must_use]
pub fn filter_named(name: &str) -> Option<&'static FilterEntry> {
    FILTERS.iter().find(|entry| entry.name == name)
}
