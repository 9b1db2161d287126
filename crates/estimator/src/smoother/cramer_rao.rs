//! The posterior Cramer-Rao bound of a run: no estimate that uses what has arrived by a step can have a smaller mean
//! squared error.
//!
//! ```text
//! J+ = Q^-1 + H'R^-1 H - Q^-1 F (J + F'Q^-1 F)^-1 F'Q^-1             the information matrix, for a regular Q
//! P+ = (M^-1 + H'R^-1 H)^-1,  M = F P F' + Q,  P = J^-1             the same by the matrix inversion lemma
//! ```
//! The second form is used, since Q is singular here. It is linearised along the *true* path; the expectation over
//! paths is left to the mean over runs. Fixes see mid-axle without delay, nothing slips, every gyro sample is held
//! against its own step, and the rounding of the encoders is left out: a bound that knows more than a filter does is
//! lower, and still a bound.
//!
//! Source: Tichavsky, Muravchik and Nehorai (1998), IEEE Transactions on Signal Processing 46(5), equation 21;
//! docs/maths/pose.md section B5.

use nalgebra::{Matrix2, SMatrix, SVector};
use posebridge_telemetry::{Arena, Calibration, Pose};

use super::nominal::{CONSTANTS, UNKNOWN_POSITION_SIGMA_M, bias_prior, calibrated_motion, constants_of, true_geometry};
use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, step_noise};
use crate::models::se2::{BodyStep, StepRule, displace};
use crate::numerics::covariance::symmetrise;
use crate::observations::gyro_window::gyro_variance;

const X: usize = 0;
const Y: usize = 1;
const HEADING: usize = 2;
const GYRO_BIAS: usize = 3;
/// Row of the gyro's turn of the last step beyond that of the wheels.
const STEP_ERROR: usize = 4;
/// First of three rows: radius scale, radius difference, track scale.
const FIRST_CONSTANT: usize = 5;
const N: usize = 8;

type Covariance = SMatrix<f64, N, N>;

/// The true motion of a run, on a grid of equal steps.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruthRun<'a> {
    /// The true pose before the first step and after each step: one more than there are steps.
    pub poses: &'a [Pose<Arena>],
    /// The wheels' travel over each step, by counters and the nominal geometry.
    pub travel: &'a [WheelTravel],
    /// The length of a step; the gyro gives one sample per step.
    pub step_s: f64,
    /// In any order.
    pub fixes: &'a [FixArrival],
}

/// A fix of the pose after step `exposure_step`, available from step `arrival_step` on. Both count steps from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FixArrival {
    pub exposure_step: usize,
    /// Not before `exposure_step`.
    pub arrival_step: usize,
    pub content: FixContent,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixContent {
    Position,
    /// x, y and heading.
    Pose,
}

/// The least mean squared position error after each step with a pose before and after, m².
pub fn cramer_rao_bound(config: &FilterConfig, run: &GroundTruthRun<'_>) -> Vec<f64> {
    let steps = run.travel.len().min(run.poses.len().saturating_sub(1));
    let mut recursion = BoundRecursion::new(config, run);
    let mut arrivals: Vec<FixArrival> = run
        .fixes
        .iter()
        .copied()
        .filter(|fix| (1..=steps).contains(&fix.exposure_step) && fix.arrival_step >= fix.exposure_step)
        .collect();
    arrivals.sort_by_key(|fix| fix.arrival_step);
    let mut arrivals = arrivals.into_iter().peekable();
    (1..=steps)
        .map(|step| {
            let mut oldest = step;
            while let Some(fix) = arrivals.next_if(|fix| fix.arrival_step == step) {
                oldest = oldest.min(fix.exposure_step);
                recursion.arrived_fixes[fix.exposure_step].push(fix.content);
            }
            for again in oldest..=step {
                recursion.advance(again);
            }
            let after = &recursion.covariances[step];
            after[(X, X)] + after[(Y, Y)]
        })
        .collect()
}

struct BoundRecursion<'a> {
    config: &'a FilterConfig,
    run: &'a GroundTruthRun<'a>,
    constants: [f64; CONSTANTS],
    /// After each step, with the fixes that have arrived; the first is the start.
    covariances: Vec<Covariance>,
    arrived_fixes: Vec<Vec<FixContent>>,
}

