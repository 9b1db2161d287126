//! The result of smoothing a run, and why there may be none.

use posebridge_telemetry::{Arena, BrickClock, Calibration, Pose, Timestamp};

/// The most likely path of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SmoothedTrajectory {
    /// One per motion reading, in the order of their stamps; of [`super::rts()`] one per fix as well.
    pub poses: Vec<SmoothedPose>,
    /// What fits best; what is not estimated is as it was configured. The gyro bias is that of the last window.
    pub calibration: Calibration,
    /// Sum of the squared residuals over their sigmas, at the optimum.
    pub cost: f64,
    /// Steps of the descent, over all rounds.
    pub iterations: u32,
    /// How many fixes were used.
    pub fixes_used: usize,
    /// How many fixes were refused by the gate, or lie outside the motion readings.
    pub fixes_rejected: usize,
    /// How many gyro windows were used.
    pub gyro_windows: usize,
}

/// Where the robot was at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedPose {
    /// The instant of a motion reading.
    pub stamp: Timestamp<BrickClock>,
    /// The most likely pose.
    pub pose: Pose<Arena>,
    /// Covariance of x, y and heading in the arena: m², m rad, rad².
    pub covariance: [[f64; 3]; 3],
}

/// Why there is no smoothed path.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OfflineError {
    /// There is no motion reading, or neither a start nor a fix.
    #[error("nothing to smooth: {motion_readings} motion readings, {fixes} fixes and no start")]
    NothingObserved {
        /// How many motion readings could be used.
        motion_readings: usize,
        /// How many fixes between the first and the last of them.
        fixes: usize,
    },
    /// The descent does not become still.
    #[error("the descent does not converge: the cost stays at {cost}")]
    Diverged {
        /// Where it ended.
        cost: f64,
    },
    /// The configuration or its noise leads to numbers that are none.
    #[error("the configuration leads to numbers that are not finite")]
    NotFinite,
}
