//! The indirect filter of paper 4: its derivatives, a tag with a lever, and what it says of the future. On the square of 3 m by
//! 3 m it drives in `indirect_square.rs`.
#![expect(
    clippy::expect_used,
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where a filter gives nothing"
)]

#[path = "support/indirect.rs"]
mod indirect;
#[path = "support/robot.rs"]
mod robot;

use indirect::{ACCELEROMETER_M_PER_S2, STEP_S, built, latest};
use nalgebra::{SMatrix, SVector};
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::papers::indirect::error_state::{
    ACCELERATED_ANGLE, ACCELERATED_DISTANCE, Covariance, DISTANCE, ErrorState, GYRO_ANGLE, HEADING, N,
    RADIUS_DIFFERENCE, RADIUS_SCALE, SampleIntervals, TRACK_SCALE, X, Y, nominal_step, process_noise, start_row,
    transition,
};
use posebridge_telemetry::{
    Fix, FusionOutcome, Meters, Observation, ObservationKind, Point2, Radians, SensorId, TimeDelta, Timestamp,
};
use robot::{RADIUS_M, TRACK_M, config};

/// Where a step leads from a path's state: x, y, heading, distance and the three scales.
fn stepped(state: &SVector<f64, 7>, travel: WheelTravel) -> SVector<f64, 7> {
    let config = config();
    let scales = [state[4], state[5], state[6]];
    let nominal = nominal_step(state[2], travel, &scales, &config.geometry, &config.noise);
    let mut next = *state;
    next[0] += nominal.displacement.dx_m;
    next[1] += nominal.displacement.dy_m;
    next[2] += nominal.step.turn_rad;
    next[3] += nominal.step.forward_m;
    next
}

#[test]
fn the_transition_of_the_errors_is_the_derivative_of_the_path() {
    let rows = [X, Y, HEADING, DISTANCE, RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE];
    let h = 1e-6;
    for (heading, left_m, right_m, scales) in [
        (0.3, 0.01, 0.012, [0.0, 0.0, 0.0]),
        (-2.9, -0.02, 0.05, [0.01, -0.02, 0.04]),
        (1.6, 0.0, 0.0, [0.0, 0.01, 0.0]),
        (3.1, -0.03, -0.01, [-0.05, 0.03, -0.1]),
    ] {
        let travel = WheelTravel { left_m, right_m };
        let config = config();
        let (geometry, noise) = (&config.geometry, &config.noise);
        let f = transition(&nominal_step(heading, travel, &scales, geometry, noise), STEP_S);
        let state = SVector::<f64, 7>::from([0.4, -1.0, heading, 2.0, scales[0], scales[1], scales[2]]);
        for column in 0..7 {
            let mut ahead = state;
            let mut behind = state;
            ahead[column] += h;
            behind[column] -= h;
            let by_difference = (stepped(&ahead, travel) - stepped(&behind, travel)) / (2.0 * h);
            for row in 0..7 {
                let found = f[(rows[row], rows[column])];
                assert!(
                    (found - by_difference[row]).abs() < 1e-8,
                    "{row} by {column}: {found} and {}",
                    by_difference[row]
                );
            }
        }
    }
}

#[test]
fn the_instruments_errors_grow_as_their_integrals_do() {
    let config = config();
    let (geometry, noise) = (&config.geometry, &config.noise);
    let nominal = nominal_step(0.0, WheelTravel::default(), &[0.0; 3], geometry, noise);
    let mut errors = ErrorState::zeros();
    for first in [ACCELERATED_DISTANCE, ACCELERATED_ANGLE] {
        errors[first] = 1.0;
        errors[first + 1] = 0.5;
        errors[first + 2] = -0.2;
    }
    errors[GYRO_ANGLE] = 0.1;
    errors[GYRO_ANGLE + 1] = 0.01;
    let mut in_parts = errors;
    for dt_s in [0.3, 0.7, 1.0] {
        in_parts = transition(&nominal, dt_s) * in_parts;
    }
    for first in [ACCELERATED_DISTANCE, ACCELERATED_ANGLE] {
        assert!((in_parts[first] - (1.0 + 0.5 * 2.0 - 0.1 * 4.0)).abs() < 1e-12);
        assert!((in_parts[first + 1] - 0.1).abs() < 1e-12);
    }
    assert!((in_parts[GYRO_ANGLE] - 0.12).abs() < 1e-12);
}

#[test]
fn process_noise_is_a_covariance_and_the_paths_part_is_none_at_rest() {
    let mut config = config();
    config.noise.accelerometer_m_per_s2 = ACCELEROMETER_M_PER_S2;
    let (geometry, noise) = (&config.geometry, &config.noise);
    let elapsed = SampleIntervals { dt_s: STEP_S, gyro_s2: STEP_S * STEP_S, accelerometer_s2: STEP_S * STEP_S };
    for (left_m, right_m) in [(0.01, 0.03), (-0.02, 0.02), (0.0, 0.0)] {
        let travel = WheelTravel { left_m, right_m };
        let q = process_noise(&nominal_step(0.7, travel, &[0.0; 3], geometry, noise), &elapsed, geometry, noise);
        assert_eq!(q, q.transpose());
        let lowest = q.symmetric_eigenvalues().min();
        assert!(lowest > -1e-15, "{lowest:e}");
        let path = q.fixed_view::<4, 4>(0, 0).norm();
        assert_eq!(path == 0.0, left_m == 0.0, "{path}");
    }
}

