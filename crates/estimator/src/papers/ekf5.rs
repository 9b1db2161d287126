//! The five-state EKF with two integrated headings as observations: the third filter of paper 1.
//!
//! ```text
//! x = [x, y, th, v, w]'           moves as models::planar_speeds, driven by the accelerations of the wheels
//! z = [v_enc, th_enc, th_gyro]'   h = [v, th, th]'
//! R = diag(5.1, 0.938, 0.332)     P0 = 0.05 I     x0 = 0                    cm and degrees
//! Q per 0.05 s: 2 for x, 2 for y, 0.1 for th, and 1 and 3 for the speeds: see [`FiveStateMatrices`]
//! ```
//! th_enc and th_gyro are integrals, whose errors stay: the filter is over-confident in its heading by design. They
//! begin anew, at the filter's own heading, when the pose is set, after a gap of the gyro or a new base of the
//! counters, and after each fix that was used: otherwise their drift would be held against every fix for ever. A fix
//! comes between two readings, and the next reading contains the turn since the last one: so the integral begins at the
//! heading that the filter had then.
//!
//! Source: Paper 1 (Valera et al.), equations 24 to 26; docs/lab/square.md section M4.

use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{FusionOutcome, FusionRecord, StartPose};
use serde::{Deserialize, Serialize};

use super::paper_scaffold::{
    FixStep, GaussianState, GyroStep, OnArrivalFilter, OptionalSensor, SampledContext, SampledFilter, WheelStep,
};
use super::paper1::{FiveStateMatrices, UNITS, covariance_si, variances_si};
use super::rows::{self, position_in_arena};
use crate::filter::{Filter, FilterConfig};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, N, PredictionStep};
use crate::observations::fix::fix_noise;
use crate::observations::sensor_frame::Exposure;
use crate::saved::{covariance, finite};
use crate::update::{LinearizedMeasurement, ScalarMeasurement};

/// Whether the filter uses fixes: the paper itself does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixUsage {
    Unused,
    /// As in the paper's outlook: when they come.
    Used,
}

pub fn build(config: &FilterConfig, matrices: &FiveStateMatrices, fixes: FixUsage) -> Box<dyn Filter> {
    Box::new(OnArrivalFilter::new(FiveStateEkf::new(matrices, fixes, predict_linearized), config))
}

/// Moves state and covariance of the filter by a number of seconds, process noise included.
pub(super) type Prediction = fn(&mut FiveStateEkf, f64, Acceleration);

pub(super) fn predict_linearized(filter: &mut FiveStateEkf, dt_s: f64, felt: Acceleration) {
    let step = PredictionStep { interval_s: dt_s, variances: filter.matrices.process_noise(dt_s).diagonal().into() };
    step.predict(&mut filter.mean, &mut filter.covariance, felt);
}

#[derive(Clone, Copy)]
pub(super) struct FiveStateEkf {
    pub(super) mean: Mean,
    pub(super) covariance: Covariance,
    pub(super) matrices: FiveStateMatrices,
    fixes: FixUsage,
    prediction: Prediction,
    wheel_heading_rad: f64,
    gyro_heading_rad: f64,
    /// Predicted since the last reading of the wheels, and since that of the gyro.
    turned_rad: [f64; 2],
}

/// What changes in a [`FiveStateEkf`].
#[derive(Clone, Copy, Serialize, Deserialize)]
pub(super) struct SavedFiveStates {
    #[serde(deserialize_with = "finite")]
    mean: Mean,
    #[serde(deserialize_with = "covariance")]
    covariance: Covariance,
    #[serde(deserialize_with = "finite")]
    wheel_heading_rad: f64,
    #[serde(deserialize_with = "finite")]
    gyro_heading_rad: f64,
    #[serde(deserialize_with = "finite")]
    turned_rad: [f64; 2],
}

const BY_WHEELS: usize = 0;
const BY_GYRO: usize = 1;

impl FiveStateEkf {
    pub(super) fn new(matrices: &FiveStateMatrices, fixes: FixUsage, prediction: Prediction) -> Self {
        Self {
            mean: Mean::zeros(),
            covariance: covariance_si([matrices.initial; N]),
            matrices: *matrices,
            fixes,
            prediction,
            wheel_heading_rad: 0.0,
            gyro_heading_rad: 0.0,
            turned_rad: [0.0; 2],
        }
    }

    fn rebase_headings(&mut self) {
        self.wheel_heading_rad = self.mean[HEADING] - self.turned_rad[BY_WHEELS];
        self.gyro_heading_rad = self.mean[HEADING] - self.turned_rad[BY_GYRO];
    }
}

impl SampledFilter for FiveStateEkf {
    type Saved = SavedFiveStates;

    fn saved(&self) -> SavedFiveStates {
        let Self {
            mean,
            covariance,
            matrices: _,
            fixes: _,
            prediction: _,
            wheel_heading_rad,
            gyro_heading_rad,
            turned_rad,
        } = *self;
        SavedFiveStates { mean, covariance, wheel_heading_rad, gyro_heading_rad, turned_rad }
    }

