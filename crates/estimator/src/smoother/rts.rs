//! The pose filter run forwards and back: its estimate at each instant, given the rest of the run as well.
//!
//! Unlike [`super::batch()`] it uses every kind of observation that the filter uses, treats outliers and slip as the filter does,
//! and keeps to the filter's linearisation: cheaper and nearer to the filter, a little less exact where much was uncertain.
//!
//! Source: docs/maths/pose.md section 11; Rauch, Tung, Striebel (1965).

use posebridge_telemetry::{Observation, ObservationKind};

use super::batch::is_valid_config;
use super::trajectory::{OfflineError, SmoothedPose, SmoothedTrajectory};
use crate::filter::FilterConfig;
use crate::filters::pose::smoother::{SmoothedState, smooth};

/// Smooths a run with the pose filter. Observations may come in any order; one pose per motion reading and per absolute
/// observation that was used. In the result, `cost` is the sum of the NIS of the used absolute observations in the
/// forward pass; `fixes_used` and `fixes_rejected` count all of these, landmarks and ranges too; `iterations` and
/// `gyro_windows` are 1 and 0.
///
/// Errors: nothing moved, neither start nor fix gives a position, or the configuration is not finite.
pub fn rts(config: &FilterConfig, observations: &[Observation]) -> Result<SmoothedTrajectory, OfflineError> {
    if !is_valid_config(config) {
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
