//! The filters of paper 1 against the paper: gains in the steady state, derivatives, sigma points, records.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when a filter gives no estimate")]

#[path = "support/readings.rs"]
mod readings;
#[path = "support/robot.rs"]
mod robot;

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use posebridge_estimator::Filter;
use posebridge_estimator::models::planar_speeds::{self, Acceleration, Covariance, Mean};
use posebridge_estimator::papers::ekf5::{self, FixUsage, SpeedVarianceOrder, process_noise};
use posebridge_estimator::papers::paper1::{DEGREE, SAMPLING_INTERVAL_S};
use posebridge_estimator::papers::wheel_kf::{LEFT_VARIANCE, RIGHT_VARIANCE, SingleWheelFilter};
use posebridge_estimator::papers::{ekf5_corrected, ukf5};
use posebridge_telemetry::{FusionOutcome, Timestamp, estimate::row};
use readings::{assert_near, covariance_in_paper_units, gyro, latest, named, wheels};
use robot::{RADIUS_M, TRACK_M, config};

/// A robot that stands for 500 of the paper's intervals: every gain is then the steady one.
fn at_rest(mut filter: Box<dyn Filter>) -> Box<dyn Filter> {
    for k in 0..500 {
        let secs = f64::from(k) * SAMPLING_INTERVAL_S;
        filter.observe(&wheels(secs, 0.0, 0.0));
        filter.observe(&gyro(secs, 0.0));
    }
    filter
}

#[test]
fn the_wheel_filters_have_the_papers_steady_gains_and_poles() {
    for (variance, gain, real, imaginary) in
        [(RIGHT_VARIANCE, [0.3880, 1.5646], 0.767, 0.155), (LEFT_VARIANCE, [0.4353, 1.9403], 0.734, 0.162)]
    {
        let mut wheel = SingleWheelFilter::at_rest(variance);
        for _ in 0..500 {
            wheel.predict(SAMPLING_INTERVAL_S);
            assert!(wheel.update(0.0).is_some());
        }
        let k = wheel.covariance.column(0) / variance;
        assert_near("K of phi", k[0], gain[0], 5e-5);
        assert_near("K of phidot", k[1], gain[1], 5e-5);
        let closed = (Matrix2::identity() - Matrix2::from_columns(&[k.into_owned(), Vector2::zeros()]))
            * Matrix2::new(1.0, SAMPLING_INTERVAL_S, 0.0, 1.0);
        let pole = closed.complex_eigenvalues()[0];
        assert_near("pole", pole.re, real, 5e-4);
        assert_near("pole", pole.im.abs(), imaginary, 5e-4);
    }
}

#[test]
fn the_speeds_of_the_wheel_filter_are_as_doubtful_as_its_wheels() {
    let [left, right] = [LEFT_VARIANCE, RIGHT_VARIANCE].map(|variance| {
        let mut wheel = SingleWheelFilter::at_rest(variance);
        for _ in 0..500 {
            wheel.predict(SAMPLING_INTERVAL_S);
            assert!(wheel.update(0.0).is_some());
        }
        wheel.covariance[(1, 1)] * (RADIUS_M * DEGREE).powi(2)
    });
    let p = latest(at_rest(named("wheel-kf", &config())).as_ref()).covariance;
    let found = [(row::FORWARD, row::FORWARD), (row::TURN, row::TURN), (row::FORWARD, row::TURN)].map(|(i, j)| p[i][j]);
    let expected = [0.25 * (left + right), (left + right) / TRACK_M.powi(2), (right - left) / (2.0 * TRACK_M)];
    for (found, expected) in found.into_iter().zip(expected) {
        assert_near("variance", found / expected, 1.0, 1e-6);
    }
}

