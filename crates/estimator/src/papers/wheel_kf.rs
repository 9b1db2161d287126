//! One Kalman filter per wheel, then odometry from the filtered wheels: the first filter of paper 1. Uses only the
//! encoders.
//!
//! ```text
//! x = [phi, phidot]'   degrees, degrees/s      F = [ 1 dt ]      C = [ 1 0 ]
//!                                                  [ 0 1  ]
//! Q = diag(0.1, 10) per 0.05 s      R_right = 2.5, R_left = 1.5 degrees^2      x0 = 0, P0 = 10 I
//! d = (s_L + s_R) / 2     dth = (s_R - s_L) / b     pose by the midpoint rule, from the travel of the wheels
//!   angles integrated     s_i = r_i (phi_k - phi_(k-1))
//!   speeds integrated     s_i = r_i phidot_(k-1) dt       equation 13 with the filtered speeds as it is printed
//! ```
//! The paper does not say which. phi_k = phi_(k-1) + phidot_(k-1) dt + K_1 nu: integrated speeds lack every K_1 nu, so
//! their error has no bound.
//!
//! The paper gives the pose no covariance: here it is that of the configured motion noise plus that of the two wheels'
//! filters.
//!
//! Source: Paper 1 (Valera et al.), equations 13 to 19; docs/lab/square.md section M2.

use nalgebra::{Matrix2, Matrix3, SVector, Vector2, Vector3};
use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{FusionOutcome, FusionRecord, StartPose};
use serde::{Deserialize, Serialize};

use super::paper_scaffold::{GaussianState, OnArrivalFilter, OptionalSensor, SampledContext, SampledFilter, WheelStep};
use super::paper1::{SAMPLING_INTERVAL_S, WheelMatrices};
use super::rows;
use crate::filter::{Filter, FilterConfig};
use crate::models::differential_drive::{StepNoise, WheelTravel, body_step, propagate_pose, step_noise};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean};
use crate::numerics::covariance::symmetrise;
use crate::saved::{covariance, finite};
use crate::update::{ScalarMeasurement, UpdateOutcome, use_scalar};
use crate::validation::write_innovation;

const ANGLE: usize = 0;
const RATE: usize = 1;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingleWheelFilter {
    /// [phi, phidot]: rotation in degrees, its rate in degrees/s.
    pub mean: Vector2<f64>,
    pub covariance: Matrix2<f64>,
    variance: f64,
    process: [f64; 2],
}

impl SingleWheelFilter {
    /// The left and the right wheel at rest at zero.
    pub fn pair(matrices: &WheelMatrices) -> [Self; 2] {
        matrices.variances.map(|variance| Self {
            mean: Vector2::zeros(),
            covariance: Matrix2::identity() * matrices.initial,
            variance,
            process: matrices.process,
        })
    }

    pub fn predict(&mut self, dt_s: f64) {
        let f = Matrix2::new(1.0, dt_s, 0.0, 1.0);
        self.mean = f * self.mean;
        self.covariance = f * self.covariance * f.transpose() + self.process_noise(dt_s);
        symmetrise(&mut self.covariance);
    }

    /// Uses a reading of the counter, in degrees, and returns innovation and S; `None` when S is not positive.
    pub fn update(&mut self, counted: f64) -> Option<(f64, f64)> {
        let innovation = counted - self.mean[ANGLE];
        let scalar = ScalarMeasurement { innovation, rows: [ANGLE], jacobian: [1.0], variance: self.variance };
        let outcome = use_scalar(&mut self.mean, &mut self.covariance, &scalar, f64::INFINITY);
        (outcome.outcome == UpdateOutcome::Used).then_some((innovation, outcome.innovation_variance))
    }

    fn process_noise(&self, dt_s: f64) -> Matrix2<f64> {
        Matrix2::from_diagonal(&Vector2::from(self.process)) * (dt_s / SAMPLING_INTERVAL_S)
    }
}

/// What the pose is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelOdometry {
    /// The change of the filtered angles.
    Angles,
    /// The filtered speeds before the step, times its duration.
    Speeds,
}

/// Both wheels, and the pose up to their last reading.
#[derive(Clone, Copy)]
struct WheelKf {
    matrices: WheelMatrices,
    odometry: WheelOdometry,
    wheels: [SingleWheelFilter; 2],
    /// Integral of the filtered speeds: left, right, in degrees.
    rolled_deg: [f64; 2],
    /// The counters' turn since the first base: left, right.
    counted_deg: [f64; 2],
    /// The wheels' angles up to which the pose has been moved, degrees: left, right.
    moved: [f64; 2],
    /// The angles' variance when the pose was given, degrees²: it is no uncertainty of the pose.
    settled: [f64; 2],
    pose: Vector3<f64>,
    pose_covariance: Matrix3<f64>,
}

