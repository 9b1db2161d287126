//! Offline estimation over a complete run, and the bound of any filter's error: not for use while a robot drives.
//!
//! [`cramer_rao_bound`] uses no filter's code, so that filters can be compared with it.
//!
//! Source: docs/maths/pose.md sections 11 and B5.

pub mod cramer_rao;
mod nominal;
mod trajectory;

use posebridge_telemetry::{Observation, ObservationKind, TimeDelta};

pub use self::cramer_rao::{ArrivedObservation, GroundTruthRun, cramer_rao_bound};
pub use self::trajectory::{Convergence, OfflineError, SmoothedPose, SmoothedTrajectory};
use crate::filter::FilterConfig;
use crate::filters::pose::smoother::{MAX_PASSES, Smoothing, smooth_with_lag, smooth_with_passes};
use crate::validation;

/// The pose at each instant of a run given all of it, with every observation and every state of the pose filter. Errors: nothing moved,
/// neither start nor observation gives a position, or the configuration is not finite.
pub fn smooth(config: &FilterConfig, observations: &[Observation]) -> Result<SmoothedTrajectory, OfflineError> {
    smooth_in_passes(config, observations, MAX_PASSES)
}

/// The same with another limit of the passes; one pass is the filter's, and back.
pub fn smooth_in_passes(
    config: &FilterConfig,
    observations: &[Observation],
    max_passes: u32,
) -> Result<SmoothedTrajectory, OfflineError> {
    checked(config, observations, |config| smooth_with_passes(config, observations, max_passes))
}

/// The pose at each instant given the observations up to `lag` later. Without a lag it is the filter's, and with one beyond the run
/// that of the smoother's first pass. Errors as of [`smooth`].
pub fn smooth_fixed_lag(
    config: &FilterConfig,
    observations: &[Observation],
    lag: TimeDelta,
) -> Result<SmoothedTrajectory, OfflineError> {
    checked(config, observations, |config| smooth_with_lag(config, observations, lag))
}

fn checked(
    config: &FilterConfig,
    observations: &[Observation],
    smooth: impl FnOnce(&FilterConfig) -> Smoothing,
) -> Result<SmoothedTrajectory, OfflineError> {
    if !is_valid_config(config) {
        return Err(OfflineError::NotFinite);
    }
    let smoothing = smooth(config);
    let fixes =
        observations.iter().filter(|observation| matches!(observation.measurement, ObservationKind::Fix(_))).count();
    if smoothing.poses.is_empty() || (config.start.is_none() && smoothing.used == 0) {
        return Err(OfflineError::NothingObserved { motion_readings: smoothing.poses.len(), fixes });
    }
    let is_finite =
        |at: &SmoothedPose| at.pose.x.0.is_finite() && at.covariance.iter().flatten().all(|value| value.is_finite());
    if !smoothing.poses.iter().all(is_finite) {
        return Err(OfflineError::NotFinite);
    }
    Ok(SmoothedTrajectory {
        poses: smoothing.poses,
        calibration: smoothing.calibration,
        cost: smoothing.cost,
        iterations: smoothing.passes,
        fixes_used: smoothing.used,
        fixes_rejected: smoothing.rejected,
        convergence: smoothing.convergence,
    })
}

/// Whether geometry, start and priors are finite and physically possible.
fn is_valid_config(config: &FilterConfig) -> bool {
    let (geometry, calibration) = (&config.geometry, &config.calibration);
    let lengths = [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0, geometry.track_width.0];
    let known = nominal::constants_of(calibration);
    lengths.iter().all(|length| length.is_finite() && *length > 0.0)
        && config.start.is_none_or(|start| validation::is_valid_start(&start))
        && known.iter().all(|known| known.value.is_finite() && known.sigma.is_finite() && known.sigma >= 0.0)
}
