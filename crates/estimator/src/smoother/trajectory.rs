//! The result of smoothing a run, and why there may be none.

use posebridge_telemetry::{Arena, BrickClock, Calibration, Pose, Timestamp};

/// The most likely path and calibration of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SmoothedTrajectory {
    /// One per motion reading, in the order of their stamps; of [`super::rts`] one per fix as well.
    pub poses: Vec<SmoothedPose>,
    /// The estimated constants; the others are as configured. The gyro bias is that of the last window.
    pub calibration: Calibration,
    /// Sum of the squared residuals over their sigmas, at the optimum.
    pub cost: f64,
    /// Steps of the descent, over all rounds.
    pub iterations: u32,
    pub fixes_used: usize,
    /// Rejected by the gate, or outside the motion readings.
    pub fixes_rejected: usize,
    pub gyro_windows: usize,
}

/// The smoothed pose at one motion reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedPose {
    pub stamp: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// Covariance of x, y and heading in the arena: m², m rad, rad².
    pub covariance: [[f64; 3]; 3],
}

/// Why a run cannot be smoothed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OfflineError {
    /// There is no motion reading, or neither a start nor a fix.
    #[error("nothing to smooth: {motion_readings} motion readings, {fixes} fixes and no start")]
    NothingObserved {
        motion_readings: usize,
        /// Between the first and the last of them.
        fixes: usize,
    },
    #[error("the descent does not converge: the cost stays at {cost}")]
    Diverged { cost: f64 },
    /// The configuration or its noise is not finite.
    #[error("the configuration leads to numbers that are not finite")]
    NotFinite,
}
