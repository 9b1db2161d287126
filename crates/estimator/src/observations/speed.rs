//! Forward speed and turn rate, observed by wheels, gyro and accelerometers: for prediction, not for the pose.
//!
//! ```text
//! forward  z = d / dt             h(x) = v            R = ((r tick)^2 / 12 + var d) / dt^2 + floor
//! turn     z = dth / dt           h(x) = w            R = ((r tick / b)^2 / 3 + var dth) / dt^2 + floor
//! gyro     z = rate - b_g         h(x) = w            R = sigma_g^2 + res^2 / 12 + var b_g + floor
//! accelerometers   v <- v + a dt          var v <- var v + (sigma_a dt)^2 / 2
//!                  w <- w + alpha dt      var w <- var w + 2 (sigma_a dt / b)^2
//! ```
//! The difference of two floored counts has variance tick²/6; the mean of two wheels a half of that. Accelerations are
//! an input and replace the random walk of the speeds.
//!
//! Source: docs/maths/pose.md section 5; paper 1 (Valera et al.), equations 20 to 22, for the accelerations.

use posebridge_telemetry::{DriveGeometry, SensorNoise};
use serde::{Deserialize, Serialize};

use super::gyro_window::{gyro_variance, rounding_variance};
use crate::models::differential_drive::StepNoise;
use crate::models::planar_speeds::Acceleration;
use crate::models::se2::BodyStep;
use crate::saved::{finite, not_negative};

/// Least variance of a speed, (mm/s)²: a wheel at rest may still creep within its backlash.
const MIN_FORWARD_VARIANCE: f64 = 1e-6;
/// The same for the turn rate, (0.1 degrees/s)².
const MIN_TURN_VARIANCE: f64 = 3e-6;

/// A speed with its variance, m/s or rad/s: measured, or estimated outside the covariance matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Speed {
    #[serde(deserialize_with = "finite")]
    pub value: f64,
    #[serde(deserialize_with = "not_negative")]
    pub variance: f64,
}

impl Speed {
    /// Updates an estimate.
    pub fn observe(&mut self, reading: Self) {
        let s = self.variance + reading.variance;
        if s > 0.0 {
            let gain = self.variance / s;
            self.value += gain * (reading.value - self.value);
            self.variance *= 1.0 - gain;
        }
    }
}

pub fn forward_reading(step: BodyStep, step_noise: &StepNoise, dt_s: f64, geometry: &DriveGeometry) -> Speed {
    let tick_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0) * geometry.tick.0;
    let variance = (tick_m * tick_m / 12.0 + step_noise.forward_var_m2) / (dt_s * dt_s) + MIN_FORWARD_VARIANCE;
    Speed { value: step.forward_m / dt_s, variance }
}

/// The wheels' turn rate over a step.
pub fn turn_reading(step: BodyStep, step_noise: &StepNoise, dt_s: f64, geometry: &DriveGeometry) -> Speed {
    // Both ends are rounded.
    let quantisation = 2.0 * rounding_variance(geometry);
    let variance = (quantisation + step_noise.turn_var_rad2) / (dt_s * dt_s) + MIN_TURN_VARIANCE;
    Speed { value: step.turn_rad / dt_s, variance }
}

/// The gyro's rate without its estimated bias and scale, with the variance of all three. Bias and scale are given as value and
/// variance.
pub fn gyro_reading(rate_rad_per_s: f64, bias: Speed, scale: Speed, noise: &SensorNoise) -> Speed {
    let factor = 1.0 + scale.value;
    let value = (rate_rad_per_s - bias.value) / factor;
    let of_rate = (gyro_variance(noise, 1.0) + bias.variance) / (factor * factor);
    Speed { value, variance: of_rate + value * value * scale.variance + MIN_TURN_VARIANCE }
}

/// Changes of forward speed and turn rate, and of their variances, over an interval.
pub fn speed_changes(felt: Acceleration, dt_s: f64, geometry: &DriveGeometry, noise: &SensorNoise) -> [Speed; 2] {
    let b = geometry.track_width.0;
    let sigma = noise.accelerometer_m_per_s2 * dt_s;
    [
        Speed { value: felt.forward_m_per_s2 * dt_s, variance: 0.5 * sigma * sigma },
        Speed { value: felt.turn_rad_per_s2 * dt_s, variance: 2.0 * sigma * sigma / (b * b) },
    ]
}