/// What changes in a [`WheelKf`].
#[derive(Clone, Copy, Serialize, Deserialize)]
struct SavedWheelKf {
    /// Of the left and of the right wheel's filter.
    #[serde(deserialize_with = "finite")]
    means: [Vector2<f64>; 2],
    covariances: [SavedCovariance; 2],
    #[serde(deserialize_with = "finite")]
    rolled_deg: [f64; 2],
    #[serde(deserialize_with = "finite")]
    counted_deg: [f64; 2],
    #[serde(deserialize_with = "finite")]
    moved: [f64; 2],
    #[serde(deserialize_with = "finite")]
    settled: [f64; 2],
    #[serde(deserialize_with = "finite")]
    pose: Vector3<f64>,
    #[serde(deserialize_with = "covariance")]
    pose_covariance: Matrix3<f64>,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
struct SavedCovariance(#[serde(deserialize_with = "covariance")] Matrix2<f64>);

pub fn build(config: &FilterConfig, matrices: &WheelMatrices, odometry: WheelOdometry) -> Box<dyn Filter> {
    let maths = WheelKf {
        matrices: *matrices,
        odometry,
        wheels: SingleWheelFilter::pair(matrices),
        rolled_deg: [0.0; 2],
        counted_deg: [0.0; 2],
        moved: [0.0; 2],
        settled: [matrices.initial; 2],
        pose: Vector3::zeros(),
        pose_covariance: Matrix3::zeros(),
    };
    Box::new(OnArrivalFilter::new(maths, config))
}

impl WheelKf {
    /// The rotation that the pose follows: left, right, in degrees.
    fn driven_deg(&self) -> [f64; 2] {
        match self.odometry {
            WheelOdometry::Angles => self.wheels.map(|wheel| wheel.mean[ANGLE]),
            WheelOdometry::Speeds => self.rolled_deg,
        }
    }

    fn travel(&self, context: &SampledContext) -> WheelTravel {
        let driven = self.driven_deg();
        let [left, right] = [0, 1].map(|wheel: usize| (driven[wheel] - self.moved[wheel]).to_radians());
        WheelTravel::from_rotation(left, right, &context.config.geometry)
    }

    /// The pose after that travel, with the noise of the motion plus `open`.
    fn propagate_pose(&self, open: StepNoise, context: &SampledContext) -> (Vector3<f64>, Matrix3<f64>) {
        let travel = self.travel(context);
        let config = &context.config;
        let step = body_step(travel, &config.geometry);
        let noise = step_noise(travel, &config.geometry, &config.noise);
        let noise = StepNoise {
            forward_var_m2: noise.forward_var_m2 + open.forward_var_m2,
            turn_var_rad2: noise.turn_var_rad2 + open.turn_var_rad2,
            forward_turn_m_rad: noise.forward_turn_m_rad + open.forward_turn_m_rad,
        };
        propagate_pose(&self.pose, &self.pose_covariance, step, &noise)
    }

    /// Variances of the body's motion that follow from those of the wheels, left and right, in degrees².
    fn motion_noise(variances: [f64; 2], context: &SampledContext) -> StepNoise {
        let geometry = &context.config.geometry;
        let radii = [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0];
        let b = geometry.track_width.0;
        let degree = 1.0_f64.to_radians();
        let [left, right] = [0, 1].map(|wheel: usize| (radii[wheel] * degree).powi(2) * variances[wheel]);
        StepNoise {
            forward_var_m2: 0.25 * (left + right),
            turn_var_rad2: (left + right) / (b * b),
            forward_turn_m_rad: (right - left) / (2.0 * b),
        }
    }

    /// The part of the angles' variance that is uncertainty of the pose, left and right, in degrees².
    fn pending_variances(&self) -> [f64; 2] {
        [0, 1].map(|wheel: usize| (self.wheels[wheel].covariance[(ANGLE, ANGLE)] - self.settled[wheel]).max(0.0))
    }

    fn move_pose(&mut self, open: StepNoise, context: &SampledContext) {
        (self.pose, self.pose_covariance) = self.propagate_pose(open, context);
        self.settle();
    }

    /// Moves the pose to the present angles, which no later reading corrects: their variance stays with the pose.
    fn commit_angles(&mut self, context: &SampledContext) {
        self.move_pose(Self::motion_noise(self.pending_variances(), context), context);
    }

    fn settle(&mut self) {
        self.moved = self.driven_deg();
        self.settled = self.wheels.map(|wheel| wheel.covariance[(ANGLE, ANGLE)]);
    }
}

impl SampledFilter for WheelKf {
    type Saved = SavedWheelKf;

    fn saved(&self) -> SavedWheelKf {
        let Self { matrices: _, odometry: _, wheels, rolled_deg, counted_deg, moved, settled, pose, pose_covariance } =
            *self;
        let means = wheels.map(|wheel| wheel.mean);
        let covariances = wheels.map(|wheel| SavedCovariance(wheel.covariance));
        SavedWheelKf { means, covariances, rolled_deg, counted_deg, moved, settled, pose, pose_covariance }
    }

    fn with_saved(&self, saved: SavedWheelKf) -> Self {
        let SavedWheelKf { means, covariances, rolled_deg, counted_deg, moved, settled, pose, pose_covariance } = saved;
        let wheels = std::array::from_fn(|wheel| SingleWheelFilter {
            mean: means[wheel],
            covariance: covariances[wheel].0,
            ..self.wheels[wheel]
        });
        Self { wheels, rolled_deg, counted_deg, moved, settled, pose, pose_covariance, ..*self }
    }

    fn uses(&self, _extra: OptionalSensor) -> bool {
        false
    }

    fn gaussian_state(&self, context: &SampledContext) -> GaussianState {
        // The angles' variance is bounded: it belongs to the pose as it is now and must not be summed up from step to step.
        let open = Self::motion_noise(self.pending_variances(), context);
        let (pose, pose_covariance) = self.propagate_pose(open, context);
        let rates = self.wheels.map(|wheel| wheel.covariance[(RATE, RATE)]);
        let speeds = Self::motion_noise(rates, context);
        let geometry = &context.config.geometry;
        let [left, right] = self.wheels.map(|wheel| wheel.mean[RATE].to_radians());
        let step = body_step(WheelTravel::from_rotation(left, right, geometry), geometry);
        let mut covariance = Covariance::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose_covariance);
        covariance[(row::FORWARD, row::FORWARD)] = speeds.forward_var_m2;
        covariance[(row::TURN, row::TURN)] = speeds.turn_var_rad2;
        covariance[(row::FORWARD, row::TURN)] = speeds.forward_turn_m_rad;
        covariance[(row::TURN, row::FORWARD)] = speeds.forward_turn_m_rad;
        GaussianState { mean: Mean::new(pose[0], pose[1], pose[2], step.forward_m, step.turn_rad), covariance }
    }

    fn initialize_pose(&mut self, start: &StartPose) {
        rows::initialize_pose(&mut self.pose, &mut self.pose_covariance, start);
        self.settle();
    }

    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, context: &SampledContext) {
        self.commit_angles(context);
        rows::inflate_pose(&mut self.pose_covariance, position_m, heading_rad);
        self.wheels = SingleWheelFilter::pair(&self.matrices);
        self.rolled_deg = [0.0; 2];
        self.counted_deg = [0.0; 2];
        self.settle();
    }

