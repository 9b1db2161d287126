//! The filters of paper 1 against the paper and against independent implementations: gains in the steady state, derivatives, sigma
//! points, records; the textbook's Kalman filter, and the paper's EKF written out.

use nalgebra::{Matrix1, Matrix2, RowVector2, SMatrix, SVector, Vector1, Vector2};
use posebridge_estimator::Filter;
use posebridge_estimator::models::planar_speeds::{self, Acceleration, Covariance, Mean};
use posebridge_estimator::papers::ekf5::{self, FixUsage};
use posebridge_estimator::papers::paper1::{
    CENTIMETRE, DEGREE, FiveStateMatrices, SAMPLING_INTERVAL_S, UNITS, WheelMatrices,
};
use posebridge_estimator::papers::wheel_kf::SingleWheelFilter;
use posebridge_estimator::papers::{ekf5_corrected, sigma_points, ukf5};
use posebridge_telemetry::{FusionOutcome, FusionRecord, Timestamp, estimate::row, quantities::wrap_rad};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::support::filters::{latest, named, rest, without_start};
use crate::support::observe::{accelerations, gyro, wheels};
use crate::support::robot::{GEOMETRY, NOISE, RADIUS_M, TRACK_M, config};
use crate::support::textbook;

/// The published covariance in the paper's units: cm, degrees and these per second.
fn covariance_in_paper_units(filter: &dyn Filter) -> Covariance {
    let published = latest(filter).covariance;
    Covariance::from_fn(|i, j| published[i][j] / (UNITS[i] * UNITS[j]))
}

fn assert_near(what: &str, found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() < tolerance, "{what}: {found} instead of {expected}");
}

/// A robot at rest for 500 of the paper's intervals: every gain is then the steady one.
fn at_rest(mut filter: Box<dyn Filter>) -> Box<dyn Filter> {
    rest(filter.as_mut(), 500, 0.0);
    filter
}

fn wheels_at_rest() -> [SingleWheelFilter; 2] {
    SingleWheelFilter::pair(&WheelMatrices::AS_PRINTED).map(|mut wheel| {
        for _ in 0..500 {
            wheel.predict(SAMPLING_INTERVAL_S);
            assert!(wheel.update(0.0).is_some());
        }
        wheel
    })
}

#[test]
fn the_wheel_filters_have_the_papers_steady_gains() {
    let wheels = wheels_at_rest().into_iter().zip([(1.5, [0.4353, 1.9403]), (2.5, [0.3880, 1.5646])]);
    for (wheel, (variance, gain)) in wheels {
        let k = wheel.covariance.column(0) / variance;
        assert_near("K of phi", k[0], gain[0], 5e-5);
        assert_near("K of phidot", k[1], gain[1], 5e-5);
    }
}

#[test]
fn the_speeds_of_the_wheel_filter_are_as_uncertain_as_its_wheels() {
    let [left, right] = wheels_at_rest().map(|wheel| wheel.covariance[(1, 1)] * (RADIUS_M * DEGREE).powi(2));
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
    filter.observe(&wheels(0, 0.0, 0.0));
    let record = filter.observe(&wheels(50, 0.0, 0.0));
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
    filter.observe(&gyro(0, 0.0));
    let s = filter.observe(&gyro(50, 0.0)).innovation_covariance[0][0];
    let noise = NOISE;
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
    filter.observe(&wheels(0, 0.0, 0.0));
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
        for k in 0..100_i64 {
            let turned = k as f64 * 0.3;
            let come = wheels(50 * k, left * turned, right * turned);
            last = filter.observe(&come).innovation_covariance[0][1];
        }
        last
    };
    // k_w^2 s / (2 b) for the wheel that moves, by the noise of motion.
    let slip = NOISE.wheel_travel_m_per_sqrt_m.powi(2) * 0.3 * RADIUS_M / (2.0 * TRACK_M);
    assert!(shared(0.0, 1.0) > 0.5 * slip, "{}", shared(0.0, 1.0));
    assert!(shared(1.0, 0.0) < -0.5 * slip, "{}", shared(1.0, 0.0));
}

