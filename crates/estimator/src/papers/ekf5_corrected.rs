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
//! an accelerometer is no mean over the interval.
//!
//! With a camera (`ekf5-camera-corrected`) three more errors that stay are states, with the sigmas of the calibration:
//!
//! ```text
//!     rho  scale of the wheels' radii        s' = v (1 - rho)
//!     tau  scale of the track                c' = (tau - rho) w
//!     del  delay of the camera, s            h = pose at t - del, at constant speeds
//! ```
//! Because th, c and g are states, P holds how an error of the heading has moved x and y, and
//! positions correct the heading. Fixes that the gate rejects one after the other move the pose when they agree among
//! themselves: `rejected_fixes.rs`.
//!
//! With all sensors (`ukf-all`) P is carried by sigma points, and two more states are the compass's deviation by iron
//! that turns with the robot: h = th + d_s sin th + d_c cos th.
//!
//! Source: Augmenting the state with correlated errors: Bar-Shalom, Li and Kirubarajan (2001), chapter 8;
//! docs/lab/square.md section M5.

use nalgebra::{SMatrix, SVector, Vector2};
use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Calibration, DriveGeometry, Fix, FusionOutcome, FusionRecord, StartPose, UncertainValue};
use serde::{Deserialize, Serialize};

use super::paper_scaffold::{
    FixStep, GaussianState, GyroStep, OnArrivalFilter, OptionalSensor, SampledContext, SampledFilter, WheelStep,
};
use super::rejected_fixes::{RejectedFix, RejectedFixes};
use super::rows::{self, position_in_arena};
use super::sigma_points;
use crate::filter::{Filter, FilterConfig};
use crate::models::differential_drive::{WheelTravel, step_noise};
use crate::models::planar_speeds::{self, Acceleration};
use crate::motion::UNOBSERVED_M_PER_SQRT_S;
use crate::numerics::covariance::symmetrise;
use crate::observations::fix::{FixNoise, fix_noise, lever_in_arena, mid_axle, with_heading_variance};
use crate::observations::gyro_window::gyro_variance;
use crate::observations::sensor_frame::Exposure;
use crate::saved::{covariance, finite};
use crate::update::{LinearizedMeasurement, ScalarMeasurement};

pub const N: usize = 9;
pub const COUNTED_PATH: usize = 5;
pub const WHEEL_HEADING_ERROR: usize = 6;
pub const GYRO_HEADING_ERROR: usize = 7;
pub const GYRO_BIAS: usize = 8;
/// Rows of the filter with a camera.
pub const CAMERA_N: usize = 12;
const RADIUS_SCALE: usize = 9;
const TRACK_SCALE: usize = 10;
const FIX_DELAY: usize = 11;
/// Rows of the filter with all sensors.
const ALL_N: usize = 14;
/// Amplitudes of the compass's deviation, rad: of sin th and of cos th.
const COMPASS_DEVIATION: [usize; 2] = [12, 13];

/// Variance of the integrated gyro beside its error state, (0.01 degrees)²: it keeps S away from zero.
const INTEGRAL_VARIANCE: f64 = 3.046e-8;
/// Sigma of the forward speed before anything is known, m/s: a robot that is switched on is at rest.
const INITIAL_FORWARD_SIGMA: f64 = 0.1;
/// The same for the turn rate, rad/s.
const INITIAL_TURN_SIGMA: f64 = 1.0;

type Mean<const N: usize> = SVector<f64, N>;
type Covariance<const N: usize> = SMatrix<f64, N, N>;

/// The sensors beside wheels, accelerometers and gyro.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AbsoluteSensors {
    None,
    Camera,
    /// And everything by sigma points.
    CameraAndCompass,
}

#[derive(Clone, Copy)]
struct CorrectedEkf<const N: usize> {
    mean: Mean<N>,
    covariance: Covariance<N>,
    counted_path_m: f64,
    wheel_heading_rad: f64,
    gyro_heading_rad: f64,
    /// Variances of path, m², and heading, rad², by the rounding of the counts.
    rounding: [f64; 2],
    absolute: AbsoluteSensors,
    rejected: RejectedFixes,
}

/// What changes in a [`CorrectedEkf`].
#[derive(Clone, Copy, Serialize, Deserialize)]
struct SavedCorrectedEkf<const N: usize> {
    #[serde(deserialize_with = "finite")]
    mean: Mean<N>,
    #[serde(deserialize_with = "covariance")]
    covariance: Covariance<N>,
    #[serde(deserialize_with = "finite")]
    counted_path_m: f64,
    #[serde(deserialize_with = "finite")]
    wheel_heading_rad: f64,
    #[serde(deserialize_with = "finite")]
    gyro_heading_rad: f64,
    rejected: RejectedFixes,
}