    fn predict(&mut self, dt_s: f64, _felt: Acceleration, _context: &SampledContext) {
        for (wheel, rolled) in self.wheels.iter_mut().zip(&mut self.rolled_deg) {
            *rolled += dt_s * wheel.mean[RATE];
            wheel.predict(dt_s);
        }
    }

    fn predict_unobserved(&mut self, dt_s: f64, _context: &SampledContext) {
        for wheel in &mut self.wheels {
            wheel.covariance += wheel.process_noise(dt_s);
        }
        rows::add_unobserved_motion(&mut self.pose_covariance, dt_s);
    }

    fn bridge_gap(&mut self, [forward, turn]: [f64; 2], path_m2: f64, context: &SampledContext) {
        // The counters are cumulative: the next reading contains the whole travel, whatever is predicted until then.
        // Integrated speeds need those of the gap.
        if self.odometry == WheelOdometry::Speeds {
            let geometry = &context.config.geometry;
            let half_turn = 0.5 * turn * geometry.track_width.0;
            let radii = [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0];
            for (i, speed) in [forward - half_turn, forward + half_turn].into_iter().enumerate() {
                self.wheels[i].mean[RATE] = (speed / radii[i]).to_degrees();
            }
        }
        self.pose_covariance[(0, 0)] += path_m2;
        self.pose_covariance[(1, 1)] += path_m2;
    }

    fn rebase_wheels(&mut self, context: &SampledContext) {
        self.commit_angles(context);
        self.counted_deg = self.wheels.map(|wheel| wheel.mean[ANGLE]);
    }

    fn use_wheels(&mut self, step: &WheelStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let turned = [step.left_rad, step.right_rad];
        let mut next = *self;
        let mut nu = SVector::<f64, 2>::zeros();
        let mut s = Matrix2::zeros();
        let mut left_out = [0.0; 2];
        for (i, wheel) in next.wheels.iter_mut().enumerate() {
            next.counted_deg[i] += turned[i].to_degrees();
            let Some((innovation, variance)) = wheel.update(next.counted_deg[i]) else {
                return FusionOutcome::Malformed;
            };
            // (K_1)² S with K_1 = P / R after the update.
            left_out[i] = (wheel.covariance[(ANGLE, ANGLE)] / wheel.variance).powi(2) * variance;
            nu[i] = innovation.to_radians();
            s[(i, i)] = variance * 1.0_f64.to_radians().powi(2);
        }
        if !write_innovation(record, &nu, &s) {
            return FusionOutcome::Malformed;
        }
        *self = next;
        let open = match self.odometry {
            WheelOdometry::Angles => StepNoise::default(),
            WheelOdometry::Speeds => Self::motion_noise(left_out, context),
        };
        self.move_pose(open, context);
        self.settled = [0.0; 2];
        FusionOutcome::Accepted
    }
}
