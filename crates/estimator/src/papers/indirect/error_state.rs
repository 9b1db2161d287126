//! The errors that the indirect filter follows: of the wheels' path, of the geometry, of the instruments beside it.
//!
//! # Model
//! ```text
//! error = true - nominal for the path; reading - true for the instruments
//! row  e_x e_y e_th e_s | m dr tb | p_s c_v b_v | p_w c_w b_w | g b_g
//!      path, m m rad m  | geometry | accelerometers: distance, | gyro: angle, bias
//!                       |          | speed, bias; angle, rate, bias
//!
//! step of the nominal path, with the wheels' travel t_L, t_R over dt:
//!   s_L = t_L (1 + m - dr/2)   s_R = t_R (1 + m + dr/2)   d = (s_L + s_R)/2   dth = (s_R - s_L)/(b (1 + tb))
//! e' = F e + Gamma w:
//!   e_x' = e_x + dx/dth0 e_th + dx/dd D c + dx/d(dth) T c      c = [m, dr, tb]    (e_y alike)
//!   e_th' = e_th + T c         e_s' = e_s + D c                D = dd/dc   T = d(dth)/dc
//!   p' = p + c dt + b dt^2/2   c' = c + b dt                   g' = g + b_g dt
//! ```
//! Source: Paper 4, equations 9 to 12 and 21 to 22 (F, Gamma, Q in general form); the choice of states is ours: docs/lab/indirect.md section M2.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{DriveGeometry, SensorNoise};

use crate::models::differential_drive::{StepNoise, WheelTravel, calibrated_step, step_noise};
use crate::models::se2::{BodyStep, Displacement, StepRule, displace};
use crate::observations::gyro_window::gyro_variance;
use crate::papers::rows;

// Rows; the module's head has their units. Speed and bias follow a distance or an angle.

pub const N: usize = 15;
pub const X: usize = 0;
pub const Y: usize = 1;
pub const HEADING: usize = 2;
pub const DISTANCE: usize = 3;
pub const RADIUS_SCALE: usize = 4;
pub const RADIUS_DIFFERENCE: usize = 5;
pub const TRACK_SCALE: usize = 6;
pub const ACCELERATED_DISTANCE: usize = 7;
pub const ACCELERATED_SPEED: usize = 8;
pub const FORWARD_BIAS: usize = 9;
pub const ACCELERATED_ANGLE: usize = 10;
pub const ACCELERATED_TURN: usize = 11;
pub const TURN_BIAS: usize = 12;
pub const GYRO_ANGLE: usize = 13;
pub const GYRO_BIAS: usize = 14;

pub type ErrorState = SVector<f64, N>;
pub type Covariance = SMatrix<f64, N, N>;

/// Systematic errors of the geometry: mean radius, difference of the radii, track width.
pub type GeometryScales = [f64; 3];

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NominalStep {
    pub step: BodyStep,
    pub displacement: Displacement,
    /// D: derivatives of the distance by the scales, m.
    pub forward_by_scales: GeometryScales,
    /// T: derivatives of the change of heading by the scales, rad.
    pub turn_by_scales: GeometryScales,
    pub noise: StepNoise,
    /// Variance of each coordinate because the order of distance and turn is unknown.
    pub path_var_m2: f64,
}

/// Sampling intervals of the instruments during a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleIntervals {
    pub dt_s: f64,
    /// Sum of the squared intervals of the gyro's samples: white noise per sample adds up by these.
    pub gyro_s2: f64,
    /// The same of the accelerometers' samples.
    pub accelerometer_s2: f64,
}

pub fn nominal_step(
    heading_rad: f64,
    travel: WheelTravel,
    scales: &GeometryScales,
    geometry: &DriveGeometry,
    noise: &SensorNoise,
) -> NominalStep {
    let moved = calibrated_step(travel, geometry, *scales);
    NominalStep {
        step: moved.step,
        displacement: displace(heading_rad, moved.step, StepRule::Arc),
        forward_by_scales: moved.forward_by_scales,
        turn_by_scales: moved.turn_by_scales,
        noise: step_noise(moved.travel, geometry, noise),
        path_var_m2: 0.0,
    }
}

