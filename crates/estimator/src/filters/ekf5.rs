//! The five-state EKF with two integrated headings as observations: the third filter of paper 1.
//!
//! # Model
//! ```text
//! x = [x, y, th, v, w]'           moves as models::planar_speeds, driven by the accelerations of the wheels
//! z = [v_enc, th_enc, th_gyro]'   h = [v, th, th]'
//! R = diag(5.1, 0.938, 0.332)     P0 = 0.05 I     x0 = 0                    cm and degrees
//! Q per 0.05 s: 2 for x, 2 for y, 0.1 for th, and 1 and 3 for the speeds: see [`SpeedOrder`]
//! ```
//! th_enc and th_gyro are integrals. Their errors do not come anew with each sample, as a Kalman filter assumes, but stay:
//! the filter is over-confident in its heading by design. `ekf5-corrected` is what becomes of it without that.
//!
//! # Assumptions
//! A known bias of the gyro is subtracted; an unknown one drifts into th_gyro, and into the pose. The integrals begin anew,
//! at the filter's own heading, when the pose is set, after a gap of the gyro or a new base of the counters, and, with fixes,
//! after each fix that was used: otherwise their drift would be held against every fix for ever.
//!
//! # Sources
//! Paper 1 (Valera et al.), equations 24 to 26; docs/maths/paper1.md section 4.

use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};
use posebridge_telemetry::{Fix, FusionRecord, Verdict, quantities::wrap_rad};

use super::paper1::{INTERVAL_S, UNITS, covariance_si, variances_si};
use super::records::write_innovation;
use super::sampled::{Belief, Context, Extra, Maths, OnArrival, WheelStep, innovation, rows};
use super::{Filter, FilterConfig, StartPose};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, N, Step};
use crate::observations::fix::{Circumstances, noise_of, position_in_arena, with_heading};
use crate::update::{Measurement, Scalar, apply};

/// Variance of v_enc, (cm/s)²: paper 1, equation 26.
const FORWARD_VARIANCE: f64 = 5.1;
/// Variance of th_enc, degrees²: paper 1, equation 26.
const WHEEL_HEADING_VARIANCE: f64 = 0.938;
/// Variance of th_gyro, degrees²: paper 1, equation 26.
const GYRO_HEADING_VARIANCE: f64 = 0.332;
/// Diagonal of P0: paper 1, below equation 26.
const START: [f64; N] = [0.05; N];

/// How the last two rows of the paper's Q, 1 and 3, are read.
///
/// The state of equation 24 ends in v, w; the matrix of equation 25 has the 1 of v_enc in its *fifth* column, so there the state
/// ends in w, v.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpeedOrder {
    /// As equation 25 is printed: 1 is for the turn rate, 3 for the forward speed.
    Printed,
    /// As equation 24 is: 1 is for the forward speed, 3 for the turn rate.
    Swapped,
}

/// Whether fixes are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fixes {
    /// As in the paper.
    Unused,
    /// As in the paper's outlook: when they come.
    Used,
}

/// Builds the filter: as the paper has it with [`SpeedOrder::Printed`].
#[must_use]
pub fn build(config: &FilterConfig, order: SpeedOrder, fixes: Fixes) -> Box<dyn Filter> {
    Box::new(OnArrival::new(FiveStates::new(order, fixes), config))
}

/// Q over `dt_s`, SI units.
#[must_use]
pub fn process_noise(order: SpeedOrder, dt_s: f64) -> Covariance {
    // Paper 1, equation 26, in the order x, y, th, v, w.
    let diagonal = match order {
        SpeedOrder::Printed => [2.0, 2.0, 0.1, 3.0, 1.0],
        SpeedOrder::Swapped => [2.0, 2.0, 0.1, 1.0, 3.0],
    };
    covariance_si(diagonal) * (dt_s / INTERVAL_S)
}

/// State, covariance and the two integrals.
#[derive(Clone, Copy)]
pub(super) struct FiveStates {
    pub(super) mean: Mean,
    pub(super) covariance: Covariance,
    pub(super) order: SpeedOrder,
    fixes: Fixes,
    /// th_enc, rad.
    wheel_heading_rad: f64,
    /// th_gyro, rad.
    gyro_heading_rad: f64,
}

impl FiveStates {
    pub(super) fn new(order: SpeedOrder, fixes: Fixes) -> Self {
        Self {
            mean: Mean::zeros(),
            covariance: covariance_si(START),
            order,
            fixes,
            wheel_heading_rad: 0.0,
            gyro_heading_rad: 0.0,
        }
    }

    fn rebase_headings(&mut self) {
        self.wheel_heading_rad = self.mean[HEADING];
        self.gyro_heading_rad = self.mean[HEADING];
    }