#[test]
fn the_five_state_filter_has_the_papers_steady_gains_in_both_readings_of_the_order() {
    for (matrices, v, th, w) in [
        (FiveStateMatrices::AS_PRINTED, 0.527_31, [0.140_53, 0.397_05], [0.358_99, 1.014_26]),
        (FiveStateMatrices::SWAPPED, 0.355_49, [0.151_04, 0.426_73], [0.594_16, 1.678_67]),
    ] {
        let filter = at_rest(ekf5::build(&config(), &matrices, FixUsage::Unused));
        let p = covariance_in_paper_units(filter.as_ref());
        assert_near("K of v", p[(row::FORWARD, row::FORWARD)] / 5.1, v, 5e-6);
        for (i, variance) in [0.938, 0.332].into_iter().enumerate() {
            let heading = p[(row::HEADING, row::HEADING)] / variance;
            assert_near("K of th", heading, th[i], 5e-6);
            assert_near("K of w", p[(row::TURN, row::HEADING)] / variance, w[i], 5e-6);
        }
    }
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
fn accelerations_of_the_wheels_are_those_of_the_body() {
    let felt = Acceleration::from_wheels(0.2, 0.5, &GEOMETRY);
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
fn sigma_points_model_that_an_uncertain_heading_shortens_the_path() {
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
    let p = FiveStateMatrices::AS_PRINTED.process_noise(0.05) * 20.0;
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
fn a_matrix_that_is_no_covariance_has_no_square_root() {
    let mut p = Covariance::identity();
    p[(3, 1)] = 2.0;
    p[(1, 3)] = 2.0;
    assert!(sigma_points::square_root(&p).is_none() && ukf5::predict(&Mean::zeros(), &p, FELT, 0.05).is_none());
    p[(3, 3)] = f64::NAN;
    assert!(sigma_points::square_root(&p).is_none());
    // A row that is known exactly and yet varies with another.
    let mut p = Covariance::identity();
    p[(1, 1)] = 0.0;
    p[(3, 1)] = 0.5;
    p[(1, 3)] = 0.5;
    assert!(sigma_points::square_root(&p).is_none());
    let half_known = Covariance::from_diagonal(&Mean::from([0.0, 4.0, 0.0, 9.0, 0.0]));
    let root = sigma_points::square_root(&half_known).unwrap();
    assert_eq!(root * root.transpose(), half_known);
}

#[test]
fn every_update_leaves_a_full_record() {
    for (name, wheels_used, gyro_used) in
        [("wheel-kf", 2, 0), ("velocity-kf", 2, 0), ("ekf5", 2, 1), ("ekf5-corrected", 2, 1), ("ukf5", 2, 1)]
    {
        let mut filter = named(name, &config());
        filter.observe(&wheels(0, 0.0, 0.0));
        filter.observe(&gyro(0, 0.0));
        filter.observe(&wheels(50, 0.2, 0.3));
        let record = filter.observe(&wheels(100, 0.5, 0.4));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{name}");
        let used = |count: usize, record: &FusionRecord| {
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
        let record = filter.observe(&gyro(100, 0.1));
        if gyro_used == 0 {
            assert_eq!(record.outcome, FusionOutcome::Unused, "{name}");
        } else {
            used(gyro_used, &record);
        }
    }
}

/// Seeded intervals around the paper's, and a robot that drives an uneven way: milliseconds, left and right angle in rad.
fn uneven_drive(seed: u64) -> Vec<(i64, f64, f64)> {
    let mut random = Pcg64::seed_from_u64(seed);
    let (mut millis, mut left, mut right) = (0, 0.0, 0.0);
    (0..400)
        .map(|k| {
            let here = (millis, left, right);
            let dt_ms = random.random_range(30..=70_i64);
            let dt_s = dt_ms as f64 * 1e-3;
            let phase = f64::from(k) * 0.05;
            left += (6.0 * phase.sin() + random.random::<f64>()) * dt_s;
            right += (6.0 * (0.7 * phase).cos() + random.random::<f64>()) * dt_s;
            millis += dt_ms;
            here
        })
        .collect()
}

#[test]
fn the_wheel_filter_equals_the_textbooks_kalman_filter() {
    let [_, mut wheel] = SingleWheelFilter::pair(&WheelMatrices::AS_PRINTED);
    let (mut x, mut p) = (Vector2::zeros(), Matrix2::identity() * 10.0);
    for pair in uneven_drive(1).windows(2) {
        let dt_s = (pair[1].0 - pair[0].0) as f64 * 1e-3;
        let counted = pair[1].2 / DEGREE;
        let f = Matrix2::new(1.0, dt_s, 0.0, 1.0);
        x = f * x;
        p = f * p * f.transpose() + Matrix2::new(0.1, 0.0, 0.0, 10.0) * (dt_s / 0.05);
        textbook::update(&mut x, &mut p, &RowVector2::new(1.0, 0.0), &Matrix1::new(2.5), &Vector1::new(counted));
        wheel.predict(dt_s);
        assert!(wheel.update(counted).is_some());
        assert!((wheel.mean - x).amax() < 1e-9);
        assert!((wheel.covariance - p).amax() < 1e-9);
    }
}

/// Both readings of the odometry, written out: the change of the filtered angles, and equation 13 with the filtered speeds of k-1.
#[test]
fn the_wheel_filters_pose_follows_its_angles_or_its_speeds() {
    for name in ["wheel-kf", "wheel-kf-speeds"] {
        let mut filter = named(name, &without_start());
        let mut two = SingleWheelFilter::pair(&WheelMatrices::AS_PRINTED);
        let (mut x, mut y, mut heading) = (0.0, 0.0, 0.0);
        let drive = uneven_drive(4);
        filter.observe(&wheels(0, 0.0, 0.0));
        for pair in drive.windows(2) {
            let dt_s = (pair[1].0 - pair[0].0) as f64 * 1e-3;
            let before = two.map(|wheel| wheel.mean);
            for (wheel, turned) in two.iter_mut().zip([pair[1].1, pair[1].2]) {
                wheel.predict(dt_s);
                assert!(wheel.update(turned / DEGREE).is_some());
            }
            let [left_m, right_m] = [0, 1].map(|i: usize| {
                let turned = if name == "wheel-kf" { two[i].mean[0] - before[i][0] } else { before[i][1] * dt_s };
                turned * DEGREE * RADIUS_M
            });
            let (d, turn) = (0.5 * (left_m + right_m), (right_m - left_m) / TRACK_M);
            x += d * (heading + 0.5 * turn).cos();
            y += d * (heading + 0.5 * turn).sin();
            heading += turn;
            filter.observe(&wheels(pair[1].0, pair[1].1, pair[1].2));
        }
        let pose = latest(filter.as_ref()).pose;
        assert_near(name, pose.x.0, x, 1e-9);
        assert_near(name, pose.y.0, y, 1e-9);
        assert_near(name, wrap_rad(pose.heading.rad() - heading), 0.0, 1e-9);
    }
}

#[test]
fn the_velocity_filter_equals_the_textbooks_kalman_filter() {
    let mut filter = named("velocity-kf", &config());
    let (mut x, mut p) = (Vector2::zeros(), Matrix2::identity() * 10.0);
    let felt_at = |k: usize| (0.3 * (k as f64 * 0.11).sin(), 0.2 * (k as f64 * 0.07).cos());
    for (k, pair) in uneven_drive(2).windows(2).enumerate() {
        let (left, right) = felt_at(k);
        if k == 0 {
            filter.observe(&wheels(pair[0].0, pair[0].1, pair[0].2));
        }
        filter.observe(&accelerations(pair[0].0, left, right));
        filter.observe(&wheels(pair[1].0, pair[1].1, pair[1].2));

        let dt_s = (pair[1].0 - pair[0].0) as f64 * 1e-3;
        let [left_m, right_m] = [pair[1].1 - pair[0].1, pair[1].2 - pair[0].2].map(|turned| turned * RADIUS_M);
        let felt = Acceleration::from_wheels(left, right, &GEOMETRY);
        let per_unit = Vector2::new(1.0 / CENTIMETRE, 1.0 / DEGREE);
        x += Vector2::new(felt.forward_m_per_s2, felt.turn_rad_per_s2).component_mul(&per_unit) * dt_s;
        p += Matrix2::identity() * (2.2 * dt_s / 0.05);
        let speeds = Vector2::new(0.5 * (left_m + right_m), (right_m - left_m) / TRACK_M) / dt_s;
        let r = Matrix2::new(5.1, 0.0, 0.0, 1.938);
        textbook::update(&mut x, &mut p, &Matrix2::identity(), &r, &speeds.component_mul(&per_unit));

        let ours = latest(filter.as_ref());
        let (v, w) = (ours.forward_speed.0 / CENTIMETRE, ours.turn_rate.0 / DEGREE);
        assert!((Vector2::new(v, w) - x).amax() < 1e-9, "step {k}");
        let block = covariance_in_paper_units(filter.as_ref()).fixed_view::<2, 2>(row::FORWARD, row::FORWARD) - p;
        assert!(block.amax() < 1e-9, "step {k}");
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
        self.x = Mean::from([x + v * ts * phi.cos(), y + v * ts * phi.sin(), th + ts * w, v + ts * a, w + ts * alpha]);
        let q = Covariance::from_diagonal(&Mean::from([2.0, 2.0, 0.1, 3.0, 1.0]));
        self.p = f * self.p * f.transpose() + q * (ts / 0.05);
        let mut h = SMatrix::<f64, 3, 5>::zeros();
        h[(0, 3)] = 1.0;
        h[(1, 2)] = 1.0;
        h[(2, 2)] = 1.0;
        let r = SMatrix::<f64, 3, 3>::from_diagonal(&SVector::from([5.1, 0.938, 0.332]));
        textbook::update(&mut self.x, &mut self.p, &h, &r, z);
    }
}

#[test]
fn ekf5_equals_the_paper_written_out_in_centimetres_and_degrees() {
    let mut filter = named("ekf5", &without_start());
    let mut literal = Literal { x: Mean::zeros(), p: Covariance::identity() * 0.05 };
    let (mut wheel_heading, mut gyro_heading) = (0.0, 0.0);
    let drive = uneven_drive(3);
    filter.observe(&wheels(0, 0.0, 0.0));
    filter.observe(&gyro(0, 0.0));
    for (k, pair) in drive.windows(2).enumerate() {
        let felt = (0.2 * (k as f64 * 0.1).sin(), 0.1);
        let ts = (pair[1].0 - pair[0].0) as f64 * 1e-3;
        let [left_m, right_m] = [pair[1].1 - pair[0].1, pair[1].2 - pair[0].2].map(|turned| turned * RADIUS_M);
        let turn_rad = (right_m - left_m) / TRACK_M;
        let rate = turn_rad / ts + 0.02 * (k as f64 * 0.3).sin();
        filter.observe(&accelerations(pair[0].0, felt.0, felt.1));
        filter.observe(&wheels(pair[1].0, pair[1].1, pair[1].2));
        filter.observe(&gyro(pair[1].0, rate));

        wheel_heading += turn_rad / DEGREE;
        gyro_heading += rate * ts / DEGREE;
        let speed = 0.5 * (left_m + right_m) / ts / CENTIMETRE;
        let z = SVector::from([speed, wheel_heading, gyro_heading]);
        let body = Acceleration::from_wheels(felt.0, felt.1, &GEOMETRY);
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
