//! The EKF of paper 1 with its integrated observations put right: errors that stay are states, and all noise has a
//! source.
//!
//! ```text
//! x = [x, y, th, v, w, s, c, g, b]'     the five states of [`super::ekf5`] and, beside them:
//!     s    path that the counters have seen, m            s' = v + slip along the path
//!     c    error of the wheels' heading, rad              c' = slip about the vertical
//!     g    error of the gyro's heading, rad               g' = b + noise of the gyro
//!     b    bias of the gyro, rad/s                        b' = its walk
//! z = [s_enc, th_enc, th_gyro]'         h = [s, th + c, th + g]'
//! R = [(r tick)^2 / 24, (r tick / b_0)^2 / 6, (0.01 degrees)^2]          rounding of the counts alone: it is bounded
//! ```
//! v and w walk with `accel_m_s2` and `turn_acc_rad_s2`, also where accelerations measure their change: one sample of
//! an accelerometer is no mean over the interval. Fixes are not used: `pose` does that better.
//!
//! Source: Augmenting the state with correlated errors: Bar-Shalom, Li and Kirubarajan (2001), chapter 8;
//! docs/lab/square.md section M5.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};
use posebridge_telemetry::{DriveGeometry, FusionOutcome, FusionRecord, StartPose, UncertainValue};

use super::paper_scaffold::{
    GaussianState, GyroStep, OnArrivalFilter, OptionalSensor, SampledContext, SampledFilter, WheelStep,
};
use super::rows;
use crate::filter::{Filter, FilterConfig};
use crate::models::differential_drive::{WheelTravel, step_noise};
use crate::models::planar_speeds::{self, Acceleration};
use crate::motion::UNOBSERVED_M_PER_SQRT_S;
use crate::numerics::covariance::symmetrise;
use crate::observations::gyro_window::gyro_variance;
use crate::update::ScalarMeasurement;

pub const N: usize = 9;
pub const COUNTED_PATH: usize = 5;
pub const WHEEL_HEADING_ERROR: usize = 6;
pub const GYRO_HEADING_ERROR: usize = 7;
pub const GYRO_BIAS: usize = 8;

/// Variance of the integrated gyro beside its error state, (0.01 degrees)²: it keeps S away from zero.
const INTEGRAL_VARIANCE: f64 = 3.046e-8;
/// Sigma of the forward speed before anything is known, m/s: a robot that is switched on is at rest.
const INITIAL_FORWARD_SIGMA: f64 = 0.1;
/// The same for the turn rate, rad/s.
const INITIAL_TURN_SIGMA: f64 = 1.0;

type Mean = SVector<f64, N>;
type Covariance = SMatrix<f64, N, N>;

#[derive(Clone, Copy)]
struct CorrectedEkf {
    mean: Mean,
    covariance: Covariance,
    counted_path_m: f64,
    wheel_heading_rad: f64,
    gyro_heading_rad: f64,
    /// Variances of path, m², and heading, rad², by the rounding of the counts.
    rounding: [f64; 2],
}

pub(crate) fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let bias = config.gyro_bias_prior();
    let mut mean = Mean::zeros();
    mean[GYRO_BIAS] = bias.value;
    let mut covariance = Covariance::zeros();
    covariance[(FORWARD, FORWARD)] = INITIAL_FORWARD_SIGMA * INITIAL_FORWARD_SIGMA;
    covariance[(TURN, TURN)] = INITIAL_TURN_SIGMA * INITIAL_TURN_SIGMA;
    covariance[(GYRO_BIAS, GYRO_BIAS)] = bias.sigma * bias.sigma;
    let maths = CorrectedEkf {
        mean,
        covariance,
        counted_path_m: 0.0,
        wheel_heading_rad: 0.0,
        gyro_heading_rad: 0.0,
        rounding: rounding_variances(&config.geometry),
    };
    Box::new(OnArrivalFilter::new(maths, config))
}

/// Variances of path, m², and heading, rad², when each count is uniform within its tick.
fn rounding_variances(geometry: &DriveGeometry) -> [f64; 2] {
    let tick = geometry.tick.0;
    let left = (geometry.left_wheel_radius.0 * tick).powi(2) / 12.0;
    let right = (geometry.right_wheel_radius.0 * tick).powi(2) / 12.0;
    let b = geometry.track_width.0;
    [0.25 * (left + right), (left + right) / (b * b)]
}

/// F: the derivative of the motion by the state, 9 x 9.
pub fn jacobian(mean: &SVector<f64, N>, dt_s: f64) -> SMatrix<f64, N, N> {
    let mut f = Covariance::identity();
    let five = planar_speeds::jacobian(&five_state_mean(mean), dt_s);
    f.fixed_view_mut::<5, 5>(0, 0).copy_from(&five);
    f[(COUNTED_PATH, FORWARD)] = dt_s;
    f[(GYRO_HEADING_ERROR, GYRO_BIAS)] = dt_s;
    f
}

