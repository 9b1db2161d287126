//! The filters of paper 1 against independent implementations: a foreign Kalman filter, and the paper's EKF written out.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when a filter gives no estimate")]

#[path = "support/readings.rs"]
mod readings;
#[path = "support/robot.rs"]
mod robot;

use adskalman::{ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use nalgebra::{Matrix2, SMatrix, SVector, U1, U2, Vector1, Vector2};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::planar_speeds::{Acceleration, Covariance, Mean};
use posebridge_estimator::papers::paper1::{CENTIMETRE, DEGREE};
use posebridge_estimator::papers::wheel_kf::{RIGHT_VARIANCE, SingleWheelFilter};
use posebridge_telemetry::{MetersPerSecondSquared, Observation, ObservationKind, SensorId, estimate::row};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use readings::{assert_near, at, covariance_in_paper_units, gyro, latest, named, wheels};
use robot::{RADIUS_M, TRACK_M, config};

fn accelerations(secs: f64, left: f64, right: f64) -> Observation {
    let observed = ObservationKind::WheelAccelerations {
        left: MetersPerSecondSquared(left),
        right: MetersPerSecondSquared(right),
    };
    at(secs, SensorId::ACCELEROMETER, observed)
}

fn without_start() -> FilterConfig {
    FilterConfig { start: None, ..config() }
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
            let dt_s = (0.03 + 0.04 * random.random::<f64>()).mul_add(1e3, 0.5).floor() * 1e-3;
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
    let mut wheel = SingleWheelFilter::at_rest(RIGHT_VARIANCE);
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
        let [left_m, right_m] = [pair[1].1 - pair[0].1, pair[1].2 - pair[0].2].map(|turned| turned * RADIUS_M);
        let felt = Acceleration::from_wheels(left, right, &robot::GEOMETRY);
        let per_unit = Vector2::new(1.0 / CENTIMETRE, 1.0 / DEGREE);
        let model = Foreign::<2> {
            f: [Matrix2::identity(); 2],
            q: Matrix2::identity() * (2.2 * dt_s / 0.05),
            input: Vector2::new(felt.forward_m_per_s2, felt.turn_rad_per_s2).component_mul(&per_unit) * dt_s,
            h: Matrix2::identity(),
            h_transposed: Matrix2::identity(),
            r: Matrix2::new(5.1, 0.0, 0.0, 1.938),
        };
        let speeds = Vector2::new(0.5 * (left_m + right_m), (right_m - left_m) / TRACK_M) / dt_s;
        foreign = foreign_step!(&model, &foreign, &speeds.component_mul(&per_unit));

        let ours = latest(filter.as_ref());
        let v = ours.forward_speed.0 / CENTIMETRE;
        let w = ours.turn_rate.0 / DEGREE;
        assert!((Vector2::new(v, w) - foreign.state()).amax() < 1e-9, "step {k}");
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
        self.x = Mean::from([x + v * ts * phi.cos(), y + v * ts * phi.sin(), th + ts * w, v + ts * a, w + ts * alpha]);
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
    let mut literal = Literal { x: Mean::zeros(), p: Covariance::identity() * 0.05 };
    let (mut wheel_heading, mut gyro_heading) = (0.0, 0.0);
    let drive = uneven_drive(3);
    filter.observe(&wheels(0.0, 0.0, 0.0));
    filter.observe(&gyro(0.0, 0.0));
    for (k, pair) in drive.windows(2).enumerate() {
        let felt = (0.2 * (k as f64 * 0.1).sin(), 0.1);
        let ts = pair[1].0 - pair[0].0;
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
        let body = Acceleration::from_wheels(felt.0, felt.1, &robot::GEOMETRY);
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
