//! The smoothed path against a solution that was written differently.
//!
//! It is dense: its unknowns are the start, the errors of each step and the constants, the path is what they lead to, and
//! all derivatives are differences. It shares no formula with the code under test but the model.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::smoother::{Convergence, SmoothedPose, SmoothedTrajectory, smooth};
use posebridge_telemetry::{Fix, Meters, Observation, Point2, quantities::wrap_rad};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::support::observe::{fix, fix_of, gyro, ms, wheels};
use crate::support::robot::{DEGREE, NOISE, RADIUS_M, TRACK_M, learning_geometry, unknown};

const READINGS: usize = 90;
const STEP_MS: i64 = 50;
/// Variance of the encoders' heading through their rounding.
const ROUNDING_RAD2: f64 = (RADIUS_M * DEGREE / TRACK_M) * (RADIUS_M * DEGREE / TRACK_M) / 6.0;
/// Fixes lie inside the steps, not at their ends.
const FIX_OFFSET_MS: i64 = 20;
const LEVER_M: (f64, f64) = (0.03, -0.02);

/// What was observed, as plain numbers; readings are 50 ms apart from 0 on.
struct Data {
    /// Rotation of the left and of the right wheel, rad.
    wheels: Vec<(f64, f64)>,
    /// Turn rate at each reading, rad/s.
    gyro: Vec<f64>,
    /// Instant in ms, x, y, heading.
    fixes: Vec<(i64, [f64; 3])>,
}

fn normal(rng: &mut Pcg64) -> f64 {
    rng.sample(StandardNormal)
}

/// A robot on a winding path, measured with about the noise of the model.
fn winding(seed: u64) -> Data {
    let mut rng = Pcg64::seed_from_u64(seed);
    let (mut x, mut y, mut th) = (0.0_f64, 0.0_f64, 0.0_f64);
    let (mut left, mut right) = (0.0, 0.0);
    let mut data = Data { wheels: vec![(0.0, 0.0)], gyro: vec![0.0], fixes: vec![] };
    for k in 1..READINGS {
        let t = 0.05 * k as f64;
        let (d, turn) = (0.012 + 0.004 * t.sin(), 0.06 * (1.3 * t).cos());
        left += (d - 0.5 * turn * TRACK_M) * 1.004 / RADIUS_M;
        right += (d + 0.5 * turn * TRACK_M) * 0.997 / RADIUS_M;
        let true_turn = turn + 1e-3 * normal(&mut rng);
        if k % 2 == 0 {
            let at = 0.4;
            let angle = th + 0.5 * at * true_turn;
            let fix_th = th + at * true_turn;
            let (sin, cos) = fix_th.sin_cos();
            data.fixes.push((
                STEP_MS * (k as i64 - 1) + FIX_OFFSET_MS,
                [
                    x + at * d * angle.cos() + cos * LEVER_M.0 - sin * LEVER_M.1 + 0.005 * normal(&mut rng),
                    y + at * d * angle.sin() + sin * LEVER_M.0 + cos * LEVER_M.1 + 0.005 * normal(&mut rng),
                    fix_th + 0.017 * normal(&mut rng),
                ],
            ));
        }
        x += d * (th + 0.5 * true_turn).cos();
        y += d * (th + 0.5 * true_turn).sin();
        th += true_turn;
        data.wheels.push((left, right));
        data.gyro.push(true_turn / 0.05 + 0.02 + 0.01 * normal(&mut rng));
    }
    data
}

fn observations(data: &Data) -> Vec<Observation> {
    let mut all = vec![];
    for (k, (&(left, right), &rate)) in data.wheels.iter().zip(&data.gyro).enumerate() {
        let at_ms = STEP_MS * k as i64;
        all.extend([wheels(at_ms, left, right), gyro(at_ms, rate)]);
    }
    for &(at_ms, [x, y, heading]) in &data.fixes {
        let tag_in_body = Point2::new(Meters(LEVER_M.0), Meters(LEVER_M.1));
        all.push(fix(at_ms, Fix { tag_in_body, ..fix_of(x, y, heading) }));
    }
    all
}