impl<'a> BoundRecursion<'a> {
    fn new(config: &'a FilterConfig, run: &'a GroundTruthRun<'a>) -> Self {
        let calibration: &Calibration = &config.calibration;
        let mut start = SVector::<f64, N>::zeros();
        let (position, heading) = config.start.map_or((UNKNOWN_POSITION_SIGMA_M, UNKNOWN_HEADING_SIGMA_RAD), |start| {
            (start.position_sigma_m, start.heading_sigma_rad)
        });
        start[X] = position;
        start[Y] = position;
        start[HEADING] = heading;
        start[GYRO_BIAS] = bias_prior(config).sigma;
        let known = constants_of(calibration);
        for (row, known) in start.iter_mut().skip(FIRST_CONSTANT).zip(known) {
            *row = known.sigma;
        }
        Self {
            config,
            run,
            constants: known.map(|known| known.value),
            covariances: vec![Covariance::from_diagonal(&start.map(|sigma| sigma * sigma))],
            arrived_fixes: vec![Vec::new(); run.travel.len() + 1],
        }
    }

    /// Computes the covariance after a step, again if it exists already.
    fn advance(&mut self, step: usize) {
        let mut covariance = self.covariances[step - 1];
        covariance.row_mut(STEP_ERROR).fill(0.0);
        covariance.column_mut(STEP_ERROR).fill(0.0);
        self.move_by(step, &mut covariance);
        let step_s = self.run.step_s;
        let gyro = gyro_variance(&self.config.noise, step_s * step_s);
        observe(&mut covariance, [(GYRO_BIAS, step_s), (STEP_ERROR, 1.0)], gyro);
        let noise = &self.config.noise;
        let position = noise.fix_position_m.powi(2);
        for sees in &self.arrived_fixes[step] {
            observe(&mut covariance, [(X, 1.0)], position);
            observe(&mut covariance, [(Y, 1.0)], position);
            if *sees == FixContent::Pose {
                let heading = noise.fix_heading_rad.powi(2);
                observe(&mut covariance, [(HEADING, 1.0)], heading);
            }
        }
        self.covariances.truncate(step);
        self.covariances.push(covariance);
    }

    /// M = F P F' + G Q G', along the true path.
    fn move_by(&self, step: usize, covariance: &mut Covariance) {
        let walk = self.config.noise.gyro_bias_walk_rad_per_s_sqrt_s;
        covariance[(GYRO_BIAS, GYRO_BIAS)] += walk * walk * self.run.step_s;
        let travel = self.run.travel[step - 1];
        if travel == WheelTravel::default() {
            return;
        }
        let (before, after) = (self.run.poses[step - 1], self.run.poses[step]);
        let known = calibrated_motion(travel, self.config, &self.constants);
        let moved = displace(
            before.heading.rad(),
            BodyStep { forward_m: known.step.forward_m, turn_rad: (after.heading - before.heading).0 },
            StepRule::Arc,
        );
        let mut by_state = Covariance::identity();
        let mut by_noise = SMatrix::<f64, N, 2>::zeros();
        for axis in [X, Y] {
            by_state[(axis, HEADING)] = moved.by_heading[axis];
            by_noise[(axis, 0)] = moved.by_forward[axis];
            by_noise[(axis, 1)] = moved.by_turn[axis];
        }
        by_noise[(HEADING, 1)] = 1.0;
        for constant in 0..3 {
            let (d, dth) = (known.forward_by_scales[constant], known.turn_by_scales[constant]);
            for axis in [X, Y] {
                by_state[(axis, FIRST_CONSTANT + constant)] = moved.by_forward[axis] * d + moved.by_turn[axis] * dth;
            }
            by_state[(HEADING, FIRST_CONSTANT + constant)] = dth;
            by_state[(STEP_ERROR, FIRST_CONSTANT + constant)] = dth;
        }
        by_noise[(STEP_ERROR, 1)] = 1.0;
        let noise = step_noise(known.travel, &true_geometry(self.config, &self.constants), &self.config.noise);
        let cross = noise.forward_turn_m_rad;
        let q = Matrix2::new(noise.forward_var_m2, cross, cross, noise.turn_var_rad2);
        *covariance = by_state * *covariance * by_state.transpose() + by_noise * q * by_noise.transpose();
        symmetrise(covariance);
    }
}

/// Uniform on the circle, rad.
const UNKNOWN_HEADING_SIGMA_RAD: f64 = 1.813_799_364_234_217_8;

