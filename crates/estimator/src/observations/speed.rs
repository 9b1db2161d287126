//! Forward speed from the wheels, turn rate from wheels or gyro: for prediction, not for the pose.
//!
//! ```text
//! forward  z = d / dt             h(x) = v            R = ((r tick)^2 / 12 + var d) / dt^2 + floor
//! turn     z = dth / dt           h(x) = w            R = ((r tick / b)^2 / 3 + var dth) / dt^2 + floor
//! gyro     z = rate - b_g         h(x) = w            R = sigma_g^2 + res^2 / 12 + var b_g + floor
//! ```
//! The difference of two floored counts has variance tick²/6; the mean of two wheels a half of that.
//!
//! Source: docs/maths/pose.md section 5.

use posebridge_telemetry::{DriveGeometry, SensorNoise};

use super::gyro_window::{gyro_variance, rounding_variance};
use crate::models::differential_drive::StepNoise;
use crate::models::se2::BodyStep;

/// Variance below which no speed is believed, (mm/s)²: a wheel that stands may still creep within its backlash.
const FORWARD_FLOOR: f64 = 1e-6;
/// The same for the turn rate, (0.1 degrees/s)².
const TURN_FLOOR: f64 = 3e-6;

/// A speed as a sensor tells it: the speed and its variance, m/s or rad/s and their squares.
pub type Reading = (f64, f64);

/// The wheels' forward speed over a step.
#[must_use]
pub fn forward(step: BodyStep, step_noise: &StepNoise, dt_s: f64, geometry: &DriveGeometry) -> Reading {
    let tick_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0) * geometry.tick.0;
    let variance = (tick_m * tick_m / 12.0 + step_noise.forward_var_m2) / (dt_s * dt_s) + FORWARD_FLOOR;
    (step.forward_m / dt_s, variance)
}

/// The wheels' turn rate over a step.
#[must_use]
pub fn turn(step: BodyStep, step_noise: &StepNoise, dt_s: f64, geometry: &DriveGeometry) -> Reading {
    // Both ends are rounded.
    let quantisation = 2.0 * rounding_variance(geometry);
    let variance = (quantisation + step_noise.turn_var_rad2) / (dt_s * dt_s) + TURN_FLOOR;
    (step.turn_rad / dt_s, variance)
}

/// The gyro's rate less its bias, which is known so well.
#[must_use]
pub fn gyro(rate_rad_per_s: f64, (bias_rad_per_s, bias_var): Reading, noise: &SensorNoise) -> Reading {
    (rate_rad_per_s - bias_rad_per_s, gyro_variance(noise, 1.0) + bias_var + TURN_FLOOR)
}
