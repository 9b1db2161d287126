//! Forward speed from the wheels, turn rate from wheels or gyro: for prediction, not for the pose.
//!
//! ```text
//! forward  z = d / dt             h(x) = v            R = ((r tick)^2 / 12 + var d) / dt^2 + floor
//! turn     z = dth / dt           h(x) = w            R = ((r tick / b)^2 / 3 + var dth) / dt^2 + floor
//! gyro     z = rate               h(x) = w + b_g      R = sigma_g^2 + res^2 / 12 + floor
//! ```
//! The difference of two floored counts has variance tick²/6; the mean of two wheels a half of that.
//!
//! Source: docs/maths/pose.md section 5.

use nalgebra::{Matrix1, SMatrix, Vector1};
use posebridge_telemetry::{DriveGeometry, SensorNoise};

use super::gyro_window::{encoder_quantisation_variance, gyro_variance};
use crate::filters::pose::state::{FORWARD, GYRO_BIAS, Mean, N, TURN};
use crate::models::differential_drive::StepNoise;
use crate::models::se2::BodyStep;
use crate::update::Measurement;

/// Variance below which no speed is believed, (mm/s)²: a wheel that stands may still creep within its backlash.
const FORWARD_FLOOR: f64 = 1e-6;
/// The same for the turn rate, (0.1 degrees/s)².
const TURN_FLOOR: f64 = 3e-6;

/// The wheels' forward speed over a step.
#[must_use]
pub fn forward(
    mean: &Mean,
    step: BodyStep,
    step_noise: &StepNoise,
    dt_s: f64,
    geometry: &DriveGeometry,
) -> Measurement<N, 1> {
    let tick_m =
        0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0) * geometry.tick.0;
    let variance =
        (tick_m * tick_m / 12.0 + step_noise.forward_var_m2) / (dt_s * dt_s) + FORWARD_FLOOR;
    row(step.forward_m / dt_s - mean[FORWARD], &[FORWARD], variance)
}

/// The wheels' turn rate over a step.
#[must_use]
pub fn turn(
    mean: &Mean,
    step: BodyStep,
    step_noise: &StepNoise,
    dt_s: f64,
    geometry: &DriveGeometry,
) -> Measurement<N, 1> {
    let quantisation = encoder_quantisation_variance(geometry);
    let variance = (quantisation + step_noise.turn_var_rad2) / (dt_s * dt_s) + TURN_FLOOR;
    row(step.turn_rad / dt_s - mean[TURN], &[TURN], variance)
}

/// The gyro's rate.
#[must_use]
pub fn gyro(mean: &Mean, rate_rad_per_s: f64, noise: &SensorNoise) -> Measurement<N, 1> {
    let innovation = rate_rad_per_s - mean[TURN] - mean[GYRO_BIAS];
    row(
        innovation,
        &[TURN, GYRO_BIAS],
        gyro_variance(noise, 1.0) + TURN_FLOOR,
    )
}

fn row(innovation: f64, rows: &[usize], variance: f64) -> Measurement<N, 1> {
    let mut jacobian = SMatrix::<f64, 1, N>::zeros();
    for &row in rows {
        jacobian[(0, row)] = 1.0;
    }
    Measurement {
        innovation: Vector1::new(innovation),
        jacobian,
        noise: Matrix1::new(variance),
    }
}