/// (M^-1 + h'h / R)^-1 for a row h that is zero except at these places.
fn observe<const K: usize>(covariance: &mut Covariance, entries: [(usize, f64); K], variance: f64) {
    let mut h = SVector::<f64, N>::zeros();
    for (row, by_row) in entries {
        h[row] = by_row;
    }
    let cross = *covariance * h;
    let s = h.dot(&cross) + variance;
    // Without noise, what is known exactly already cannot be known better.
    if s > 0.0 {
        *covariance -= cross * cross.transpose() / s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Heading, Meters};

    /// 40 steps straight ahead with a fix after every fourth, `late` steps late.
    fn straight(config: &FilterConfig, late: usize) -> Vec<f64> {
        let poses: Vec<Pose<Arena>> =
            (0..=40).map(|k| Pose::new(Meters(0.01 * f64::from(k)), Meters(0.0), Heading::default())).collect();
        let travel = vec![WheelTravel { left_m: 0.01, right_m: 0.01 }; 40];
        let fixes: Vec<FixArrival> = (1..=10)
            .map(|k| FixArrival { exposure_step: 4 * k, arrival_step: 4 * k + late, content: FixContent::Pose })
            .collect();
        let run = GroundTruthRun { poses: &poses, travel: &travel, step_s: 0.05, fixes: &fixes };
        cramer_rao_bound(config, &run)
    }

    #[test]
    fn it_is_the_information_recursion_where_that_exists() {
        // Without a gyro and with nothing to calibrate, x on a straight is a random walk of its own: Q is regular.
        let mut config = crate::filter::tests::config();
        config.noise.gyro_rad_per_s = 1e6;
        config.noise.turn_rad_per_sqrt_rad = 0.0;
        let start = config.start.unwrap();
        let own = straight(&config, 0);
        let wheel_var = config.noise.wheel_travel_m_per_sqrt_m.powi(2) * 0.01;
        // x: F = 1. (y, heading): F = [1, d; 0, 1], noise of the turn on both, which is regular over two steps only, so a
        // share is added that changes nothing.
        let (q_x, q_turn) = (0.5 * wheel_var, 2.0 * wheel_var / 0.112_f64.powi(2));
        let (r, r_heading) = (config.noise.fix_position_m.powi(2), 0.02_f64.powi(2));
        let f = Matrix2::new(1.0, 0.01, 0.0, 1.0);
        let g = nalgebra::Vector2::new(0.005, 1.0);
        let q = g * q_turn * g.transpose() + Matrix2::from_diagonal_element(1e-14);
        let q_inverse = q.try_inverse().unwrap();
        let mut j_x = start.position_sigma_m.powi(-2);
        let mut j = Matrix2::from_diagonal(&nalgebra::Vector2::new(
            start.position_sigma_m.powi(-2),
            start.heading_sigma_rad.powi(-2),
        ));
        for (index, own) in own.iter().enumerate() {
            let has_fix = (index + 1).is_multiple_of(4);
            let fix_weight = f64::from(u8::from(has_fix));
            j_x = 1.0 / q_x + fix_weight / r - 1.0 / q_x / (j_x + 1.0 / q_x) / q_x;
            let inner = (j + f.transpose() * q_inverse * f).try_inverse().unwrap();
            j = q_inverse - q_inverse * f * inner * f.transpose() * q_inverse
                + Matrix2::from_diagonal(&nalgebra::Vector2::new(fix_weight / r, fix_weight / r_heading));
            let expected = 1.0 / j_x + j.try_inverse().unwrap()[(0, 0)];
            assert!((own / expected - 1.0).abs() < 1e-4, "step {}: {own} against {expected}", index + 1);
        }
    }

    #[test]
    fn a_late_fix_helps_late_and_then_as_much() {
        let config = crate::filter::tests::config();
        let (at_once, late) = (straight(&config, 0), straight(&config, 3));
        assert!(late[3] > at_once[3] && late[5] > at_once[5]);
        // After step 7 both know the fix of step 4; summed in another order, so up to rounding.
        assert!((late[6] / at_once[6] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn at_rest_and_for_an_empty_run_it_is_what_was_known() {
        let config = crate::filter::tests::config();
        let poses = [Pose::default(); 3];
        let travel = [WheelTravel::default(); 2];
        let run = GroundTruthRun { poses: &poses, travel: &travel, step_s: 0.05, fixes: &[] };
        for variance in cramer_rao_bound(&config, &run) {
            assert!((variance - 2e-8).abs() < 1e-20);
        }
        let nothing = GroundTruthRun { poses: &[], travel: &[], ..run };
        assert!(cramer_rao_bound(&config, &nothing).is_empty());
    }
}