pub fn advance(mean: &SVector<f64, N>, felt: Acceleration, dt_s: f64) -> SVector<f64, N> {
    let mut next = *mean;
    next.fixed_rows_mut::<5>(0).copy_from(&planar_speeds::advance(&five_state_mean(mean), felt, dt_s));
    next[COUNTED_PATH] += mean[FORWARD] * dt_s;
    next[GYRO_HEADING_ERROR] += mean[GYRO_BIAS] * dt_s;
    next
}

fn five_state_mean(mean: &Mean) -> planar_speeds::Mean {
    mean.fixed_rows::<5>(0).into_owned()
}

impl CorrectedEkf {
    /// Q over `dt_s`. The walks of the speeds move pose and counted path alike; slip distinguishes these two.
    fn process_noise(&self, dt_s: f64, context: &SampledContext) -> Covariance {
        let config = &context.config;
        let (sin, cos) = (self.mean[HEADING] + 0.5 * self.mean[TURN] * dt_s).sin_cos();
        let mut along = Mean::zeros();
        along[X] = cos;
        along[Y] = sin;
        along[COUNTED_PATH] = 1.0;
        let mut about = Mean::zeros();
        about[HEADING] = 1.0;
        let mut q = Covariance::zeros();
        add_random_walk(&mut q, &along, FORWARD, config.params.acceleration_m_per_s2, dt_s);
        add_random_walk(&mut q, &about, TURN, config.params.turn_acceleration_rad_per_s2, dt_s);
        let forward_m = self.mean[FORWARD] * dt_s;
        let half_turn_m = 0.5 * self.mean[TURN] * dt_s * config.geometry.track_width.0;
        let travel = WheelTravel { left_m: forward_m - half_turn_m, right_m: forward_m + half_turn_m };
        let slip = step_noise(travel, &config.geometry, &config.noise);
        q[(COUNTED_PATH, COUNTED_PATH)] += slip.forward_var_m2;
        q[(WHEEL_HEADING_ERROR, WHEEL_HEADING_ERROR)] += slip.turn_var_rad2;
        q[(COUNTED_PATH, WHEEL_HEADING_ERROR)] += slip.forward_turn_m_rad;
        q[(WHEEL_HEADING_ERROR, COUNTED_PATH)] += slip.forward_turn_m_rad;
        q[(GYRO_BIAS, GYRO_BIAS)] += bias_walk(config) * dt_s;
        q
    }

    /// Unobserved motion of this variance along the heading, which the counters measure all the same.
    fn add_unobserved_path(&mut self, variance: f64) {
        let (sin, cos) = self.mean[HEADING].sin_cos();
        self.covariance[(COUNTED_PATH, COUNTED_PATH)] += variance;
        for (row, share) in [(X, cos), (Y, sin)] {
            self.covariance[(row, COUNTED_PATH)] += share * variance;
            self.covariance[(COUNTED_PATH, row)] += share * variance;
        }
    }

    /// Sets the error of a heading integral that restarts at th: that of th with the other sign.
    fn restart_heading_error(&mut self, error: usize, variance: f64) {
        self.mean[error] = 0.0;
        rows::set_opposite(&mut self.covariance, error, HEADING, variance);
    }

    fn restart_wheel_heading(&mut self) {
        self.counted_path_m = 0.0;
        self.mean[COUNTED_PATH] = 0.0;
        rows::set_independent_variance(&mut self.covariance, COUNTED_PATH, self.rounding[0]);
        self.wheel_heading_rad = self.mean[HEADING];
        self.restart_heading_error(WHEEL_HEADING_ERROR, self.rounding[1]);
    }

    fn restart_gyro_heading(&mut self) {
        self.gyro_heading_rad = self.mean[HEADING];
        self.restart_heading_error(GYRO_HEADING_ERROR, 0.0);
    }
}

/// Growth of the gyro bias's variance per second, (rad/s)²/s.
fn bias_walk(config: &FilterConfig) -> f64 {
    config.noise.gyro_bias_walk_rad_per_s_sqrt_s.powi(2)
}

/// Adds white acceleration of this density to a speed and to the states that it moves.
fn add_random_walk(q: &mut Covariance, moved: &Mean, row: usize, density: f64, dt_s: f64) {
    let variance = density * density * dt_s;
    *q += moved * moved.transpose() * (variance * dt_s * dt_s / 3.0);
    for other in 0..N {
        q[(other, row)] += moved[other] * variance * dt_s / 2.0;
        q[(row, other)] += moved[other] * variance * dt_s / 2.0;
    }
    q[(row, row)] += variance;
}

impl SampledFilter for CorrectedEkf {
    fn uses(&self, extra: OptionalSensor) -> bool {
        extra != OptionalSensor::Camera
    }

    fn gaussian_state(&self, _context: &SampledContext) -> GaussianState {
        GaussianState {
            mean: five_state_mean(&self.mean),
            covariance: self.covariance.fixed_view::<5, 5>(0, 0).into_owned(),
        }
    }

