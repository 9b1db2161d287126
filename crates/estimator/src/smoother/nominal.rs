//! What the bound takes of a configuration: the constants, and the motion that they lead to.

use posebridge_telemetry::{Calibration, DriveGeometry, Meters, UncertainValue};

use crate::filter::FilterConfig;
use crate::models::differential_drive::{CalibratedStep, WheelTravel, calibrated_step};

/// Least sigma of a bias, in rad/s.
const MIN_SIGMA: f64 = 1e-7;
/// Sigma of an unknown start, m: anywhere on a large site. Fixes then decide.
pub(super) const UNKNOWN_POSITION_SIGMA_M: f64 = 1e4;

pub(super) const CONSTANTS: usize = 6;
const TRACK_SCALE: usize = 2;

/// The constants of a calibration, in the order of their numbers.
pub(super) fn constants_of(calibration: &Calibration) -> [UncertainValue; CONSTANTS] {
    [
        calibration.radius_scale,
        calibration.radius_difference,
        calibration.track_scale,
        calibration.fix_delay_s,
        calibration.tag_forward_m,
        calibration.tag_left_m,
    ]
}

/// The gyro's bias at the start, never certain.
pub(super) fn bias_prior(config: &FilterConfig) -> UncertainValue {
    let prior = config.gyro_bias_prior();
    UncertainValue { sigma: prior.sigma.max(MIN_SIGMA), ..prior }
}

/// The body step of wheel travel with these calibration constants.
pub(super) fn calibrated_motion(
    travel: WheelTravel,
    config: &FilterConfig,
    constants: &[f64; CONSTANTS],
) -> CalibratedStep {
    let [radius, difference, track, ..] = *constants;
    calibrated_step(travel, &config.geometry, [radius, difference, track])
}

/// The geometry with the track width of these constants.
pub(super) fn true_geometry(config: &FilterConfig, constants: &[f64; CONSTANTS]) -> DriveGeometry {
    let track_m = config.geometry.track_width.0 * (1.0 + constants[TRACK_SCALE]);
    DriveGeometry { track_width: Meters(track_m), ..config.geometry }
}