#[test]
fn the_corrected_filter_expects_of_its_first_step_what_rounding_and_speeds_leave_open() {
    let mut filter = named("ekf5-corrected", &config());
    filter.observe(&wheels(0.0, 0.0, 0.0));
    let record = filter.observe(&wheels(0.05, 0.0, 0.0));
    let params = config().params;
    // Rounding counts twice, at the base and at the reading; 0.1 m/s and 1 rad/s are the speeds' sigmas at the start. How well
    // the heading itself is known does not matter: the integral began there.
    let dt_s: f64 = 0.05;
    let tick_m = RADIUS_M * DEGREE;
    let path =
        2.0 * tick_m.powi(2) / 24.0 + (0.1 * dt_s).powi(2) + params.acceleration_m_per_s2.powi(2) * dt_s.powi(3) / 3.0;
    let heading = 2.0 * (tick_m / TRACK_M).powi(2) / 6.0
        + dt_s.powi(2)
        + params.turn_acceleration_rad_per_s2.powi(2) * dt_s.powi(3) / 3.0;
    let s = record.innovation_covariance;
    assert_near("path", s[0][0] / path, 1.0, 1e-9);
    assert_near("heading", s[1][1] / heading, 1.0, 1e-9);
    // The gyro alone: its noise over the interval, its bias, and the turn that is open.
    let mut filter = named("ekf5-corrected", &config());
    filter.observe(&gyro(0.0, 0.0));
    let s = filter.observe(&gyro(0.05, 0.0)).innovation_covariance[0][0];
    let noise = robot::NOISE;
    let sample_var = noise.gyro_rad_per_s.powi(2) + noise.gyro_resolution_rad_per_s.powi(2) / 12.0;
    let turn = (sample_var + noise.gyro_bias_rad_per_s.powi(2)) * dt_s.powi(2)
        + dt_s.powi(2)
        + params.turn_acceleration_rad_per_s2.powi(2) * dt_s.powi(3) / 3.0
        + (0.01 * DEGREE).powi(2);
    assert_near("gyro", s / turn, 1.0, 1e-9);
}

#[test]
fn a_change_of_speed_moves_the_corrected_filters_robot_within_the_interval() {
    let mut filter = named("ekf5-corrected", &config());
    filter.observe(&wheels(0.0, 0.0, 0.0));
    let ahead = filter.estimate_at(Timestamp::from_millis(50)).expect("a prediction");
    let q = config().params.acceleration_m_per_s2.powi(2);
    // Heading zero: x is the way. 0.1 m/s is the speed's sigma at the start.
    let expected = 0.01 * 0.05 + q * 0.05_f64.powi(2) / 2.0;
    let found = ahead.covariance[row::X][row::FORWARD];
    assert_near("x and v", found / expected, 1.0, 1e-9);
}

#[test]
fn a_wheel_that_slips_alone_errs_in_path_and_heading_together() {
    let shared = |left: f64, right: f64| {
        let mut filter = named("ekf5-corrected", &config());
        let mut last = 0.0;
        for k in 0..100 {
            let turned = f64::from(k) * 0.3;
            let come = wheels(f64::from(k) * 0.05, left * turned, right * turned);
            last = filter.observe(&come).innovation_covariance[0][1];
        }
        last
    };
    // k_w^2 s / (2 b) for the wheel that moves, by the noise of motion.
    let slip = robot::NOISE.wheel_travel_m_per_sqrt_m.powi(2) * 0.3 * RADIUS_M / (2.0 * TRACK_M);
    assert!(shared(0.0, 1.0) > 0.5 * slip, "{}", shared(0.0, 1.0));
    assert!(shared(1.0, 0.0) < -0.5 * slip, "{}", shared(1.0, 0.0));
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
        (SpeedVarianceOrder::Printed, 0.527_31, [0.140_53, 0.397_05], [0.358_99, 1.014_26]),
        (SpeedVarianceOrder::Swapped, 0.355_49, [0.151_04, 0.426_73], [0.594_16, 1.678_67]),
    ] {
        let filter = at_rest(ekf5::build(&config(), order, FixUsage::Unused));
        let p = covariance_in_paper_units(filter.as_ref());
        assert_near("K of v", p[(row::FORWARD, row::FORWARD)] / 5.1, v, 5e-6);
        for (i, variance) in [0.938, 0.332].into_iter().enumerate() {
            let heading = p[(row::HEADING, row::HEADING)] / variance;
            assert_near("K of th", heading, th[i], 5e-6);
            assert_near("K of w", p[(row::TURN, row::HEADING)] / variance, w[i], 5e-6);
        }
    }
}

