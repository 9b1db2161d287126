//! What the detector knows of a robot.

use posebridge_telemetry::DriveGeometry;

use crate::filter::FilterConfig;

/// A gyro's bias is known no better than this.
const MIN_BIAS_SIGMA_RAD_PER_S: f64 = 0.02;

#[derive(Clone, Copy, Debug)]
pub(super) struct Settings {
    pub(super) geometry: DriveGeometry,
    pub(super) gyro_bias_rad_per_s: f64,
    pub(super) gyro_bias_sigma_rad_per_s: f64,
    pub(super) fix_sigma_m: f64,
    pub(super) heading_sigma_rad: f64,
    pub(super) max_wheel_rad_per_s: f64,
    pub(super) backlash_rad: f64,
}

impl Settings {
    pub(super) fn new(config: &FilterConfig) -> Self {
        let bias = config.gyro_bias_prior();
        let backlash = config.calibration.backlash_rad;
        Self {
            geometry: config.geometry,
            gyro_bias_rad_per_s: bias.value,
            gyro_bias_sigma_rad_per_s: bias.sigma.max(MIN_BIAS_SIGMA_RAD_PER_S),
            fix_sigma_m: config.noise.fix_position_m.hypot(config.noise.fix_persistent_m),
            heading_sigma_rad: config.noise.fix_heading_rad,
            max_wheel_rad_per_s: config.params.max_wheel_rad_per_s,
            backlash_rad: backlash.value.abs() + 2.0 * backlash.sigma,
        }
    }
}