    fn gyro_bias(&self) -> Option<UncertainValue> {
        Some(UncertainValue {
            value: self.mean[GYRO_BIAS],
            sigma: self.covariance[(GYRO_BIAS, GYRO_BIAS)].max(0.0).sqrt(),
        })
    }

    fn initialize_pose(&mut self, start: &StartPose) {
        rows::initialize_pose(&mut self.mean, &mut self.covariance, start);
        self.restart_wheel_heading();
        self.restart_gyro_heading();
    }

    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, context: &SampledContext) {
        let speeds = [INITIAL_FORWARD_SIGMA.powi(2), INITIAL_TURN_SIGMA.powi(2)];
        rows::reset_speeds(&mut self.mean, &mut self.covariance, position_m, heading_rad, speeds);
        let bias_sigma = context.config.noise.gyro_bias_rad_per_s;
        rows::set_independent_variance(&mut self.covariance, GYRO_BIAS, bias_sigma * bias_sigma);
        self.restart_wheel_heading();
        self.restart_gyro_heading();
    }

    fn predict(&mut self, dt_s: f64, felt: Acceleration, context: &SampledContext) {
        let f = jacobian(&self.mean, dt_s);
        let q = self.process_noise(dt_s, context);
        self.mean = advance(&self.mean, felt, dt_s);
        self.covariance = f * self.covariance * f.transpose() + q;
        symmetrise(&mut self.covariance);
    }

    fn predict_unobserved(&mut self, dt_s: f64, context: &SampledContext) {
        let config = &context.config;
        // The gyro may go on, and its bias with it.
        let mut f = Covariance::identity();
        f[(GYRO_HEADING_ERROR, GYRO_BIAS)] = dt_s;
        self.mean = f * self.mean;
        self.covariance = f * self.covariance * f.transpose();
        rows::add_unobserved_motion(&mut self.covariance, dt_s);
        self.add_unobserved_path(UNOBSERVED_M_PER_SQRT_S.powi(2) * dt_s);
        // The speeds afterwards do not depend on the earlier prediction: a path that was missed is no error of theirs.
        for (row, density) in
            [(FORWARD, config.params.acceleration_m_per_s2), (TURN, config.params.turn_acceleration_rad_per_s2)]
        {
            let variance = self.covariance[(row, row)] + density * density * dt_s;
            rows::set_independent_variance(&mut self.covariance, row, variance);
        }
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] += bias_walk(config) * dt_s;
        symmetrise(&mut self.covariance);
    }

    fn bridge_gap(&mut self, speeds: [f64; 2], path_m2: f64) {
        rows::bridge_gap(&mut self.mean, &mut self.covariance, speeds, path_m2);
        // They are measured, and as independent of what was predicted before.
        for (row, sigma) in [(FORWARD, INITIAL_FORWARD_SIGMA), (TURN, INITIAL_TURN_SIGMA)] {
            rows::set_independent_variance(&mut self.covariance, row, sigma * sigma);
        }
    }

    fn rebase_wheels(&mut self, _context: &SampledContext) {
        self.restart_wheel_heading();
    }

    fn rebase_gyro(&mut self) {
        self.restart_gyro_heading();
    }

    fn use_wheels(&mut self, step: &WheelStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let body = step.body_step(&context.config.geometry);
        self.counted_path_m += body.forward_m;
        self.wheel_heading_rad += body.turn_rad;
        let expected_rad = self.mean[HEADING] + self.mean[WHEEL_HEADING_ERROR];
        let scalars = [
            ScalarMeasurement {
                innovation: self.counted_path_m - self.mean[COUNTED_PATH],
                rows: [COUNTED_PATH, WHEEL_HEADING_ERROR],
                jacobian: [1.0, 0.0],
                variance: self.rounding[0],
            },
            ScalarMeasurement {
                innovation: self.wheel_heading_rad - expected_rad,
                rows: [HEADING, WHEEL_HEADING_ERROR],
                jacobian: [1.0, 1.0],
                variance: self.rounding[1],
            },
        ];
        rows::apply_all(&mut self.mean, &mut self.covariance, &scalars, record)
    }

    fn use_gyro(&mut self, step: &GyroStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let noise = &context.config.noise;
        self.covariance[(GYRO_HEADING_ERROR, GYRO_HEADING_ERROR)] += gyro_variance(noise, step.dt_s * step.dt_s);
        self.gyro_heading_rad += step.rate_rad_per_s * step.dt_s;
        let expected_rad = self.mean[HEADING] + self.mean[GYRO_HEADING_ERROR];
        let scalar = ScalarMeasurement {
            innovation: self.gyro_heading_rad - expected_rad,
            rows: [HEADING, GYRO_HEADING_ERROR],
            jacobian: [1.0, 1.0],
            variance: INTEGRAL_VARIANCE,
        };
        rows::apply_all(&mut self.mean, &mut self.covariance, &[scalar], record)
    }
}