#[test]
fn an_instrument_that_starts_stands_against_the_path() {
    let half = SMatrix::<f64, N, N>::from_fn(|i, j| ((3 * i + 5 * j) % 7) as f64 - 3.0);
    let mut covariance: Covariance = half * half.transpose();
    let before = covariance;
    let mut errors = ErrorState::repeat(0.3);
    start_row(&mut errors, &mut covariance, GYRO_ANGLE, HEADING, 0.01);
    // g = -e_th - r with the rounding r: dz = e_th + g says nothing yet.
    assert_eq!(errors[GYRO_ANGLE], -0.3);
    let mut h = SVector::<f64, N>::zeros();
    h[HEADING] = 1.0;
    h[GYRO_ANGLE] = 1.0;
    assert!(((h.transpose() * covariance * h)[0] - 0.01).abs() < 1e-12);
    assert_eq!(covariance[(HEADING, X)], before[(HEADING, X)]);
    assert_eq!(covariance[(GYRO_ANGLE, X)], -before[(HEADING, X)]);
    assert!(covariance.symmetric_eigenvalues().min() > -1e-9);
}

/// The tag sits a third of a metre ahead and to the left: where it is seen tells the heading.
#[test]
fn a_fix_of_a_tag_with_a_lever_turns_the_robot_the_right_way() {
    for name in ["indirect", "indirect-feedback"] {
        let mut config = config();
        config.start = config.start.map(|mut start| {
            start.heading_sigma_rad = 0.1;
            start.position_sigma_m = 1e-3;
            start
        });
        config.noise.fix_position_m = 1e-3;
        let mut filter = built(name, &config);
        let (x, y, heading) = (0.3_f64, 0.2_f64, 0.02_f64);
        let seen = (x * heading.cos() - y * heading.sin(), x * heading.sin() + y * heading.cos());
        let record = filter.observe(&Observation {
            sensor: SensorId::CAMERA,
            stamp: Timestamp::from_millis(50),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Fix(Fix {
                position: Point2::new(Meters(seen.0), Meters(seen.1)),
                heading: None,
                covariance: None,
                tag_in_body: Point2::new(Meters(x), Meters(y)),
                reset_counter: 0,
            }),
        });
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{name}");
        assert_eq!(record.degrees_of_freedom, 2);
        let found = latest(filter.as_ref()).pose.heading.rad();
        assert!((found - heading).abs() < 5e-4, "{name}: {found}");
    }
}

/// A robot that is known exactly and a fix that is exact have nothing to weigh against each other.
#[test]
fn a_fix_that_could_not_be_weighed_is_not_one_that_was_used() {
    for name in ["indirect", "indirect-feedback"] {
        let mut config = config();
        config.start = config.start.map(|mut start| {
            start.position_sigma_m = 0.0;
            start.heading_sigma_rad = 0.0;
            start
        });
        config.noise.fix_position_m = 0.0;
        let mut filter = built(name, &config);
        for (at, observed) in [
            (0, ObservationKind::WheelAngles { left: Radians(0.0), right: Radians(0.0) }),
            (
                20,
                ObservationKind::Fix(Fix {
                    position: Point2::ORIGIN,
                    heading: None,
                    covariance: None,
                    tag_in_body: Point2::ORIGIN,
                    reset_counter: 0,
                }),
            ),
        ] {
            let verdict = filter
                .observe(&Observation {
                    sensor: SensorId::CAMERA,
                    stamp: Timestamp::from_millis(at),
                    stamp_sigma: TimeDelta::ZERO,
                    measurement: observed,
                })
                .outcome;
            let expected = if at == 0 { FusionOutcome::Accepted } else { FusionOutcome::Malformed };
            assert_eq!(verdict, expected, "{name}");
        }
        let now = latest(filter.as_ref());
        assert_eq!(now.fix_age, None, "{name}");
        assert_eq!(filter.latest_time(), Some(Timestamp::ZERO), "{name}");
    }
}

#[test]
fn an_estimate_of_the_future_turns_on_and_grows_doubtful_as_the_turn_rate_may_change() {
    let config = config();
    let mut filter = built("indirect", &config);
    for step in 0..=20 {
        let turned_rad = 0.5 * STEP_S * f64::from(step) * TRACK_M / (2.0 * RADIUS_M);
        filter.observe(&Observation {
            sensor: SensorId::WHEELS,
            stamp: Timestamp::from_millis(50 * i64::from(step)),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::WheelAngles { left: Radians(-turned_rad), right: Radians(turned_rad) },
        });
    }
    let now = latest(filter.as_ref());
    let ahead = filter.estimate_at(Timestamp::from_millis(1_400)).unwrap();
    assert!((ahead.pose.heading.rad() - 0.7).abs() < 1e-9);
    let grown = ahead.heading_sigma_rad().powi(2) - now.heading_sigma_rad().powi(2);
    let walk = config.params.turn_acceleration_rad_per_s2.powi(2) * 0.4_f64.powi(3) / 3.0;
    assert!((grown - walk).abs() < 1e-9, "{grown} {walk}");
}
