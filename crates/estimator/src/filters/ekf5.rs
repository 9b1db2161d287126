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
//! at the filter's own heading, when the pose is set, when a sensor had a gap and, with fixes, after each fix that was used:
//! otherwise their drift would be held against every fix for ever.
//!
//! # Sources
//! Paper 1 (Valera et al.), equations 24 to 26; docs/maths/paper1.md section 4.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};
use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};
use posebridge_telemetry::{Fix, FusionRecord, Heading, Verdict, quantities::wrap_rad};

use super::paper1::{INTERVAL_S, UNITS, covariance_si};
use super::sampled::{Belief, Context, Extra, Maths, OnArrival, WheelStep, innovation, rows};
use super::{Filter, FilterConfig, StartPose};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, N, Step};
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
        if !innovation::write(record, &measurement.innovation, &s) {
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
        Belief {
            mean: self.mean,
            covariance: self.covariance,
        }
    }

    fn place(&mut self, start: &StartPose) {
        rows::place(&mut self.mean, &mut self.covariance, start);
        self.rebase_headings();
    }

    fn restart(&mut self, position_m: f64, heading_rad: f64, _context: &Context) {
        let start = covariance_si(START);
        let variances = [start[(FORWARD, FORWARD)], start[(TURN, TURN)]];
        rows::doubt(&mut self.covariance, position_m, heading_rad);
        rows::forget_speeds(&mut self.mean, &mut self.covariance, variances);
        self.rebase_headings();
    }

    fn advance(&mut self, dt_s: f64, felt: Acceleration, _context: &Context) {
        let step = Step {
            interval_s: dt_s,
            variances: process_noise(self.order, dt_s).diagonal().into(),
        };
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

    fn use_wheels(
        &mut self,
        step: &WheelStep,
        context: &Context,
        record: &mut FusionRecord,
    ) -> Verdict {
        let body = step.body(&context.config.geometry);
        self.wheel_heading_rad += body.turn_rad;
        let speed_m_per_s = body.forward_m / step.interval.as_secs_f64();
        let scalars = [
            observe(&self.mean, FORWARD, speed_m_per_s, FORWARD_VARIANCE),
            observe(
                &self.mean,
                HEADING,
                self.wheel_heading_rad,
                WHEEL_HEADING_VARIANCE,
            ),
        ];
        innovation::use_all(&mut self.mean, &mut self.covariance, &scalars, record)
    }

    fn use_gyro(
        &mut self,
        rate_rad_per_s: f64,
        dt_s: f64,
        context: &Context,
        record: &mut FusionRecord,
    ) -> Verdict {
        let known_bias = context.config.calibration.gyro_bias_rad_per_s.value;
        self.gyro_heading_rad += (rate_rad_per_s - known_bias) * dt_s;
        let seen_rad = self.gyro_heading_rad;
        let scalar = observe(&self.mean, HEADING, seen_rad, GYRO_HEADING_VARIANCE);
        innovation::use_all(&mut self.mean, &mut self.covariance, &[scalar], record)
    }

    fn use_fix(
        &mut self,
        fix: &Fix,
        stamp_sigma_s: f64,
        context: &Context,
        record: &mut FusionRecord,
    ) -> Verdict {
        let position = position_measurement(&self.mean, fix, stamp_sigma_s, context);
        match fix.heading {
            None => self.use_if_near(&position, context, record),
            Some(heading) => {
                let heading_rad2 = heading_variance(&self.mean, fix, stamp_sigma_s, context);
                let full = with_heading(&self.mean, &position, heading, heading_rad2);
                self.use_if_near(&full, context, record)
            }
        }
    }
}

/// A row that is observed directly, with a variance in the paper's unit of that row.
fn observe(mean: &Mean, row: usize, seen: f64, variance: f64) -> Scalar<1> {
    Scalar {
        innovation: seen - mean[row],
        rows: [row],
        by_row: [1.0],
        variance: variance * UNITS[row] * UNITS[row],
    }
}

/// Innovation, H and R of a fix's position: the tag sits at the lever arm, turned by the heading. A stamp that may be off moves
/// what was seen along the path; R allows for it in any direction.
fn position_measurement(
    mean: &Mean,
    fix: &Fix,
    stamp_sigma_s: f64,
    context: &Context,
) -> Measurement<N, 2> {
    let (sin, cos) = mean[HEADING].sin_cos();
    let (lever_x, lever_y) = (fix.tag_in_body.x.0, fix.tag_in_body.y.0);
    let offset = Vector2::new(lever_x * cos - lever_y * sin, lever_x * sin + lever_y * cos);
    let mut jacobian = SMatrix::<f64, 2, N>::zeros();
    jacobian[(0, X)] = 1.0;
    jacobian[(1, Y)] = 1.0;
    jacobian[(0, HEADING)] = -offset[1];
    jacobian[(1, HEADING)] = offset[0];
    let configured_m2 = context.config.noise.fix_position_m.powi(2);
    let own = fix.covariance.map_or_else(
        || Matrix2::from_diagonal_element(configured_m2),
        |own| Matrix2::new(own.xx_m2, own.xy_m2, own.xy_m2, own.yy_m2),
    );
    let smear_m2 = (mean[FORWARD] * stamp_sigma_s).powi(2);
    Measurement {
        innovation: Vector2::new(fix.position.x.0 - mean[X], fix.position.y.0 - mean[Y]) - offset,
        jacobian,
        noise: own + Matrix2::from_diagonal_element(smear_m2),
    }
}

fn heading_variance(mean: &Mean, fix: &Fix, stamp_sigma_s: f64, context: &Context) -> f64 {
    let configured_rad2 = context.config.noise.fix_heading_rad.powi(2);
    let own_rad2 = fix
        .covariance
        .map(|own| own.heading_rad2)
        .filter(|rad2| rad2.is_finite())
        .unwrap_or(configured_rad2);
    own_rad2 + (mean[TURN] * stamp_sigma_s).powi(2)
}

fn with_heading(
    mean: &Mean,
    position: &Measurement<N, 2>,
    heading: Heading,
    heading_rad2: f64,
) -> Measurement<N, 3> {
    let mut jacobian = SMatrix::<f64, 3, N>::zeros();
    jacobian
        .fixed_rows_mut::<2>(0)
        .copy_from(&position.jacobian);
    jacobian[(2, HEADING)] = 1.0;
    let turn_rad = wrap_rad(heading.rad() - mean[HEADING]);
    let mut noise = Matrix3::from_diagonal_element(heading_rad2);
    noise
        .fixed_view_mut::<2, 2>(0, 0)
        .copy_from(&position.noise);
    Measurement {
        innovation: Vector3::new(position.innovation[0], position.innovation[1], turn_rad),
        jacobian,
        noise,
    }
}
