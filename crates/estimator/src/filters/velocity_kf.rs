//! A Kalman filter for the two speeds, driven by the accelerations of the wheels: the second filter of paper 1.
//!
//! # Model
//! ```text
//! x = [v, w]'      x_k = x_(k-1) + dt [a, alpha]'      z = x      both from the encoders
//! Q = diag(2.2, 2.2) per 0.05 s      R = diag(5.1, 1.938)      P0 = diag(10, 10)      x0 = 0      cm and degrees
//! then the pose by the midpoint rule from v and w at k-1
//! ```
//! F and C are identities and Q and R diagonal, so v and w are two filters of one state each.
//!
//! # Assumptions
//! The paper gives the pose no covariance. Here pose and speeds share one matrix in which the pose is carried along but never
//! corrected: its gain is zero, as in the paper, and its covariance is that which Joseph's form gives for such a gain.
//!
//! # Sources
//! Paper 1 (Valera et al.), equations 13, 14, 20 to 23; docs/maths/paper1.md section 3.

use nalgebra::{Matrix2, SVector};
use posebridge_telemetry::estimate::row::{FORWARD, TURN};
use posebridge_telemetry::{FusionRecord, Verdict};

use super::paper1::{INTERVAL_S, UNITS, covariance_si, variances_si};
use super::records::write_innovation;
use super::sampled::{Belief, Context, Extra, Maths, OnArrival, WheelStep, rows};
use super::{Filter, FilterConfig, StartPose};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, Step};

/// Diagonal of R, (cm/s)² and (degrees/s)²: paper 1, equation 23.
const NOISE: [f64; 2] = [5.1, 1.938];
/// Diagonal of Q for v and w over one of the paper's intervals: paper 1, equation 23. The pose has none.
const PROCESS: [f64; 5] = [0.0, 0.0, 0.0, 2.2, 2.2];
/// Diagonal of P0 for v and w: paper 1, below equation 23.
const START: [f64; 5] = [0.0, 0.0, 0.0, 10.0, 10.0];

#[derive(Clone, Copy)]
struct VelocityKf {
    mean: Mean,
    covariance: Covariance,
}

/// Builds the filter.
pub(super) fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let maths = VelocityKf { mean: Mean::zeros(), covariance: covariance_si(START) };
    Box::new(OnArrival::new(maths, config))
}

impl VelocityKf {
    /// Uses z = x_row for that row alone.
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

impl Maths for VelocityKf {
    fn uses(&self, extra: Extra) -> bool {
        extra == Extra::Accelerometers
    }

    fn belief(&self, _context: &Context) -> Belief {
        Belief { mean: self.mean, covariance: self.covariance }
    }

    fn place(&mut self, start: &StartPose) {
        rows::place(&mut self.mean, &mut self.covariance, start);
    }

    fn restart(&mut self, position_m: f64, heading_rad: f64, _context: &Context) {
        let start = variances_si(START);
        let doubt = (position_m, heading_rad);
        let speeds = [start[FORWARD], start[TURN]];
        rows::restart(&mut self.mean, &mut self.covariance, doubt, speeds);
    }

    fn advance(&mut self, dt_s: f64, felt: Acceleration, _context: &Context) {
        let step =
            Step { interval_s: dt_s, variances: variances_si(PROCESS).map(|variance| variance * (dt_s / INTERVAL_S)) };
        step.predict(&mut self.mean, &mut self.covariance, felt);
    }

    fn wait(&mut self, dt_s: f64, _context: &Context) {
        self.covariance += covariance_si(PROCESS) * (dt_s / INTERVAL_S);
        rows::unseen(&mut self.covariance, dt_s);
    }

    fn bridge(&mut self, speeds: [f64; 2], path_m2: f64) {
        rows::bridge(&mut self.mean, &mut self.covariance, speeds, path_m2);
    }

    fn rebase_wheels(&mut self, _context: &Context) {}

    fn rebase_gyro(&mut self) {}

    fn use_wheels(&mut self, step: &WheelStep, context: &Context, record: &mut FusionRecord) -> Verdict {
        let body = step.body(&context.config.geometry);
        let dt_s = step.interval.as_secs_f64();
        let seen = [(FORWARD, body.forward_m / dt_s), (TURN, body.turn_rad / dt_s)];
        let noise: [f64; 2] = [0, 1].map(|i: usize| NOISE[i] * UNITS[seen[i].0].powi(2));
        let nu = SVector::<f64, 2>::from_fn(|i, _| seen[i].1 - self.mean[seen[i].0]);
        let s = Matrix2::new(
            self.covariance[(FORWARD, FORWARD)] + noise[0],
            0.0,
            0.0,
            self.covariance[(TURN, TURN)] + noise[1],
        );
        if !write_innovation(record, &nu, &s) {
            return Verdict::Malformed;
        }
        for i in 0..2 {
            self.correct(seen[i].0, nu[i], noise[i]);
        }
        Verdict::Accepted
    }
}