impl NominalStep {
    /// The same step with another turn before the scales, without the jitter of the counts. A derivative that follows
    /// that jitter is correlated with the innovation: a robot that drives straight would learn a wrong track width.
    pub fn with_turn(mut self, turn_rad: f64, scales: &GeometryScales, track_width_m: f64) -> Self {
        let [_, _, tb] = *scales;
        self.forward_by_scales[1] = 0.25 * turn_rad * track_width_m * (1.0 + tb);
        self.turn_by_scales[0] = turn_rad;
        self.turn_by_scales[2] = -turn_rad / (1.0 + tb);
        self
    }
}

pub fn transition(nominal: &NominalStep, dt_s: f64) -> Covariance {
    let mut f = Covariance::identity();
    let moved = &nominal.displacement;
    f[(X, HEADING)] = moved.by_heading[0];
    f[(Y, HEADING)] = moved.by_heading[1];
    for (k, row) in [RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE].into_iter().enumerate() {
        let (d, t) = (nominal.forward_by_scales[k], nominal.turn_by_scales[k]);
        f[(X, row)] = moved.by_forward[0] * d + moved.by_turn[0] * t;
        f[(Y, row)] = moved.by_forward[1] * d + moved.by_turn[1] * t;
        f[(HEADING, row)] = t;
        f[(DISTANCE, row)] = d;
    }
    for first in [ACCELERATED_DISTANCE, ACCELERATED_ANGLE] {
        f[(first, first + 1)] = dt_s;
        f[(first, first + 2)] = 0.5 * dt_s * dt_s;
        f[(first + 1, first + 2)] = dt_s;
    }
    f[(GYRO_ANGLE, GYRO_BIAS)] = dt_s;
    f
}

pub fn process_noise(
    nominal: &NominalStep,
    elapsed: &SampleIntervals,
    geometry: &DriveGeometry,
    noise: &SensorNoise,
) -> Covariance {
    let mut q = Covariance::zeros();
    let moved = &nominal.displacement;
    // Gamma: how each row of the path takes the noise of distance and of turn.
    let gamma = [
        (X, moved.by_forward[0], moved.by_turn[0]),
        (Y, moved.by_forward[1], moved.by_turn[1]),
        (HEADING, 0.0, 1.0),
        (DISTANCE, 1.0, 0.0),
    ];
    let of_step = nominal.noise;
    for (row, forward, turn) in gamma {
        for (column, other_forward, other_turn) in gamma {
            q[(row, column)] = forward * other_forward * of_step.forward_var_m2
                + turn * other_turn * of_step.turn_var_rad2
                + (forward * other_turn + turn * other_forward) * of_step.forward_turn_m_rad;
        }
    }
    q[(X, X)] += nominal.path_var_m2;
    q[(Y, Y)] += nominal.path_var_m2;

    let white = noise.accelerometer_m_per_s2.powi(2) * elapsed.accelerometer_s2;
    // The mean of two accelerometers, and their difference over the distance between them.
    let b = geometry.track_width.0;
    for (first, variance) in [(ACCELERATED_DISTANCE, 0.5 * white), (ACCELERATED_ANGLE, 2.0 * white / (b * b))] {
        let dt_s = elapsed.dt_s;
        q[(first, first)] = variance * dt_s * dt_s / 3.0;
        q[(first, first + 1)] = 0.5 * variance * dt_s;
        q[(first + 1, first)] = 0.5 * variance * dt_s;
        q[(first + 1, first + 1)] = variance;
    }
    q[(GYRO_ANGLE, GYRO_ANGLE)] = gyro_variance(noise, elapsed.gyro_s2);
    q[(GYRO_BIAS, GYRO_BIAS)] = noise.gyro_bias_walk_rad_per_s_sqrt_s.powi(2) * elapsed.dt_s;
    q
}

/// Makes a row certain to be zero.
pub fn clear_row(errors: &mut ErrorState, covariance: &mut Covariance, row: usize) {
    errors[row] = 0.0;
    rows::set_independent_variance(covariance, row, 0.0);
}

/// Starts an instrument's row: the reading is set to the nominal value, so its error is the negative of the path's.
pub fn start_row(errors: &mut ErrorState, covariance: &mut Covariance, row: usize, path: usize, rounding_var: f64) {
    errors[row] = -errors[path];
    rows::set_opposite(covariance, row, path, rounding_var);
}