/// The winding robot's configuration: five constants unknown, the gate wide open.
fn winding_config() -> FilterConfig {
    let mut config = learning_geometry();
    config.calibration.tag_forward_m = unknown(0.004);
    config.calibration.tag_left_m = unknown(0.004);
    config.params.gate_probability = 0.999_999;
    config.params.gyro_window_s = 0.4;
    config.params.adapt_gain = 0.0;
    config.params.wear_per_sqrt_m = 0.0;
    config
}

/// The dense problem. Unknowns: start (3), constants (5), one bias per window, the encoders' rounding at the ends of the windows, then
/// (distance, turn) error of each part of a step; the last two in units of their sigmas.
struct DenseProblem<'a> {
    data: &'a Data,
    /// Where steps are cut: readings and fixes, ms.
    stops: Vec<i64>,
}

const START: usize = 0;
const CONSTANT: usize = 3;
const BIAS: usize = 8;
const STEPS_PER_WINDOW: usize = 8;
const WINDOWS: usize = (READINGS - 1) / STEPS_PER_WINDOW;
const ROUNDING: usize = BIAS + WINDOWS;
const ERRORS: usize = ROUNDING + WINDOWS + 1;

impl<'a> DenseProblem<'a> {
    fn new(data: &'a Data) -> Self {
        let mut stops: Vec<i64> = (0..READINGS as i64).map(|k| k * STEP_MS).collect();
        stops.extend(data.fixes.iter().map(|fix| fix.0));
        stops.sort_unstable();
        Self { data, stops }
    }

    fn unknowns(&self) -> usize {
        ERRORS + 2 * (self.stops.len() - 1)
    }

    /// Distance and turn of a part of a step with some constants, and its wheels' travel.
    fn part(&self, index: usize, [mean, difference, track]: [f64; 3]) -> [f64; 4] {
        let (from, to) = (self.stops[index], self.stops[index + 1]);
        let step = (from / STEP_MS) as usize;
        let share = (to - from) as f64 / STEP_MS as f64;
        let (before, after) = (self.data.wheels[step], self.data.wheels[step + 1]);
        let left = share * (after.0 - before.0) * RADIUS_M * (1.0 + mean - 0.5 * difference);
        let right = share * (after.1 - before.1) * RADIUS_M * (1.0 + mean + 0.5 * difference);
        let turn = (right - left) / (TRACK_M * (1.0 + track));
        [0.5 * (left + right), turn, left, right]
    }

    /// The errors of a part from two numbers of unit variance; the noise is that of the nominal geometry.
    fn error(&self, index: usize, white: [f64; 2]) -> [f64; 2] {
        let [_, turn, left, right] = self.part(index, [0.0; 3]);
        let track = TRACK_M;
        let var = |travel: f64| NOISE.wheel_travel_m_per_sqrt_m.powi(2) * travel.abs();
        let (left, right) = (var(left), var(right));
        let distance = (0.25 * (left + right)).sqrt();
        let cross = (right - left) / (2.0 * track) / distance;
        let turn_var = (left + right) / (track * track) + NOISE.turn_rad_per_sqrt_rad.powi(2) * turn.abs();
        let rest = (turn_var - cross * cross).sqrt();
        [distance * white[0], cross * white[0] + rest * white[1]]
    }

    /// The pose at each stop.
    fn path(&self, unknowns: &DVector<f64>) -> Vec<[f64; 3]> {
        let constants = [0, 1, 2].map(|i| unknowns[CONSTANT + i]);
        let [mut x, mut y, mut th] = [0, 1, 2].map(|i| unknowns[START + i]);
        let mut path = vec![[x, y, th]];
        for index in 0..self.stops.len() - 1 {
            let white = [0, 1].map(|i| unknowns[ERRORS + 2 * index + i]);
            let [error_d, error_th] = self.error(index, white);
            let [d, turn, ..] = self.part(index, constants);
            let (d, turn) = (d + error_d, turn + error_th);
            // The end of an arc, from its centre.
            if turn.abs() < 1e-9 {
                x += d * th.cos();
                y += d * th.sin();
            } else {
                let radius = d / turn;
                x += radius * ((th + turn).sin() - th.sin());
                y -= radius * ((th + turn).cos() - th.cos());
            }
            th += turn;
            path.push([x, y, th]);
        }
        path
    }

