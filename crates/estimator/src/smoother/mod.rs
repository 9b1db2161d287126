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
mod trajectory;

use posebridge_telemetry::{Observation, ObservationKind};

pub use self::batch::batch;
pub use self::cramer_rao::{ArrivedObservation, GroundTruthRun, cramer_rao_bound};
pub use self::trajectory::{OfflineError, SmoothedPose, SmoothedTrajectory};
use crate::filter::FilterConfig;
use crate::filters::pose::smoother::{SmoothedState, smooth};

/// The pose filter run forwards and back: its estimate at each instant, given the rest of the run as well. Unlike
/// [`batch()`] it uses every kind of observation, and treats outliers and slip as the filter does; it keeps to the
/// filter's linearisation, and is a little less exact where much was uncertain. There is one pose per motion reading
/// and per absolute observation that was used; `cost` is the sum of the NIS of these in the forward pass, and
/// `fixes_used` and `fixes_rejected` count landmarks and ranges too; `iterations` and `gyro_windows` are 1 and 0.
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