pub(crate) fn build(config: &FilterConfig) -> Box<dyn Filter> {
    Box::new(OnArrivalFilter::new(CorrectedEkf::<N>::new(config, AbsoluteSensors::None), config))
}

pub(crate) fn build_with_camera(config: &FilterConfig) -> Box<dyn Filter> {
    Box::new(OnArrivalFilter::new(CorrectedEkf::<CAMERA_N>::new(config, AbsoluteSensors::Camera), config))
}

pub(crate) fn build_with_all_sensors(config: &FilterConfig) -> Box<dyn Filter> {
    let mut maths = CorrectedEkf::<ALL_N>::new(config, AbsoluteSensors::CameraAndCompass);
    for row in COMPASS_DEVIATION {
        maths.covariance[(row, row)] = config.noise.compass_rad.powi(2);
    }
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

/// F: the derivative of the motion by the state.
pub fn jacobian<const N: usize>(mean: &SVector<f64, N>, dt_s: f64) -> SMatrix<f64, N, N> {
    let mut f = Covariance::<N>::identity();
    let five = planar_speeds::jacobian(&five_state_mean(mean), dt_s);
    f.fixed_view_mut::<5, 5>(0, 0).copy_from(&five);
    f[(COUNTED_PATH, FORWARD)] = dt_s;
    f[(GYRO_HEADING_ERROR, GYRO_BIAS)] = dt_s;
    if N >= CAMERA_N {
        f[(COUNTED_PATH, FORWARD)] *= 1.0 - mean[RADIUS_SCALE];
        f[(COUNTED_PATH, RADIUS_SCALE)] = -mean[FORWARD] * dt_s;
        f[(WHEEL_HEADING_ERROR, TURN)] = (mean[TRACK_SCALE] - mean[RADIUS_SCALE]) * dt_s;
        f[(WHEEL_HEADING_ERROR, TRACK_SCALE)] = mean[TURN] * dt_s;
        f[(WHEEL_HEADING_ERROR, RADIUS_SCALE)] = -mean[TURN] * dt_s;
    }
    f
}

pub fn advance<const N: usize>(mean: &SVector<f64, N>, felt: Acceleration, dt_s: f64) -> SVector<f64, N> {
    let mut next = *mean;
    next.fixed_rows_mut::<5>(0).copy_from(&planar_speeds::advance(&five_state_mean(mean), felt, dt_s));
    next[COUNTED_PATH] += mean[FORWARD] * dt_s;
    next[GYRO_HEADING_ERROR] += mean[GYRO_BIAS] * dt_s;
    if N >= CAMERA_N {
        next[COUNTED_PATH] -= mean[RADIUS_SCALE] * mean[FORWARD] * dt_s;
        next[WHEEL_HEADING_ERROR] += (mean[TRACK_SCALE] - mean[RADIUS_SCALE]) * mean[TURN] * dt_s;
    }
    next
}

fn five_state_mean<const N: usize>(mean: &Mean<N>) -> planar_speeds::Mean {
    mean.fixed_rows::<5>(0).into_owned()
}

impl<const N: usize> CorrectedEkf<N> {
    fn new(config: &FilterConfig, absolute: AbsoluteSensors) -> Self {
        let bias = config.gyro_bias_prior();
        let mut mean = Mean::<N>::zeros();
        mean[GYRO_BIAS] = bias.value;
        let mut covariance = Covariance::<N>::zeros();
        covariance[(FORWARD, FORWARD)] = INITIAL_FORWARD_SIGMA * INITIAL_FORWARD_SIGMA;
        covariance[(TURN, TURN)] = INITIAL_TURN_SIGMA * INITIAL_TURN_SIGMA;
        covariance[(GYRO_BIAS, GYRO_BIAS)] = bias.sigma * bias.sigma;
        if N >= CAMERA_N {
            let calibration = &config.calibration;
            for (row, prior) in [
                (RADIUS_SCALE, calibration.radius_scale),
                (TRACK_SCALE, calibration.track_scale),
                (FIX_DELAY, calibration.fix_delay_s),
            ] {
                mean[row] = prior.value;
                covariance[(row, row)] = prior.sigma * prior.sigma;
            }
        }
        Self {
            mean,
            covariance,
            counted_path_m: 0.0,
            wheel_heading_rad: 0.0,
            gyro_heading_rad: 0.0,
            rounding: rounding_variances(&config.geometry),
            absolute,
            rejected: RejectedFixes::default(),
        }
    }

    /// Q over `dt_s`. The walks of the speeds move pose and counted path alike; slip distinguishes these two.
    fn process_noise(&self, dt_s: f64, context: &SampledContext) -> Covariance<N> {
        let config = &context.config;
        let (sin, cos) = (self.mean[HEADING] + 0.5 * self.mean[TURN] * dt_s).sin_cos();
        let mut along = Mean::<N>::zeros();
        along[X] = cos;
        along[Y] = sin;
        along[COUNTED_PATH] = 1.0;
        let mut about = Mean::<N>::zeros();
        about[HEADING] = 1.0;
        let mut q = Covariance::<N>::zeros();
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

    fn predict_linearized(&mut self, dt_s: f64, felt: Acceleration, q: &Covariance<N>) {
        let f = jacobian(&self.mean, dt_s);
        self.mean = advance(&self.mean, felt, dt_s);
        self.covariance = f * self.covariance * f.transpose() + q;
        symmetrise(&mut self.covariance);
    }

    fn use_fix_by_sigma_points(
        &mut self,
        fix: &Fix,
        noise: &FixNoise,
        context: &SampledContext,
        record: &mut FusionRecord,
    ) -> FusionOutcome {
        let measured = [fix.position.x.0, fix.position.y.0];
        let (mean, covariance) = (&mut self.mean, &mut self.covariance);
        if let Some(heading) = fix.heading {
            let of_state = |point: &Mean<N>| tag_and_heading(point, fix);
            let Some(predicted) = sigma_points::observe::<N, 3>(mean, covariance, of_state) else {
                return FusionOutcome::Malformed;
            };
            let off = [0, 1].map(|i: usize| measured[i] - predicted.mean[i]);
            let innovation = SVector::from([off[0], off[1], wrap_rad(heading.rad() - predicted.mean[2])]);
            let noise = with_heading_variance(&noise.position, noise.heading_rad2);
            return rows::gate_and_apply_predicted(
                mean,
                covariance,
                &predicted,
                &innovation,
                &noise,
                &context.gates,
                record,
            );
        }
        let of_state = |point: &Mean<N>| tag_and_heading(point, fix).fixed_rows::<2>(0).into_owned();
        let Some(predicted) = sigma_points::observe::<N, 2>(mean, covariance, of_state) else {
            return FusionOutcome::Malformed;
        };
        let innovation = Vector2::from(measured) - predicted.mean;
        rows::gate_and_apply_predicted(
            mean,
            covariance,
            &predicted,
            &innovation,
            &noise.position,
            &context.gates,
            record,
        )
    }

    /// Moves the pose onto the fixes that were rejected, if they agree with the driven path up to one shift and turn.
    fn relocate(&mut self, step: &FixStep, noise: &FixNoise) -> bool {
        let sigma_m = (0.5 * noise.position.trace()).sqrt();
        let Some(turn) = self.rejected.common_turn(sigma_m) else {
            return false;
        };
        let heading_rad = self.mean[HEADING] + turn.value;
        self.initialize_pose(&StartPose {
            pose: mid_axle(&step.fix, heading_rad),
            position_sigma_m: sigma_m,
            heading_sigma_rad: turn.sigma,
        });
        true
    }
}

/// What a fix shows: the tag and the heading before the camera's delay, at constant speeds.
fn tag_and_heading<const N: usize>(mean: &Mean<N>, fix: &Fix) -> SVector<f64, 3> {
    let then = planar_speeds::advance(&five_state_mean(mean), Acceleration::default(), -mean[FIX_DELAY]);
    let lever = lever_in_arena([fix.tag_in_body.x.0, fix.tag_in_body.y.0], then[HEADING]);
    SVector::from([then[X] + lever[0], then[Y] + lever[1], then[HEADING]])
}

/// Innovation and H of a fix, whose heading counts as expected where it has none.
fn linearized_fix<const N: usize>(mean: &Mean<N>, fix: &Fix, noise: &FixNoise) -> LinearizedMeasurement<N, 3> {
    let five = five_state_mean(mean);
    let then = planar_speeds::advance(&five, Acceleration::default(), -mean[FIX_DELAY]);
    let (position, position_by_then) = position_in_arena::<5>([X, Y, HEADING].map(|row| then[row]), fix);
    let turn_rad = fix.heading.map_or(0.0, |heading| wrap_rad(heading.rad() - then[HEADING]));
    let mut by_then = SMatrix::<f64, 3, 5>::zeros();
    by_then.fixed_rows_mut::<2>(0).copy_from(&position_by_then);
    by_then[(2, HEADING)] = 1.0;
    let mut jacobian = SMatrix::<f64, 3, N>::zeros();
    jacobian.fixed_view_mut::<3, 5>(0, 0).copy_from(&(by_then * planar_speeds::jacobian(&five, -mean[FIX_DELAY])));
    // A longer delay shows the pose further back.
    let (sin, cos) = then[HEADING].sin_cos();
    let back = SVector::<f64, 5>::from([-then[FORWARD] * cos, -then[FORWARD] * sin, -then[TURN], 0.0, 0.0]);
    jacobian.fixed_view_mut::<3, 1>(0, FIX_DELAY).copy_from(&(by_then * back));
    LinearizedMeasurement {
        innovation: SVector::from([position[0], position[1], turn_rad]),
        jacobian,
        noise: with_heading_variance(&noise.position, noise.heading_rad2),
    }
}

/// Growth of the gyro bias's variance per second, (rad/s)²/s.
fn bias_walk(config: &FilterConfig) -> f64 {
    config.noise.gyro_bias_walk_rad_per_s_sqrt_s.powi(2)
}

/// Adds white acceleration of this density to a speed and to the states that it moves.
fn add_random_walk<const N: usize>(q: &mut Covariance<N>, moved: &Mean<N>, row: usize, density: f64, dt_s: f64) {
    let variance = density * density * dt_s;
    *q += moved * moved.transpose() * (variance * dt_s * dt_s / 3.0);
    for other in 0..N {
        q[(other, row)] += moved[other] * variance * dt_s / 2.0;
        q[(row, other)] += moved[other] * variance * dt_s / 2.0;
    }
    q[(row, row)] += variance;
}

impl<const N: usize> SampledFilter for CorrectedEkf<N> {
    type Saved = SavedCorrectedEkf<N>;

    fn saved(&self) -> SavedCorrectedEkf<N> {
        let Self {
            mean,
            covariance,
            counted_path_m,
            wheel_heading_rad,
            gyro_heading_rad,
            rounding: _,
            absolute: _,
            rejected,
        } = *self;
        SavedCorrectedEkf { mean, covariance, counted_path_m, wheel_heading_rad, gyro_heading_rad, rejected }
    }

    fn with_saved(&self, saved: SavedCorrectedEkf<N>) -> Self {
        let SavedCorrectedEkf { mean, covariance, counted_path_m, wheel_heading_rad, gyro_heading_rad, rejected } =
            saved;
        Self { mean, covariance, counted_path_m, wheel_heading_rad, gyro_heading_rad, rejected, ..*self }
    }

    fn uses(&self, extra: OptionalSensor) -> bool {
        match extra {
            OptionalSensor::Gyro | OptionalSensor::Accelerometers => true,
            OptionalSensor::Camera => self.absolute != AbsoluteSensors::None,
            OptionalSensor::Compass => self.absolute == AbsoluteSensors::CameraAndCompass,
        }
    }

    fn gaussian_state(&self, _context: &SampledContext) -> GaussianState {
        GaussianState {
            mean: five_state_mean(&self.mean),
            covariance: self.covariance.fixed_view::<5, 5>(0, 0).into_owned(),
        }
    }

    fn calibration(&self, configured: &Calibration) -> Option<Calibration> {
        let learned =
            |row: usize| UncertainValue { value: self.mean[row], sigma: self.covariance[(row, row)].max(0.0).sqrt() };
        let mut found = Calibration { gyro_bias_rad_per_s: learned(GYRO_BIAS), ..*configured };
        if N >= CAMERA_N {
            found.radius_scale = learned(RADIUS_SCALE);
            found.track_scale = learned(TRACK_SCALE);
            found.fix_delay_s = learned(FIX_DELAY);
        }
        Some(found)
    }

    fn initialize_pose(&mut self, start: &StartPose) {
        rows::initialize_pose(&mut self.mean, &mut self.covariance, start);
        self.rejected = RejectedFixes::default();
        self.restart_wheel_heading();
        self.restart_gyro_heading();
    }

    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, context: &SampledContext) {
        let speeds = [INITIAL_FORWARD_SIGMA.powi(2), INITIAL_TURN_SIGMA.powi(2)];
        rows::reset_speeds(&mut self.mean, &mut self.covariance, position_m, heading_rad, speeds);
        let bias_sigma = context.config.noise.gyro_bias_rad_per_s;
        rows::set_independent_variance(&mut self.covariance, GYRO_BIAS, bias_sigma * bias_sigma);
        // Their stamps are those of the clock before.
        self.rejected = RejectedFixes::default();
        self.restart_wheel_heading();
        self.restart_gyro_heading();
    }

    fn predict(&mut self, dt_s: f64, felt: Acceleration, context: &SampledContext) {
        let q = self.process_noise(dt_s, context);
        if self.absolute != AbsoluteSensors::CameraAndCompass {
            self.predict_linearized(dt_s, felt, &q);
        } else if let Some((mean, covariance)) =
            sigma_points::predict(&self.mean, &self.covariance, |point| advance(point, felt, dt_s))
        {
            self.mean = mean;
            self.covariance = covariance + q;
        } else {
            // P has no square root. Without its correlations it is a covariance again.
            self.covariance = Covariance::<N>::from_diagonal(&self.covariance.diagonal().map(f64::abs));
            self.predict_linearized(dt_s, felt, &q);
        }
    }

    fn predict_unobserved(&mut self, dt_s: f64, context: &SampledContext) {
        let config = &context.config;
        // The gyro may go on, and its bias with it.
        let mut f = Covariance::<N>::identity();
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

    fn bridge_gap(&mut self, speeds: [f64; 2], path_m2: f64, _context: &SampledContext) {
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

    fn use_fix(&mut self, step: &FixStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let fix = &step.fix;
        let exposure = Exposure::at_speeds(self.mean[FORWARD], self.mean[TURN]);
        let noise = fix_noise(fix, &context.config.noise, [1.0, 1.0], &exposure, step.stamp_sigma_s);
        let expected = tag_and_heading(&self.mean, fix);
        let heading = fix.heading.map(|heading| wrap_rad(heading.rad() - expected[2]));
        let outcome = if self.absolute == AbsoluteSensors::CameraAndCompass {
            self.use_fix_by_sigma_points(fix, &noise, context, record)
        } else {
            let both = linearized_fix(&self.mean, fix, &noise);
            let (mean, covariance, gates) = (&mut self.mean, &mut self.covariance, &context.gates);
            if heading.is_some() {
                rows::gate_and_apply(mean, covariance, &both, gates, record)
            } else {
                let position = LinearizedMeasurement {
                    innovation: both.innovation.fixed_rows::<2>(0).into_owned(),
                    jacobian: both.jacobian.fixed_rows::<2>(0).into_owned(),
                    noise: noise.position,
                };
                rows::gate_and_apply(mean, covariance, &position, gates, record)
            }
        };
        if outcome == FusionOutcome::Accepted {
            self.rejected = RejectedFixes::default();
        } else if outcome == FusionOutcome::Gated {
            self.rejected.push(RejectedFix {
                stamp: step.stamp,
                measured_m: [fix.position.x.0, fix.position.y.0],
                expected_m: [expected[0], expected[1]],
                turn_rad: heading.map(|value| UncertainValue { value, sigma: noise.heading_rad2.sqrt() }),
            });
            if self.relocate(step, &noise) {
                return FusionOutcome::PoseReset;
            }
        }
        outcome
    }

    fn keep_rejection(&mut self, rejecting: &Self) {
        self.rejected = rejecting.rejected;
    }

    fn use_compass(&mut self, measured_rad: f64, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let deviated = |point: &Mean<N>| {
            let (sin, cos) = point[HEADING].sin_cos();
            let [by_sin, by_cos] = COMPASS_DEVIATION.map(|row| point[row]);
            SVector::from([point[HEADING] + by_sin * sin + by_cos * cos])
        };
        let noise = SMatrix::from([[context.config.noise.compass_rad.powi(2)]]);
        let Some(predicted) = sigma_points::observe(&self.mean, &self.covariance, deviated) else {
            return FusionOutcome::Malformed;
        };
        let innovation = SVector::from([wrap_rad(measured_rad - predicted.mean[0])]);
        let (mean, covariance) = (&mut self.mean, &mut self.covariance);
        rows::gate_and_apply_predicted(mean, covariance, &predicted, &innovation, &noise, &context.gates, record)
    }
}
