//! The contract of every filter: its configuration, its inputs, and its estimates.

use std::sync::Arc;

use posebridge_telemetry::{
    Arena, ArenaMap, BrickClock, Calibration, DriveGeometry, Estimate, FusionOutcome, FusionRecord, Observation,
    OnlineCalibration, Pose, ScalarEstimate, SensorNoise, Timestamp,
};

use crate::params::Params;

/// What every filter does.
pub trait Filter: Send {
    /// Uses an observation at its own time, however late it came, and says what became of it.
    fn observe(&mut self, observation: &Observation) -> FusionRecord;

    /// Moves the estimate, after everything that was observed up to [`Filter::latest_time`]; counted as a reset.
    ///
    /// [`FusionOutcome::PoseReset`], or [`FusionOutcome::Malformed`] when a number is not finite or a standard deviation is negative:
    /// nothing is then changed.
    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome;

    /// Changes what the filter goes by, after everything that was observed up to [`Filter::latest_time`].
    ///
    /// [`FusionOutcome::Accepted`], or [`FusionOutcome::Unused`] from a filter that cannot do this while it runs: nothing is then changed.
    fn apply_command(&mut self, adjustment: &FilterCommand) -> FusionOutcome {
        let _ = adjustment;
        FusionOutcome::Unused
    }

    /// The brick's clock starts anew: what was observed is forgotten, the pose is kept with more doubt.
    fn restart_clock(&mut self);

    /// The latest stamp of an observation.
    fn latest_time(&self) -> Option<Timestamp<BrickClock>>;

    /// The estimate for an instant: past ones as far as the history reaches, later ones by prediction. `None` before the first
    /// observation and for instants older than the history.
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate>;

    /// What it has learned about the robot; `None` for a filter that learns nothing.
    fn calibration(&self) -> Option<Calibration> {
        None
    }

    /// The estimate of a filter that follows one quantity instead of a pose, for an instant; `None` for the others.
    fn scalar_at(&self, stamp: Timestamp<BrickClock>) -> Option<ScalarEstimate> {
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
pub enum FilterCommand {
    /// Go by these tunables from now on. What comes late after this is used with them, too, and so is what it makes the filter go
    /// through again.
    SetParams(Params),
    /// Know no longer where the robot is; counted as a reset. The next fixes decide.
    ResetPose,
    /// Take the robot's constants as they stand, or learn them further.
    SetOnlineCalibration(OnlineCalibration),
    /// Forget what was learned about the robot, its gyro's bias included: begin again from the configured calibration.
    ResetCalibration,
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
    pub arena_map: Arc<ArenaMap>,
}
