//! The result of smoothing a run, and why there may be none.

use posebridge_telemetry::{Arena, BrickClock, Calibration, Pose, Timestamp};

/// The path and the calibration of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SmoothedTrajectory {
    /// One after each motion reading and one after each absolute observation, in the order of their stamps.
    pub poses: Vec<SmoothedPose>,
    /// The estimated constants; the others are as configured. The gyro bias is that at the end.
    pub calibration: Calibration,
    /// Sum of the squared residuals of the absolute observations over their noise; those left out count as the gate.
    pub cost: f64,
    /// Passes forwards and back.
    pub iterations: u32,
    /// Absolute observations of any kind.
    pub fixes_used: usize,
    /// Those that contradict all others.
    pub fixes_rejected: usize,
    pub convergence: Convergence,
}

/// The smoothed pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedPose {
    pub stamp: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// Covariance of x, y and heading in the arena: m², m rad, rad².
    pub covariance: [[f64; 3]; 3],
}

/// Whether another pass would change the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Convergence {
    /// No pose has moved by a hundredth of its sigma in the last pass, with the same observations.
    Converged,
    /// The path is that of least cost so far.
    Moving {
        /// The largest move of a pose in the last pass.
        sigmas: f64,
        /// Whether the last pass used other observations than the one before.
        has_changed: bool,
    },
    /// There was no second pass, or its numbers were not finite.
    SinglePass,
}

impl Convergence {
    /// Why the path has not converged; `None` where it has.
    pub fn shortfall(&self) -> Option<String> {
        match self {
            Self::Converged => None,
            Self::Moving { has_changed: true, .. } => {
                Some("each pass leaves out other observations: this is the best path so far".to_owned())
            }
            Self::Moving { sigmas, has_changed: false } => {
                Some(format!("a pose still moves by {sigmas:.2} sigmas in a pass: this is the best path so far"))
            }
            Self::SinglePass => Some("one pass only: a second one had no finite result".to_owned()),
        }
    }
}

/// Why a run cannot be smoothed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OfflineError {
    /// There is no motion reading, or neither a start nor a fix.
    #[error("nothing to smooth: {motion_readings} motion readings, {fixes} fixes and no start")]
    NothingObserved { motion_readings: usize, fixes: usize },
    /// The configuration or its noise is not finite.
    #[error("the configuration leads to numbers that are not finite")]
    NotFinite,
}