    fn with_saved(&self, saved: SavedFiveStates) -> Self {
        let SavedFiveStates { mean, covariance, wheel_heading_rad, gyro_heading_rad, turned_rad } = saved;
        Self { mean, covariance, wheel_heading_rad, gyro_heading_rad, turned_rad, ..*self }
    }

    fn uses(&self, extra: OptionalSensor) -> bool {
        match extra {
            OptionalSensor::Gyro | OptionalSensor::Accelerometers => true,
            OptionalSensor::Camera => self.fixes == FixUsage::Used,
            OptionalSensor::Compass => false,
        }
    }

    fn gaussian_state(&self, _context: &SampledContext) -> GaussianState {
        GaussianState { mean: self.mean, covariance: self.covariance }
    }

    fn initialize_pose(&mut self, start: &StartPose) {
        rows::initialize_pose(&mut self.mean, &mut self.covariance, start);
        self.rebase_headings();
    }

    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, _context: &SampledContext) {
        let start = variances_si([self.matrices.initial; N]);
        let speeds = [start[FORWARD], start[TURN]];
        rows::reset_speeds(&mut self.mean, &mut self.covariance, position_m, heading_rad, speeds);
        self.rebase_headings();
    }

    fn predict(&mut self, dt_s: f64, felt: Acceleration, _context: &SampledContext) {
        self.turned_rad = self.turned_rad.map(|turned| turned + self.mean[TURN] * dt_s);
        (self.prediction)(self, dt_s, felt);
    }

    fn predict_unobserved(&mut self, dt_s: f64, _context: &SampledContext) {
        self.covariance += self.matrices.process_noise(dt_s);
        rows::add_unobserved_motion(&mut self.covariance, dt_s);
    }

    fn bridge_gap(&mut self, speeds: [f64; 2], path_m2: f64, _context: &SampledContext) {
        rows::bridge_gap(&mut self.mean, &mut self.covariance, speeds, path_m2);
    }

    fn rebase_wheels(&mut self, _context: &SampledContext) {
        self.turned_rad[BY_WHEELS] = 0.0;
        self.wheel_heading_rad = self.mean[HEADING];
    }

    fn rebase_gyro(&mut self) {
        self.turned_rad[BY_GYRO] = 0.0;
        self.gyro_heading_rad = self.mean[HEADING];
    }

    fn use_wheels(&mut self, step: &WheelStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let body = step.body_step(&context.config.geometry);
        self.wheel_heading_rad += body.turn_rad;
        self.turned_rad[BY_WHEELS] = 0.0;
        let speed_m_per_s = body.forward_m / step.interval.as_secs_f64();
        let [forward, heading, _] = self.matrices.variances;
        let scalars = [
            scalar_observation(&self.mean, FORWARD, speed_m_per_s, forward),
            scalar_observation(&self.mean, HEADING, self.wheel_heading_rad, heading),
        ];
        rows::apply_all(&mut self.mean, &mut self.covariance, &scalars, record)
    }

    fn use_gyro(&mut self, step: &GyroStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let known_bias = context.config.calibration.gyro_bias_rad_per_s.value;
        self.gyro_heading_rad += (step.rate_rad_per_s - known_bias) * step.dt_s;
        self.turned_rad[BY_GYRO] = 0.0;
        let measured_rad = self.gyro_heading_rad;
        let scalar = scalar_observation(&self.mean, HEADING, measured_rad, self.matrices.variances[2]);
        rows::apply_all(&mut self.mean, &mut self.covariance, &[scalar], record)
    }

    fn use_fix(&mut self, step: &FixStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let fix = &step.fix;
        let exposure = Exposure::at_speeds(self.mean[FORWARD], self.mean[TURN]);
        let noise = fix_noise(fix, &context.config.noise, [1.0, 1.0], &exposure, step.stamp_sigma_s);
        let (innovation, jacobian) = position_in_arena([X, Y, HEADING].map(|row| self.mean[row]), fix);
        let position = LinearizedMeasurement { innovation, jacobian, noise: noise.position };
        let expected_rad = self.mean[HEADING];
        let heading = fix.heading.map(|heading| (wrap_rad(heading.rad() - expected_rad), noise.heading_rad2));
        let (mean, covariance) = (&mut self.mean, &mut self.covariance);
        let outcome = rows::gate_and_apply_fix(mean, covariance, &position, heading, &context.gates, record);
        if outcome == FusionOutcome::Accepted {
            self.rebase_headings();
        }
        outcome
    }
}

/// A direct observation of one row; `variance` is in the paper's unit of that row.
fn scalar_observation(mean: &Mean, row: usize, measured: f64, variance: f64) -> ScalarMeasurement<1> {
    ScalarMeasurement {
        innovation: measured - mean[row],
        rows: [row],
        jacobian: [1.0],
        variance: variance * UNITS[row] * UNITS[row],
    }
}
