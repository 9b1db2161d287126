//! Offline estimation over a complete run, and the bound of any filter's error: not for use while a robot drives.
//!
//! Neither [`batch()`] nor [`cramer_rao_bound`] uses a filter's code, so that filters can be compared with them.
//!
//! Source: docs/maths/pose.md; Rauch, Tung, Striebel (1965) for [`rts`].

pub mod batch;
pub mod cramer_rao;
mod factors;
mod forward_pass;
mod posterior;
mod problem;

use posebridge_telemetry::{Arena, BrickClock, Calibration, Observation, ObservationKind, Pose, Timestamp};

pub use self::batch::batch;
pub use self::cramer_rao::{FixArrival, FixContent, GroundTruthRun, cramer_rao_bound};
use crate::filter::FilterConfig;
use crate::filters::pose::smoother::{SmoothedState, smooth};

/// The most likely path and calibration of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SmoothedTrajectory {
    /// One per motion reading, in the order of their stamps; of [`rts`] one per fix as well.
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

/// The pose filter run forwards and back: its estimate at each instant, given the rest of the run as well.
///
/// Unlike [`batch()`] it uses every kind of observation that the filter uses, treats outliers and slip as the filter does, and keeps
/// to the filter's linearisation: cheaper and nearer to the filter, a little less exact where much was uncertain. Observations may
/// come in any order; one pose per motion reading and per absolute observation that was used. In the result, `cost` is the sum of the NIS of the used absolute observations in the
/// forward pass; `fixes_used` and `fixes_rejected` count all of these, landmarks and ranges too; `iterations` and
/// `gyro_windows` are 1 and 0.
///
/// Errors: nothing moved, neither start nor fix gives a position, or the configuration is not finite.
pub fn rts(config: &FilterConfig, observations: &[Observation]) -> Result<SmoothedTrajectory, OfflineError> {
    if !batch::is_valid_config(config) {
        return Err(OfflineError::NotFinite);
    }
    let smoothing = smooth(config, observations);
    let fixes =
        observations.iter().filter(|observation| matches!(observation.measurement, ObservationKind::Fix(_))).count();
    if smoothing.states.is_empty() || (config.start.is_none() && smoothing.used == 0) {
        return Err(OfflineError::NothingObserved { motion_readings: smoothing.states.len(), fixes });
    }
    let is_finite = |hindsight: &SmoothedState| {
        let covariance = &hindsight.state.covariance;
        hindsight.state.pose.x_m.is_finite() && covariance.iter().all(|value| value.is_finite())
    };
    if !smoothing.states.iter().all(is_finite) {
        return Err(OfflineError::NotFinite);
    }
    let poses = smoothing.states.iter().map(|hindsight| {
        let published = hindsight.state.published_covariance();
        SmoothedPose {
            stamp: hindsight.stamp,
            pose: hindsight.state.arena_pose(),
            covariance: [0, 1, 2].map(|row| [0, 1, 2].map(|column| published[row][column])),
        }
    });
    Ok(SmoothedTrajectory {
        poses: poses.collect(),
        calibration: smoothing.calibration,
        cost: smoothing.nis,
        iterations: 1,
        fixes_used: smoothing.used,
        fixes_rejected: smoothing.rejected,
        gyro_windows: 0,
    })
}