    fn use_if_near<const M: usize>(
        &mut self,
        measurement: &Measurement<N, M>,
        context: &Context,
        record: &mut FusionRecord,
    ) -> Verdict {
        let s = measurement.innovation_covariance(&self.covariance);
        if !write_innovation(record, &measurement.innovation, &s) {
            return Verdict::Malformed;
        }
        if record.nis > context.gates[M - 1] {
            return Verdict::Gated;
        }
        if !apply(&mut self.mean, &mut self.covariance, measurement) {
            return Verdict::Malformed;
        }
        self.rebase_headings();
        Verdict::Accepted
    }
}

impl Maths for FiveStates {
    fn uses(&self, extra: Extra) -> bool {
        match extra {
            Extra::Gyro | Extra::Accelerometers => true,
            Extra::Camera => self.fixes == Fixes::Used,
        }
    }

    fn belief(&self, _context: &Context) -> Belief {
        Belief { mean: self.mean, covariance: self.covariance }
    }

    fn place(&mut self, start: &StartPose) {
        rows::place(&mut self.mean, &mut self.covariance, start);
        self.rebase_headings();
    }

    fn restart(&mut self, position_m: f64, heading_rad: f64, _context: &Context) {
        let start = variances_si(START);
        let doubt = (position_m, heading_rad);
        let speeds = [start[FORWARD], start[TURN]];
        rows::restart(&mut self.mean, &mut self.covariance, doubt, speeds);
        self.rebase_headings();
    }

    fn advance(&mut self, dt_s: f64, felt: Acceleration, _context: &Context) {
        let step = Step { interval_s: dt_s, variances: process_noise(self.order, dt_s).diagonal().into() };
        step.predict(&mut self.mean, &mut self.covariance, felt);
    }

    fn wait(&mut self, dt_s: f64, _context: &Context) {
        self.covariance += process_noise(self.order, dt_s);
        rows::unseen(&mut self.covariance, dt_s);
    }

    fn bridge(&mut self, speeds: [f64; 2], path_m2: f64) {
        rows::bridge(&mut self.mean, &mut self.covariance, speeds, path_m2);
    }

    fn rebase_wheels(&mut self, _context: &Context) {
        self.wheel_heading_rad = self.mean[HEADING];
    }

    fn rebase_gyro(&mut self) {
        self.gyro_heading_rad = self.mean[HEADING];
    }

    fn use_wheels(&mut self, step: &WheelStep, context: &Context, record: &mut FusionRecord) -> Verdict {
        let body = step.body(&context.config.geometry);
        self.wheel_heading_rad += body.turn_rad;
        let speed_m_per_s = body.forward_m / step.interval.as_secs_f64();
        let scalars = [
            observe(&self.mean, FORWARD, speed_m_per_s, FORWARD_VARIANCE),
            observe(&self.mean, HEADING, self.wheel_heading_rad, WHEEL_HEADING_VARIANCE),
        ];
        innovation::use_all(&mut self.mean, &mut self.covariance, &scalars, record)
    }

    fn use_gyro(&mut self, rate_rad_per_s: f64, dt_s: f64, context: &Context, record: &mut FusionRecord) -> Verdict {
        let known_bias = context.config.calibration.gyro_bias_rad_per_s.value;
        self.gyro_heading_rad += (rate_rad_per_s - known_bias) * dt_s;
        let seen_rad = self.gyro_heading_rad;
        let scalar = observe(&self.mean, HEADING, seen_rad, GYRO_HEADING_VARIANCE);
        innovation::use_all(&mut self.mean, &mut self.covariance, &[scalar], record)
    }

    fn use_fix(&mut self, fix: &Fix, stamp_sigma_s: f64, context: &Context, record: &mut FusionRecord) -> Verdict {
        let circumstances = Circumstances {
            stamp_sigma_s,
            forward_m_per_s: self.mean[FORWARD],
            turn_rad_per_s: self.mean[TURN],
            ..Circumstances::default()
        };
        let noise = noise_of(fix, &context.config.noise, [1.0, 1.0], &circumstances);
        let rows = [X, Y, HEADING];
        let (innovation, jacobian) = position_in_arena(rows.map(|row| self.mean[row]), rows, fix);
        let position = Measurement { innovation, jacobian, noise: noise.position };
        match fix.heading {
            None => self.use_if_near(&position, context, record),
            Some(heading) => {
                let turn_rad = wrap_rad(heading.rad() - self.mean[HEADING]);
                let full = with_heading(&position, HEADING, (turn_rad, noise.heading_rad2));
                self.use_if_near(&full, context, record)
            }
        }
    }
}

/// A row that is observed directly, with a variance in the paper's unit of that row.
fn observe(mean: &Mean, row: usize, seen: f64, variance: f64) -> Scalar<1> {
    Scalar { innovation: seen - mean[row], rows: [row], by_row: [1.0], variance: variance * UNITS[row] * UNITS[row] }
}
