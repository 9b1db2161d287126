//! The filters of paper 1 against the paper: gains in the steady state, derivatives, and independent implementations.
#![expect(
    clippy::expect_used,
    reason = "helpers outside #[test] stop when a filter gives no estimate"
)]

#[path = "support/robot.rs"]
mod robot;

use adskalman::{ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use nalgebra::{Matrix2, SMatrix, SVector, U1, U2, Vector1, Vector2};
use posebridge_estimator::filters::ekf5::{self, Fixes, SpeedOrder, process_noise};
use posebridge_estimator::filters::paper1::{CENTIMETRE, DEGREE, INTERVAL_S, UNITS};
use posebridge_estimator::filters::wheel_kf::{LEFT_VARIANCE, RIGHT_VARIANCE, Wheel};
use posebridge_estimator::filters::{ekf5_corrected, ukf5};
use posebridge_estimator::models::planar_speeds::{self, Acceleration, Covariance, Mean};
use posebridge_estimator::{Filter, FilterConfig, filter_named};
use posebridge_telemetry::{
    BrickClock, Estimate, MetersPerSecondSquared, Observation, Observed, Radians, RadiansPerSecond,
    SensorId, Span, Stamp, Verdict, estimate::row,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use robot::{RADIUS_M, TRACK_M, config};

fn at(secs: f64, sensor: SensorId, observed: Observed) -> Observation {
    Observation {
        sensor,
        stamp: Stamp::<BrickClock>::from_secs_f64(secs),
        stamp_sigma: Span::ZERO,
        observed,
    }
}

fn wheels(secs: f64, left_rad: f64, right_rad: f64) -> Observation {
    let observed = Observed::WheelAngles {
        left: Radians(left_rad),
        right: Radians(right_rad),
    };
    at(secs, SensorId::WHEELS, observed)
}

fn gyro(secs: f64, rad_per_s: f64) -> Observation {
    let observed = Observed::TurnRate(RadiansPerSecond(rad_per_s));
    at(secs, SensorId::GYRO, observed)
}

fn accelerations(secs: f64, left: f64, right: f64) -> Observation {
    let observed = Observed::WheelAccelerations {
        left: MetersPerSecondSquared(left),
        right: MetersPerSecondSquared(right),
    };
    at(secs, SensorId::ACCELEROMETER, observed)
}

fn named(name: &str, config: &FilterConfig) -> Box<dyn Filter> {
    (filter_named(name).expect("it is in the table").build)(config)
}

fn without_start() -> FilterConfig {
    FilterConfig {
        start: None,
        ..config()
    }
}

fn latest(filter: &dyn Filter) -> Estimate {
    filter
        .latest()
        .and_then(|latest| filter.estimate_at(latest))
        .expect("something was observed")
}

/// The published covariance in the paper's units: cm, degrees and these per second.
fn covariance_in_paper_units(filter: &dyn Filter) -> Covariance {
    let published = latest(filter).covariance;
    Covariance::from_fn(|i, j| published[i][j] / (UNITS[i] * UNITS[j]))
}

fn assert_near(what: &str, found: f64, expected: f64, tolerance: f64) {
    assert!(
        (found - expected).abs() < tolerance,
        "{what}: {found} instead of {expected}"
    );
}

/// A robot that stands for 500 of the paper's intervals: every gain is then the steady one.
fn at_rest(mut filter: Box<dyn Filter>) -> Box<dyn Filter> {
    for k in 0..500 {
        let secs = f64::from(k) * INTERVAL_S;
        filter.observe(&wheels(secs, 0.0, 0.0));
        filter.observe(&gyro(secs, 0.0));
    }
    filter
}

#[test]
fn the_wheel_filters_have_the_papers_steady_gains_and_poles() {
    for (variance, gain, real, imaginary) in [
        (RIGHT_VARIANCE, [0.3880, 1.5646], 0.767, 0.155),
        (LEFT_VARIANCE, [0.4353, 1.9403], 0.734, 0.162),
    ] {
        let mut wheel = Wheel::at_rest(variance);
        for _ in 0..500 {
            wheel.predict(INTERVAL_S);
            assert!(wheel.update(0.0).is_some());
        }
        let k = wheel.covariance.column(0) / variance;
        assert_near("K of phi", k[0], gain[0], 5e-5);
        assert_near("K of phidot", k[1], gain[1], 5e-5);
        let closed = (Matrix2::identity()
            - Matrix2::from_columns(&[k.into_owned(), Vector2::zeros()]))
            * Matrix2::new(1.0, INTERVAL_S, 0.0, 1.0);
        let pole = closed.complex_eigenvalues()[0];
        assert_near("pole", pole.re, real, 5e-4);
        assert_near("pole", pole.im.abs(), imaginary, 5e-4);
    }
}

#[test]
fn the_velocity_filter_has_the_papers_steady_gains() {
    let p = covariance_in_paper_units(at_rest(named("velocity-kf", &config())).as_ref());
    let (v, w) = (p[(row::FORWARD, row::FORWARD)], p[(row::TURN, row::TURN)]);
    assert_near("P of v", v, 2.426, 5e-4);
    assert_near("P of w", w, 1.240, 5e-4);
    assert_near("K of v", v / 5.1, 0.4756, 5e-5);
    assert_near("K of w", w / 1.938, 0.6396, 5e-5);
}

#[test]
fn the_five_state_filter_has_the_papers_steady_gains_in_both_readings_of_the_order() {
    for (order, v, th, w) in [
        (
            SpeedOrder::Printed,
            0.527_31,
            [0.140_53, 0.397_05],
            [0.358_99, 1.014_26],
        ),
        (
            SpeedOrder::Swapped,
            0.355_49,
            [0.151_04, 0.426_73],
            [0.594_16, 1.678_67],
        ),
    ] {
        let filter = at_rest(ekf5::build(&config(), order, Fixes::Unused));
        let p = covariance_in_paper_units(filter.as_ref());
        assert_near("K of v", p[(row::FORWARD, row::FORWARD)] / 5.1, v, 5e-6);
        for (i, variance) in [0.938, 0.332].into_iter().enumerate() {
            let heading = p[(row::HEADING, row::HEADING)] / variance;
            assert_near("K of th", heading, th[i], 5e-6);
            assert_near(
                "K of w",
                p[(row::TURN, row::HEADING)] / variance,
                w[i],
                5e-6,
            );
        }
    }
}

#[test]
fn nothing_observes_the_position_so_its_variance_grows_by_the_papers_two_per_step() {
    let mut filter = at_rest(named("ekf5", &config()));
    let before = covariance_in_paper_units(filter.as_ref());
    filter.observe(&wheels(500.0 * INTERVAL_S, 0.0, 0.0));
    let grown = covariance_in_paper_units(filter.as_ref()) - before;
    assert!(grown[(row::X, row::X)] >= 2.0, "{grown}");
    assert_near("y, across the way", grown[(row::Y, row::Y)], 2.0, 1e-6);
}

/// States in every quadrant, backwards, turning fast, and several turns around the circle.
const STATES: [[f64; 5]; 5] = [
    [0.0, 0.0, 0.0, 0.0, 0.0],
    [1.3, -0.7, 0.4, 0.2, 0.1],
    [-2.1, 3.9, 1.9, 0.35, 2.5],
    [5.0, 5.0, -2.6, -0.15, -4.0],
    [-7.0, 0.2, 14.2, 0.4, -1.2],
];

const FELT: Acceleration = Acceleration {
    forward_m_per_s2: 0.7,
    turn_rad_per_s2: -1.9,
};

/// Holds a Jacobian against central differences of the motion.
fn check_jacobian<const N: usize>(
    mean: SVector<f64, N>,
    advance: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
    jacobian: &SMatrix<f64, N, N>,
) {
    let h = 1e-6;
    for column in 0..N {
        let mut step = SVector::<f64, N>::zeros();
        step[column] = h;
        let numeric = (advance(&(mean + step)) - advance(&(mean - step))) / (2.0 * h);
        let difference = (numeric - jacobian.column(column)).amax();
        assert!(difference < 1e-8, "column {column} at {mean}: {difference}");
    }
}

#[test]
fn the_jacobians_agree_with_central_differences() {
    for dt_s in [0.05, 0.31] {
        for state in STATES {
            let five = Mean::from(state);
            let f = planar_speeds::jacobian(&five, dt_s);
            check_jacobian(five, |mean| planar_speeds::advance(mean, FELT, dt_s), &f);
            let mut nine = SVector::<f64, { ekf5_corrected::N }>::from_fn(|i, _| 0.1 * i as f64);
            nine.fixed_rows_mut::<5>(0).copy_from(&five);
            let f = ekf5_corrected::jacobian(&nine, dt_s);
            check_jacobian(nine, |mean| ekf5_corrected::advance(mean, FELT, dt_s), &f);
        }
    }
}

#[test]
fn a_step_follows_equations_13_and_24() {
    let mean = Mean::from([1.0, 2.0, 0.5, 0.3, 2.0]);
    let next = planar_speeds::advance(&mean, FELT, 0.1);
    let middle: f64 = 0.5 + 0.5 * 0.1 * 2.0;
    assert_near("x", next[0], 1.0 + 0.03 * middle.cos(), 1e-12);
    assert_near("y", next[1], 2.0 + 0.03 * middle.sin(), 1e-12);
    assert_near("th", next[2], 0.7, 1e-12);
    assert_near("v", next[3], 0.37, 1e-12);
    assert_near("w", next[4], 1.81, 1e-12);
    let felt = Acceleration::of_wheels(0.2, 0.5, &robot::GEOMETRY);
    assert_near("a", felt.forward_m_per_s2, 0.35, 1e-12);
    assert_near("alpha", felt.turn_rad_per_s2, 0.3 / TRACK_M, 1e-9);
}

/// A linear model for the foreign crate: F, Q, input, H and R of one step.
struct Foreign<const M: usize> {
    f: [Matrix2<f64>; 2],
    q: Matrix2<f64>,
    input: Vector2<f64>,
    h: SMatrix<f64, M, 2>,
    h_transposed: SMatrix<f64, 2, M>,
    r: SMatrix<f64, M, M>,
}

impl<const M: usize> TransitionModelLinearNoControl<f64, U2> for Foreign<M> {
    fn F(&self) -> &Matrix2<f64> {
        &self.f[0]
    }
    fn FT(&self) -> &Matrix2<f64> {
        &self.f[1]
    }
    fn Q(&self) -> &Matrix2<f64> {
        &self.q
    }
    fn predict(&self, before: &StateAndCovariance<f64, U2>) -> StateAndCovariance<f64, U2> {
        StateAndCovariance::new(
            self.f[0] * before.state() + self.input,
            self.f[0] * before.covariance() * self.f[1] + self.q,
        )
    }
}

macro_rules! observed_by {
    ($m:literal, $dim:ty) => {
        impl ObservationModel<f64, U2, $dim> for Foreign<$m> {
            fn H(&self) -> &SMatrix<f64, $m, 2> {
                &self.h
            }
            fn HT(&self) -> &SMatrix<f64, 2, $m> {
                &self.h_transposed
            }
            fn R(&self) -> &SMatrix<f64, $m, $m> {
                &self.r
            }
        }
    };
}
observed_by!(1, U1);
observed_by!(2, U2);

/// Seeded intervals around the paper's, and a robot that drives an uneven way: seconds, left and right angle in rad.
fn uneven_drive(seed: u64) -> Vec<(f64, f64, f64)> {
    let mut random = Pcg64::seed_from_u64(seed);
    let (mut secs, mut left, mut right) = (0.0, 0.0, 0.0);
    (0..400)
        .map(|k| {
            let here = (secs, left, right);
            let dt_s = (0.03 + 0.04 * random.random::<f64>())
                .mul_add(1e3, 0.5)
                .floor()
                * 1e-3;
            let phase = f64::from(k) * 0.05;
            left += (6.0 * phase.sin() + random.random::<f64>()) * dt_s;
            right += (6.0 * (0.7 * phase).cos() + random.random::<f64>()) * dt_s;
            secs += dt_s;
            here
        })
        .collect()
}

/// Steps the foreign filter: predict, then update in Joseph's form.
macro_rules! foreign_step {
    ($model:expr, $before:expr, $seen:expr) => {
        adskalman::KalmanFilterNoControl::new($model, $model)
            .step($before, $seen)
            .expect("its covariances are positive")
    };
}

#[test]
fn the_wheel_filter_equals_an_independent_kalman_filter() {
    let mut wheel = Wheel::at_rest(RIGHT_VARIANCE);
    let mut foreign = StateAndCovariance::new(Vector2::zeros(), Matrix2::identity() * 10.0);
    let drive = uneven_drive(1);
    for pair in drive.windows(2) {
        let dt_s = pair[1].0 - pair[0].0;
        let counted = pair[1].2 / DEGREE;
        let f = Matrix2::new(1.0, dt_s, 0.0, 1.0);
        let model = Foreign::<1> {
            f: [f, f.transpose()],
            q: Matrix2::new(0.1, 0.0, 0.0, 10.0) * (dt_s / 0.05),
            input: Vector2::zeros(),
            h: SMatrix::<f64, 1, 2>::new(1.0, 0.0),
            h_transposed: Vector2::new(1.0, 0.0),
            r: SMatrix::<f64, 1, 1>::new(2.5),
        };
        foreign = foreign_step!(&model, &foreign, &Vector1::new(counted));
        wheel.predict(dt_s);
        assert!(wheel.update(counted).is_some());
        assert!((wheel.mean - foreign.state()).amax() < 1e-9);
        assert!((wheel.covariance - foreign.covariance()).amax() < 1e-9);
    }
}

/// Gives the wheels, and accelerations for the interval that follows, to a row of the table.
#[test]
fn the_velocity_filter_equals_an_independent_kalman_filter() {
    let mut filter = named("velocity-kf", &config());
    let mut foreign = StateAndCovariance::new(Vector2::zeros(), Matrix2::identity() * 10.0);
    let drive = uneven_drive(2);
    let felt_at = |k: usize| (0.3 * (k as f64 * 0.11).sin(), 0.2 * (k as f64 * 0.07).cos());
    for (k, pair) in drive.windows(2).enumerate() {
        let (left, right) = felt_at(k);
        if k == 0 {
            filter.observe(&wheels(pair[0].0, pair[0].1, pair[0].2));
        }
        filter.observe(&accelerations(pair[0].0, left, right));
        filter.observe(&wheels(pair[1].0, pair[1].1, pair[1].2));

        let dt_s = pair[1].0 - pair[0].0;
        let [left_m, right_m] =
            [pair[1].1 - pair[0].1, pair[1].2 - pair[0].2].map(|turned| turned * RADIUS_M);
        let felt = Acceleration::of_wheels(left, right, &robot::GEOMETRY);
        let per_unit = Vector2::new(1.0 / CENTIMETRE, 1.0 / DEGREE);
        let model = Foreign::<2> {
            f: [Matrix2::identity(); 2],
            q: Matrix2::identity() * (2.2 * dt_s / 0.05),
            input: Vector2::new(felt.forward_m_per_s2, felt.turn_rad_per_s2)
                .component_mul(&per_unit)
                * dt_s,
            h: Matrix2::identity(),
            h_transposed: Matrix2::identity(),
            r: Matrix2::new(5.1, 0.0, 0.0, 1.938),
        };
        let speeds = Vector2::new(0.5 * (left_m + right_m), (right_m - left_m) / TRACK_M) / dt_s;
        foreign = foreign_step!(&model, &foreign, &speeds.component_mul(&per_unit));

        let ours = latest(filter.as_ref());
        let v = ours.forward_speed.0 / CENTIMETRE;
        let w = ours.turn_rate.0 / DEGREE;
        assert!(
            (Vector2::new(v, w) - foreign.state()).amax() < 1e-9,
            "step {k}"
        );
        let p = covariance_in_paper_units(filter.as_ref());
        let block = p.fixed_view::<2, 2>(row::FORWARD, row::FORWARD);
        assert!((block - foreign.covariance()).amax() < 1e-9, "step {k}");
    }
}

/// Equations 24 to 26 as the paper has them, in centimetres and degrees, with one update for all three observations.
struct Literal {
    x: Mean,
    p: Covariance,
}

impl Literal {
    fn step(&mut self, z: &SVector<f64, 3>, felt: Acceleration, ts: f64) {
        let [x, y, th, v, w] = self.x.into();
        let phi = (th + 0.5 * ts * w).to_radians();
        let mut f = Covariance::identity();
        f[(0, 2)] = -v * ts * phi.sin() * DEGREE;
        f[(0, 3)] = ts * phi.cos();
        f[(0, 4)] = -0.5 * v * ts * ts * phi.sin() * DEGREE;
        f[(1, 2)] = v * ts * phi.cos() * DEGREE;
        f[(1, 3)] = ts * phi.sin();
        f[(1, 4)] = 0.5 * v * ts * ts * phi.cos() * DEGREE;
        f[(2, 4)] = ts;
        let a = felt.forward_m_per_s2 / CENTIMETRE;
        let alpha = felt.turn_rad_per_s2 / DEGREE;
        self.x = Mean::from([
            x + v * ts * phi.cos(),
            y + v * ts * phi.sin(),
            th + ts * w,
            v + ts * a,
            w + ts * alpha,
        ]);
        let q = Covariance::from_diagonal(&Mean::from([2.0, 2.0, 0.1, 3.0, 1.0]));
        self.p = f * self.p * f.transpose() + q * (ts / 0.05);
        let mut h = SMatrix::<f64, 3, 5>::zeros();
        h[(0, 3)] = 1.0;
        h[(1, 2)] = 1.0;
        h[(2, 2)] = 1.0;
        let r = SMatrix::<f64, 3, 3>::from_diagonal(&SVector::from([5.1, 0.938, 0.332]));
        let s = h * self.p * h.transpose() + r;
        let k = self.p * h.transpose() * s.try_inverse().expect("positive definite");
        self.x += k * (z - h * self.x);
        self.p = (Covariance::identity() - k * h) * self.p;
    }
}

#[test]
fn ekf5_equals_the_paper_written_out_in_centimetres_and_degrees() {
    let mut filter = named("ekf5", &without_start());
    let mut literal = Literal {
        x: Mean::zeros(),
        p: Covariance::identity() * 0.05,
    };
    let (mut wheel_heading, mut gyro_heading) = (0.0, 0.0);
    let drive = uneven_drive(3);
    filter.observe(&wheels(0.0, 0.0, 0.0));
    filter.observe(&gyro(0.0, 0.0));
    for (k, pair) in drive.windows(2).enumerate() {
        let felt = (0.2 * (k as f64 * 0.1).sin(), 0.1);
        let ts = pair[1].0 - pair[0].0;
        let [left_m, right_m] =
            [pair[1].1 - pair[0].1, pair[1].2 - pair[0].2].map(|turned| turned * RADIUS_M);
        let turn_rad = (right_m - left_m) / TRACK_M;
        let rate = turn_rad / ts + 0.02 * (k as f64 * 0.3).sin();
        filter.observe(&accelerations(pair[0].0, felt.0, felt.1));
        filter.observe(&wheels(pair[1].0, pair[1].1, pair[1].2));
        filter.observe(&gyro(pair[1].0, rate));

        wheel_heading += turn_rad / DEGREE;
        gyro_heading += rate * ts / DEGREE;
        let speed = 0.5 * (left_m + right_m) / ts / CENTIMETRE;
        let z = SVector::from([speed, wheel_heading, gyro_heading]);
        let body = Acceleration::of_wheels(felt.0, felt.1, &robot::GEOMETRY);
        literal.step(&z, body, ts);

        let ours = latest(filter.as_ref());
        let found = [
            ours.pose.x.0 / CENTIMETRE,
            ours.pose.y.0 / CENTIMETRE,
            (ours.pose.heading.rad() / DEGREE - literal.x[2] + 180.0).rem_euclid(360.0) - 180.0,
            ours.forward_speed.0 / CENTIMETRE - literal.x[3],
            ours.turn_rate.0 / DEGREE - literal.x[4],
        ];
        assert_near("x", found[0], literal.x[0], 1e-7);
        assert_near("y", found[1], literal.x[1], 1e-7);
        for difference in &found[2..] {
            assert_near("heading, v, w", *difference, 0.0, 1e-8);
        }
        let p = covariance_in_paper_units(filter.as_ref());
        assert!((p - literal.p).amax() < 1e-6 * literal.p.amax(), "step {k}");
    }
}

#[test]
fn sigma_points_equal_the_jacobian_where_the_motion_is_linear() {
    // Driving straight with a heading that is known: nothing bends.
    let mean = Mean::from([1.0, 2.0, 0.6, 0.3, 0.0]);
    let p = Covariance::from_diagonal(&Mean::from([0.04, 0.01, 0.0, 0.02, 0.0]));
    let (next, spread) = ukf5::predict(&mean, &p, FELT, 0.05).expect("a covariance");
    let f = planar_speeds::jacobian(&mean, 0.05);
    assert!((next - planar_speeds::advance(&mean, FELT, 0.05)).amax() < 1e-12);
    assert!((spread - f * p * f.transpose()).amax() < 1e-12);
}

#[test]
fn sigma_points_see_that_a_doubtful_heading_shortens_the_way() {
    let mean = Mean::from([0.0, 0.0, 0.0, 1.0, 0.0]);
    let p = Covariance::from_diagonal(&Mean::from([0.0, 0.0, 0.09, 0.0, 0.0]));
    let (next, spread) = ukf5::predict(&mean, &p, Acceleration::default(), 1.0).expect("fine");
    // E cos th = exp(-var / 2), E sin^2 th = (1 - exp(-2 var)) / 2; a Jacobian gives 1 and 0.09.
    assert_near("x", next[0], (-0.045_f64).exp(), 1e-3);
    assert_near(
        "var y",
        spread[(1, 1)],
        0.5 * (1.0 - (-0.18_f64).exp()),
        6e-3,
    );
    assert!((spread[(1, 1)] - 0.09).abs() > 0.01, "{spread}");
}

#[test]
fn the_mean_heading_of_sigma_points_does_not_care_where_the_circle_is_cut() {
    let p = process_noise(SpeedOrder::Printed, 0.05) * 20.0;
    let turned = |heading: f64| {
        let mean = Mean::from([0.0, 0.0, heading, 0.3, 1.0]);
        let (next, spread) = ukf5::predict(&mean, &p, FELT, 0.05).expect("a covariance");
        (next[2] - heading, spread[(2, 2)])
    };
    let (turn, variance) = turned(0.0);
    for heading in [std::f64::consts::PI, -3.1, 9.0] {
        let (found, found_variance) = turned(heading);
        assert_near("turn", found, turn, 1e-12);
        assert_near("variance", found_variance, variance, 1e-12);
    }
    assert_near("turn", turn, 0.05, 1e-12);
}

#[test]
fn a_matrix_that_is_no_covariance_has_no_square_root_and_says_where() {
    let mut p = Covariance::identity();
    p[(3, 1)] = 2.0;
    p[(1, 3)] = 2.0;
    let refused = ukf5::square_root(&p).unwrap_err();
    assert_eq!((refused.row, refused.pivot), (3, -3.0));
    assert!(ukf5::predict(&Mean::zeros(), &p, FELT, 0.05).is_err());
    p[(3, 3)] = f64::NAN;
    assert!(ukf5::square_root(&p).is_err());
    let half_known = Covariance::from_diagonal(&Mean::from([0.0, 4.0, 0.0, 9.0, 0.0]));
    let root = ukf5::square_root(&half_known).unwrap();
    assert_eq!(root * root.transpose(), half_known);
}

#[test]
fn every_update_leaves_a_full_record() {
    for (name, wheels_used, gyro_used) in [
        ("wheel-kf", 2, 0),
        ("velocity-kf", 2, 0),
        ("ekf5", 2, 1),
        ("ekf5-corrected", 2, 1),
        ("ukf5", 2, 1),
    ] {
        let mut filter = named(name, &config());
        filter.observe(&wheels(0.0, 0.0, 0.0));
        filter.observe(&gyro(0.0, 0.0));
        filter.observe(&wheels(0.05, 0.2, 0.3));
        let record = filter.observe(&wheels(0.10, 0.5, 0.4));
        assert_eq!(record.verdict, Verdict::Accepted, "{name}");
        let used = |count: usize, record: &posebridge_telemetry::FusionRecord| {
            assert_eq!(usize::from(record.degrees_of_freedom), count, "{name}");
            let s = SMatrix::<f64, 3, 3>::from_fn(|i, j| record.innovation_covariance[i][j]);
            let nu = SVector::from(record.innovation);
            let s = s.view((0, 0), (count, count)).into_owned();
            let nu = nu.rows(0, count).into_owned();
            let inverse = s.clone().try_inverse().expect("positive definite");
            let nis = (nu.transpose() * inverse * &nu)[0];
            assert_near(name, record.nis, nis, 1e-9 * nis.max(1.0));
            let log_likelihood =
                -0.5 * (nis + s.determinant().ln() + count as f64 * std::f64::consts::TAU.ln());
            assert_near(name, record.log_likelihood, log_likelihood, 1e-6);
        };
        used(2, &record);
        assert_eq!(usize::from(record.degrees_of_freedom), wheels_used);
        let record = filter.observe(&gyro(0.10, 0.1));
        if gyro_used == 0 {
            assert_eq!(record.verdict, Verdict::Unused, "{name}");
        } else {
            used(gyro_used, &record);
        }
    }
}