    fn at(&self, stop_ms: i64) -> usize {
        self.stops.iter().position(|stop| *stop == stop_ms).expect("a stop")
    }

    fn residuals(&self, unknowns: &DVector<f64>) -> DVector<f64> {
        let path = self.path(unknowns);
        let mut all: Vec<f64> = (0..3).map(|i| unknowns[START + i] / 1e-4).collect();
        for (i, sigma) in [0.005, 0.005, 0.03, 0.004, 0.004].into_iter().enumerate() {
            all.push(unknowns[CONSTANT + i] / sigma);
        }
        all.extend(unknowns.iter().skip(ROUNDING));
        for &(at_ms, fix) in &self.data.fixes {
            let [x, y, th] = path[self.at(at_ms)];
            let forward = LEVER_M.0 + unknowns[CONSTANT + 3];
            let left = LEVER_M.1 + unknowns[CONSTANT + 4];
            let (sin, cos) = th.sin_cos();
            all.push((fix[0] - x - cos * forward + sin * left) / NOISE.fix_position_m);
            all.push((fix[1] - y - sin * forward - cos * left) / NOISE.fix_position_m);
            all.push(wrap_rad(fix[2] - th) / NOISE.fix_heading_rad);
        }
        self.push_windows(&path, unknowns, &mut all);
        DVector::from_vec(all)
    }

    fn push_windows(&self, path: &[[f64; 3]], unknowns: &DVector<f64>, all: &mut Vec<f64>) {
        let rate_var = NOISE.gyro_rad_per_s.powi(2) + NOISE.gyro_resolution_rad_per_s.powi(2) / 12.0;
        let count = STEPS_PER_WINDOW as f64;
        let sigma = (count * 0.05_f64.powi(2) * rate_var).sqrt();
        let rounding = |end: usize| unknowns[ROUNDING + end] * ROUNDING_RAD2.sqrt();
        let length_s = 0.05 * count;
        for window in 0..WINDOWS {
            let first = window * STEPS_PER_WINDOW;
            let samples = &self.data.gyro[first + 1..=first + STEPS_PER_WINDOW];
            let gyro: f64 = samples.iter().map(|rate| 0.05 * rate).sum();
            let from = path[self.at(first as i64 * STEP_MS)][2];
            let to = path[self.at((first + STEPS_PER_WINDOW) as i64 * STEP_MS)][2];
            let bias = unknowns[BIAS + window];
            let turned = to - from + rounding(window) - rounding(window + 1);
            all.push((gyro - turned - bias * length_s) / sigma);
            // Each bias is that at the end of its window.
            let walk = NOISE.gyro_bias_walk_rad_per_s_sqrt_s * length_s.sqrt();
            all.push(if window == 0 {
                bias / NOISE.gyro_bias_rad_per_s.hypot(walk)
            } else {
                (bias - unknowns[BIAS + window - 1]) / walk
            });
        }
    }

    /// Central differences of any function of the unknowns.
    fn differences(&self, unknowns: &DVector<f64>, of: impl Fn(&DVector<f64>) -> DVector<f64>) -> DMatrix<f64> {
        let rows = of(unknowns).len();
        let mut jacobian = DMatrix::zeros(rows, self.unknowns());
        for column in 0..self.unknowns() {
            // Errors are in sigmas, all else in SI units of a thousandth or so.
            let h = if column < ROUNDING { 1e-6 } else { 1e-3 };
            let mut moved = unknowns.clone();
            moved[column] += h;
            let above = of(&moved);
            moved[column] -= 2.0 * h;
            jacobian.set_column(column, &((above - of(&moved)) / (2.0 * h)));
        }
        jacobian
    }

    fn jacobian(&self, unknowns: &DVector<f64>) -> DMatrix<f64> {
        self.differences(unknowns, |moved| self.residuals(moved))
    }

