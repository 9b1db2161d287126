//! A Kalman filter for the two speeds, driven by the accelerations of the wheels: the second filter of paper 1.
//!
//! ```text
//! x = [v, w]'      x_k = x_(k-1) + dt [a, alpha]'      z = x      both from the encoders
//! Q = diag(2.2, 2.2) per 0.05 s      R = diag(5.1, 1.938)      P0 = diag(10, 10)      x0 = 0      cm and degrees
//! then the pose by the midpoint rule from v and w at k-1
//! ```
//! The paper gives the pose no covariance. Here pose and speeds share one matrix in which the pose is never corrected:
//! its gain is zero, and its covariance is that which Joseph's form gives for such a gain.
//!
//! Source: Paper 1 (Valera et al.), equations 13, 14, 20 to 23; docs/lab/square.md section M3.

use nalgebra::{Matrix2, SVector};
use posebridge_telemetry::estimate::row::{FORWARD, TURN};
use posebridge_telemetry::{FusionOutcome, FusionRecord, StartPose};
use serde::{Deserialize, Serialize};

use super::paper_scaffold::{GaussianState, OnArrivalFilter, OptionalSensor, SampledContext, SampledFilter, WheelStep};
use super::paper1::{SAMPLING_INTERVAL_S, SpeedMatrices, UNITS, covariance_si, variances_si};
use super::rows;
use crate::filter::{Filter, FilterConfig};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, N, PredictionStep};
use crate::saved::{covariance, finite};
use crate::validation::write_innovation;

#[derive(Clone, Copy)]
struct VelocityKf {
    mean: Mean,
    covariance: Covariance,
    matrices: SpeedMatrices,
}

/// What changes in a [`VelocityKf`].
#[derive(Clone, Copy, Serialize, Deserialize)]
struct SavedVelocityKf {
    #[serde(deserialize_with = "finite")]
    mean: Mean,
    #[serde(deserialize_with = "covariance")]
    covariance: Covariance,
}

pub fn build(config: &FilterConfig, matrices: &SpeedMatrices) -> Box<dyn Filter> {
    let covariance = covariance_si(of_speeds(matrices.initial));
    Box::new(OnArrivalFilter::new(VelocityKf { mean: Mean::zeros(), covariance, matrices: *matrices }, config))
}

/// Variances of v and w beside a pose that has none.
const fn of_speeds([forward, turn]: [f64; 2]) -> [f64; N] {
    [0.0, 0.0, 0.0, forward, turn]
}

impl VelocityKf {
    /// Updates one row by an observation of it alone.
    fn correct(&mut self, row: usize, innovation: f64, variance: f64) {
        let gain = self.covariance[(row, row)] / (self.covariance[(row, row)] + variance);
        self.mean[row] += gain * innovation;
        // Joseph's form for a gain in one row only.
        for other in 0..self.mean.len() {
            self.covariance[(row, other)] *= 1.0 - gain;
            self.covariance[(other, row)] *= 1.0 - gain;
        }
        self.covariance[(row, row)] += gain * gain * variance;
    }
}

impl SampledFilter for VelocityKf {
    type Saved = SavedVelocityKf;

    fn saved(&self) -> SavedVelocityKf {
        let Self { mean, covariance, matrices: _ } = *self;
        SavedVelocityKf { mean, covariance }
    }

    fn with_saved(&self, SavedVelocityKf { mean, covariance }: SavedVelocityKf) -> Self {
        Self { mean, covariance, ..*self }
    }

    fn uses(&self, extra: OptionalSensor) -> bool {
        extra == OptionalSensor::Accelerometers
    }

    fn gaussian_state(&self, _context: &SampledContext) -> GaussianState {
        GaussianState { mean: self.mean, covariance: self.covariance }
    }

    fn initialize_pose(&mut self, start: &StartPose) {
        rows::initialize_pose(&mut self.mean, &mut self.covariance, start);
    }

    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, _context: &SampledContext) {
        let start = variances_si(of_speeds(self.matrices.initial));
        let speeds = [start[FORWARD], start[TURN]];
        rows::reset_speeds(&mut self.mean, &mut self.covariance, position_m, heading_rad, speeds);
    }

    fn predict(&mut self, dt_s: f64, felt: Acceleration, _context: &SampledContext) {
        let step = PredictionStep {
            interval_s: dt_s,
            variances: variances_si(of_speeds(self.matrices.process))
                .map(|variance| variance * (dt_s / SAMPLING_INTERVAL_S)),
        };
        step.predict(&mut self.mean, &mut self.covariance, felt);
    }

    fn predict_unobserved(&mut self, dt_s: f64, _context: &SampledContext) {
        self.covariance += covariance_si(of_speeds(self.matrices.process)) * (dt_s / SAMPLING_INTERVAL_S);
        rows::add_unobserved_motion(&mut self.covariance, dt_s);
    }

    fn bridge_gap(&mut self, speeds: [f64; 2], path_m2: f64, _context: &SampledContext) {
        rows::bridge_gap(&mut self.mean, &mut self.covariance, speeds, path_m2);
    }

    fn use_wheels(&mut self, step: &WheelStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let body = step.body_step(&context.config.geometry);
        let dt_s = step.interval.as_secs_f64();
        let measured = [(FORWARD, body.forward_m / dt_s), (TURN, body.turn_rad / dt_s)];
        let noise: [f64; 2] = [0, 1].map(|i: usize| self.matrices.variances[i] * UNITS[measured[i].0].powi(2));
        let nu = SVector::<f64, 2>::from_fn(|i, _| measured[i].1 - self.mean[measured[i].0]);
        let s = Matrix2::from_fn(|i, j| {
            let row = measured[i].0;
            if i == j { self.covariance[(row, row)] + noise[i] } else { 0.0 }
        });
        if !write_innovation(record, &nu, &s) {
            return FusionOutcome::Malformed;
        }
        for i in 0..2 {
            self.correct(measured[i].0, nu[i], noise[i]);
        }
        FusionOutcome::Accepted
    }
}
