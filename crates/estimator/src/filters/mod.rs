//! Every filter: a trait, a file each, and the one table that names them.

mod intake;
pub mod odometry;
pub mod pose;

use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Estimate, FusionRecord, Observation, Pose, SensorNoise,
    Stamp, Verdict,
};

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

    /// The brick's clock starts anew: what was observed is forgotten, the pose is kept with more doubt.
    fn restart_clock(&mut self);

    /// The latest instant of which an observation spoke.
    fn latest(&self) -> Option<Stamp<BrickClock>>;

    /// The belief for an instant: past ones as far as the history reaches, later ones by prediction. `None` before the first
    /// observation and for instants older than the history.
    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate>;
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

/// What a filter is built from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterConfig {
    /// The robot's nominal geometry.
    pub geometry: DriveGeometry,
    /// The noise of its sensors and motion.
    pub noise: SensorNoise,
    /// Where it starts; without it the first fixes decide.
    pub start: Option<StartPose>,
    /// The tunables.
    pub params: Params,
}

/// One row of [`FILTERS`].
pub struct FilterEntry {
    /// Its name in the configuration and in reports.
    pub name: &'static str,
    /// What it is, in one line.
    pub summary: &'static str,
    /// Builds one.
    pub build: fn(&FilterConfig) -> Box<dyn Filter>,
}

/// Every filter. Adding one: a file beside this one and a line here.
pub const FILTERS: &[FilterEntry] = &[
    FilterEntry {
        name: "odometry",
        summary: "dead reckoning by the wheels alone, as a brick does it",
        build: |config| Box::new(odometry::OdometryFilter::new(config)),
    },
    FilterEntry {
        name: "pose",
        summary: "error-state EKF with speeds, gyro bias, exact replay of late fixes and a gate",
        build: |config| Box::new(pose::PoseFilter::new(config)),
    },
];

/// The row with this name.
#[must_use]
pub fn filter_named(name: &str) -> Option<&'static FilterEntry> {
    FILTERS.iter().find(|entry| entry.name == name)
}