    fn solve(&self) -> DVector<f64> {
        let mut unknowns = DVector::zeros(self.unknowns());
        for _ in 0..15 {
            let jacobian = self.jacobian(&unknowns);
            let normal = jacobian.transpose() * &jacobian;
            let gradient = jacobian.transpose() * self.residuals(&unknowns);
            let step = normal.cholesky().expect("regular").solve(&gradient);
            unknowns -= &step;
            if step.amax() < 1e-10 {
                break;
            }
        }
        unknowns
    }

    /// Covariance of some function of the unknowns.
    fn covariance(&self, unknowns: &DVector<f64>, of: impl Fn(&DVector<f64>) -> DVector<f64>) -> DMatrix<f64> {
        let jacobian = self.jacobian(unknowns);
        let normal = (jacobian.transpose() * &jacobian).cholesky().expect("regular");
        let by = self.differences(unknowns, of);
        &by * normal.solve(&by.transpose())
    }
}

#[test]
fn a_dense_solution_with_numerical_derivatives_agrees() {
    let data = winding(11);
    let smoothed = smooth(&winding_config(), &observations(&data)).unwrap();
    assert_eq!((smoothed.fixes_rejected, smoothed.convergence), (0, Convergence::Converged));
    let dense = DenseProblem::new(&data);
    let unknowns = dense.solve();
    let path = dense.path(&unknowns);
    let at_reading = |k: usize| smoothed.poses.iter().find(|pose| pose.stamp == ms(k as i64 * STEP_MS)).unwrap();
    for k in 0..READINGS {
        let pose = at_reading(k);
        let expected = path[dense.at(k as i64 * STEP_MS)];
        let found = [pose.pose.x.0, pose.pose.y.0, pose.pose.heading.rad()];
        for (row, (found, expected)) in found.into_iter().zip(expected).enumerate() {
            let sigma = pose.covariance[row][row].sqrt();
            // It is linearised at what the filter believed, and not at the solution.
            assert!((found - expected).abs() < 0.02 * sigma, "reading {k}: {found} against {expected}, sigma {sigma}");
        }
    }
    check_constants(&dense, &smoothed, &unknowns);
    for k in [0, READINGS / 3, READINGS - 1] {
        let stop = dense.at(k as i64 * STEP_MS);
        let expected = dense.covariance(&unknowns, |moved| DVector::from_row_slice(&dense.path(moved)[stop]));
        let found = without_rounding(at_reading(k));
        for row in 0..3 {
            for column in 0..3 {
                let scale = (expected[(row, row)] * expected[(column, column)]).sqrt();
                let error = (found[(row, column)] - expected[(row, column)]).abs() / scale;
                assert!(error < 0.01, "reading {k}: {found} against {expected}");
            }
        }
    }
}

/// The covariance but for the encoders' rounding, which is no error of the dense path.
fn without_rounding(pose: &SmoothedPose) -> Matrix3<f64> {
    let (sin, cos) = pose.pose.heading.rad().sin_cos();
    let along = Vector3::new(cos, sin, 0.0);
    let rounding = along * along.transpose() * (0.25 * TRACK_M * TRACK_M * ROUNDING_RAD2);
    let mut covariance = Matrix3::from_fn(|row, column| pose.covariance[row][column]) - rounding;
    covariance[(2, 2)] -= ROUNDING_RAD2;
    covariance
}

fn check_constants(dense: &DenseProblem<'_>, smoothed: &SmoothedTrajectory, unknowns: &DVector<f64>) {
    let own = &smoothed.calibration;
    let found = [own.radius_scale, own.radius_difference, own.track_scale, own.tag_forward_m, own.tag_left_m];
    let rows = (CONSTANT..BIAS).chain([BIAS + WINDOWS - 1]);
    let covariance = dense.covariance(unknowns, Clone::clone);
    for (row, found) in rows.zip(found.into_iter().chain([own.gyro_bias_rad_per_s])) {
        let expected = unknowns[row];
        let sigma = covariance[(row, row)].sqrt();
        assert!((found.value - expected).abs() < 0.01 * sigma, "unknown {row}: {} against {expected}", found.value);
        assert!((found.sigma / sigma - 1.0).abs() < 0.01, "unknown {row}: {} against {sigma}", found.sigma);
    }
}