#[test]
fn nothing_observes_the_position_so_its_variance_grows_by_the_papers_two_per_step() {
    let mut filter = at_rest(named("ekf5", &config()));
    let before = covariance_in_paper_units(filter.as_ref());
    filter.observe(&wheels(500.0 * SAMPLING_INTERVAL_S, 0.0, 0.0));
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

const FELT: Acceleration = Acceleration { forward_m_per_s2: 0.7, turn_rad_per_s2: -1.9 };

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
    let felt = Acceleration::from_wheels(0.2, 0.5, &robot::GEOMETRY);
    assert_near("a", felt.forward_m_per_s2, 0.35, 1e-12);
    assert_near("alpha", felt.turn_rad_per_s2, 0.3 / TRACK_M, 1e-9);
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
    assert_near("var y", spread[(1, 1)], 0.5 * (1.0 - (-0.18_f64).exp()), 6e-3);
    assert!((spread[(1, 1)] - 0.09).abs() > 0.01, "{spread}");
}

#[test]
fn the_mean_heading_of_sigma_points_does_not_care_where_the_circle_is_cut() {
    let p = process_noise(SpeedVarianceOrder::Printed, 0.05) * 20.0;
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
    // A row that is known exactly and yet varies with another.
    let mut p = Covariance::identity();
    p[(1, 1)] = 0.0;
    p[(3, 1)] = 0.5;
    p[(1, 3)] = 0.5;
    assert_eq!(ukf5::square_root(&p).unwrap_err().row, 1);
    let half_known = Covariance::from_diagonal(&Mean::from([0.0, 4.0, 0.0, 9.0, 0.0]));
    let root = ukf5::square_root(&half_known).unwrap();
    assert_eq!(root * root.transpose(), half_known);
}

#[test]
fn every_update_leaves_a_full_record() {
    for (name, wheels_used, gyro_used) in
        [("wheel-kf", 2, 0), ("velocity-kf", 2, 0), ("ekf5", 2, 1), ("ekf5-corrected", 2, 1), ("ukf5", 2, 1)]
    {
        let mut filter = named(name, &config());
        filter.observe(&wheels(0.0, 0.0, 0.0));
        filter.observe(&gyro(0.0, 0.0));
        filter.observe(&wheels(0.05, 0.2, 0.3));
        let record = filter.observe(&wheels(0.10, 0.5, 0.4));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{name}");
        let used = |count: usize, record: &posebridge_telemetry::FusionRecord| {
            assert_eq!(usize::from(record.degrees_of_freedom), count, "{name}");
            let s = SMatrix::<f64, 3, 3>::from_fn(|i, j| record.innovation_covariance[i][j]);
            let nu = SVector::from(record.innovation);
            let s = s.view((0, 0), (count, count)).into_owned();
            let nu = nu.rows(0, count).into_owned();
            let inverse = s.clone().try_inverse().expect("positive definite");
            let nis = (nu.transpose() * inverse * &nu)[0];
            assert_near(name, record.nis, nis, 1e-9 * nis.max(1.0));
            let log_likelihood = -0.5 * (nis + s.determinant().ln() + count as f64 * std::f64::consts::TAU.ln());
            assert_near(name, record.log_likelihood, log_likelihood, 1e-6);
        };
        used(2, &record);
        assert_eq!(usize::from(record.degrees_of_freedom), wheels_used);
        let record = filter.observe(&gyro(0.10, 0.1));
        if gyro_used == 0 {
            assert_eq!(record.outcome, FusionOutcome::Unused, "{name}");
        } else {
            used(gyro_used, &record);
        }
    }
}
