//! What every filter of the table must do, whatever it makes of its observations. What it must refuse: `conformance_refusals.rs`.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when a filter gives no estimate")]

#[path = "support/conformance.rs"]
mod conformance;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/stamped.rs"]
mod stamped;

use std::f64::consts::PI;

use conformance::{belief, drive_straight, fix, fix_of, for_each, latest, start};
use nalgebra::Matrix5;
use posebridge_estimator::{Filter, FilterConfig, Initialization, LateDataPolicy, StartPose};
use posebridge_telemetry::{
    Estimate, Fix, FusionOutcome, Heading, Meters, MetersPerSecond, ObservationKind, Point2, PositionCovariance,
    Radians, RadiansPerSecond, SensorId, TimeDelta,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use robot::{DEGREE, RADIUS_M, TRACK_M, config};
use stamped::{at, gyro, ms, wheels};

fn without_start() -> FilterConfig {
    FilterConfig { start: None, ..config() }
}

#[test]
fn before_the_first_observation_there_is_no_estimate() {
    for_each(&config(), |entry, filter| {
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        assert!(filter.estimate_at(ms(0)).is_none(), "{}", entry.name);
    });
}

#[test]
fn nothing_is_valid_before_a_fix_or_a_start_and_a_pose_that_is_set_is_a_start() {
    for_each(&without_start(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        let unplaced = latest(filter.as_ref());
        assert!(!unplaced.validity.position, "{}", entry.name);
        assert!(!unplaced.validity.heading, "{}", entry.name);
        assert!(unplaced.validity.speeds, "{}", entry.name);
        assert!(unplaced.is_dead_reckoning && unplaced.fix_age.is_none());
        let _ = filter.set_pose(&start(1.0, 2.0, 0.5));
        let placed = latest(filter.as_ref());
        assert!(placed.validity.position, "{}", entry.name);
        assert!(placed.validity.heading, "{}", entry.name);
        assert!(placed.is_dead_reckoning, "{}: a start is no fix", entry.name);
    });
}

#[test]
fn a_fix_places_the_filters_that_say_so_and_no_others() {
    for_each(&without_start(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        for millis in (2_050..=4_000).step_by(50) {
            filter.observe(&fix(millis, fix_of(1.0, 2.0, 0.0)));
            let rad = 0.4 / RADIUS_M;
            filter.observe(&gyro(millis, 0.0));
            filter.observe(&wheels(millis, rad, rad));
        }
        let is_placed = latest(filter.as_ref()).validity.position;
        assert_eq!(is_placed, entry.initialization == Initialization::Fix, "{}", entry.name);
    });
}

#[test]
fn a_pose_that_is_set_is_believed_and_counted_with_its_jump() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        // A fix of the very same instant has been seen when the person speaks.
        filter.observe(&fix(2_000, fix_of(0.4, 0.0, 0.0)));
        let before = latest(filter.as_ref());
        // Set with so much doubt that the fix would pass the gate, were it to have the last word.
        let vague = StartPose { position_sigma_m: 3.0, heading_sigma_rad: 3.0, ..start(-1.0, 2.0, -3.0) };
        let verdict = filter.set_pose(&vague);
        assert_eq!(verdict, FusionOutcome::PoseReset, "{}", entry.name);
        let after = latest(filter.as_ref());
        assert_eq!((after.pose.x.0, after.pose.y.0), (-1.0, 2.0), "{}", entry.name);
        assert_eq!(after.pose.heading.rad(), -3.0, "{}", entry.name);
        assert!((after.x_sigma_m() - 3.0).abs() < 1e-12, "{}", entry.name);
        assert_eq!(after.reset_counter, before.reset_counter.wrapping_add(1));
        let jump = after.last_correction.expect("it is told");
        assert_eq!(jump.dx_m, -1.0 - before.pose.x.0, "{}", entry.name);
        assert_eq!(jump.dy_m, 2.0 - before.pose.y.0, "{}", entry.name);
        assert!((jump.turn.0 + 3.0 + before.pose.heading.rad()).abs() < 1e-12);

        filter.observe(&wheels(2_050, 0.4 / RADIUS_M, 0.4 / RADIUS_M));
        let later = latest(filter.as_ref());
        assert!((later.pose.x.0 + 1.0).abs() < 0.02, "{}: it lasts", entry.name);
        assert_eq!(later.reset_counter, after.reset_counter, "{}", entry.name);
    });
}

#[test]
fn a_pose_that_is_set_is_not_changed_by_what_happened_before() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let _ = filter.set_pose(&start(5.0, 5.0, 0.0));
        let believed_before = belief(filter.as_ref());
        filter.observe(&wheels(975, 0.25 / RADIUS_M, 0.1 / RADIUS_M));
        assert_eq!(filter.latest_time(), Some(ms(1_000)), "{}", entry.name);
        let rad = 0.21 / RADIUS_M;
        filter.observe(&wheels(1_050, rad, rad));
        let x_m = latest(filter.as_ref()).pose.x.0;
        match entry.late_data {
            LateDataPolicy::Replayed => assert!((x_m - 5.01).abs() < 1e-6, "{}: {x_m}", entry.name),
            // These smooth the counters, so the way after the jump is theirs; the past must not change it at all.
            LateDataPolicy::OnArrival => {
                let mut untold = (entry.build)(&config());
                drive_straight(untold.as_mut(), 1_000);
                let _ = untold.set_pose(&start(5.0, 5.0, 0.0));
                assert_eq!(belief(untold.as_ref()), believed_before, "{}", entry.name);
                untold.observe(&wheels(1_050, rad, rad));
                assert_eq!(belief(filter.as_ref()), belief(untold.as_ref()));
                assert!((x_m - 5.01).abs() < 1e-3, "{}: {x_m}", entry.name);
            }
        }
    });
}

#[test]
fn after_a_restart_of_the_bricks_clock_no_speed_from_before_it_is_left() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        assert!(latest(filter.as_ref()).forward_speed.0 > 0.15);
        filter.restart_clock();
        filter.observe(&wheels(40, 0.0, 0.0));
        let speed = latest(filter.as_ref()).forward_speed.0;
        assert_eq!(speed, 0.0, "{}", entry.name);
    });
}

#[test]
fn a_restart_of_the_bricks_clock_keeps_the_pose_with_more_doubt() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 5_000);
        let before = latest(filter.as_ref());
        filter.restart_clock();
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        assert!(filter.estimate_at(ms(5_000)).is_none(), "{}", entry.name);
        let record = filter.observe(&wheels(30, 0.0, 0.0));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{}", entry.name);
        let after = latest(filter.as_ref());
        assert_eq!(after.pose, before.pose, "{}", entry.name);
        assert_eq!(after.reset_counter, before.reset_counter, "{}", entry.name);
        assert!(after.x_sigma_m() > 0.1 && after.heading_sigma_rad() > 0.3);
        assert!(after.validity.position && after.validity.heading);
    });
}

#[test]
fn counters_that_jump_to_zero_are_a_new_base_and_not_motion() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 10_000);
        let before = latest(filter.as_ref());
        let record = filter.observe(&wheels(10_050, 0.0, 0.0));
        assert_eq!(record.outcome, FusionOutcome::Rebased, "{}", entry.name);
        let rad = 0.01 / RADIUS_M;
        filter.observe(&wheels(10_100, rad, rad));
        // 1 cm after the jump, and at most another one that the filter makes up for the interval of the jump.
        let moved_m = latest(filter.as_ref()).pose.x.0 - before.pose.x.0;
        assert!((0.0099..0.0201).contains(&moved_m), "{}: {moved_m}", entry.name);
    });
}

/// A filter that corrects nothing afterwards must say of the past what it said then: it may have begun with too slow a robot,
/// but it must not change its mind.
#[test]
fn an_estimate_of_the_past_is_where_the_robot_was_as_far_as_the_history_reaches() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 10_000);
        for millis in [10_000, 9_990, 9_000, 7_010] {
            let estimate = filter.estimate_at(ms(millis)).expect("within the history");
            assert_eq!(estimate.stamp, ms(millis), "{}", entry.name);
            if entry.late_data == LateDataPolicy::OnArrival {
                let mut then = (entry.build)(&config());
                drive_straight(then.as_mut(), millis);
                let said = then.estimate_at(ms(millis)).expect("just observed");
                assert_eq!(estimate.pose, said.pose, "{} at {millis}", entry.name);
                assert_eq!(estimate.covariance, said.covariance, "{}", entry.name);
            } else {
                let error_m = estimate.pose.x.0 - 0.2e-3 * millis as f64;
                assert!(error_m.abs() < 1e-3, "{}: {error_m}", entry.name);
            }
        }
        assert!(filter.estimate_at(ms(3_000)).is_none(), "{}", entry.name);
    });
}

#[test]
fn an_estimate_of_the_future_is_no_surer_than_one_of_the_present() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        let now = latest(filter.as_ref());
        for millis in [2_001, 2_200, 4_000, 2_000_000] {
            let ahead = filter.estimate_at(ms(millis)).expect("by prediction");
            assert_eq!(ahead.stamp, ms(millis), "{}", entry.name);
            assert!(ahead.x_sigma_m() >= now.x_sigma_m(), "{}", entry.name);
            assert!(
                ahead.heading_sigma_rad() >= now.heading_sigma_rad() * (1.0 - 1e-9),
                "{} at {millis} ms",
                entry.name
            );
            assert_eq!(ahead.validity.speeds, millis <= 2_500, "{}: speeds grow stale", entry.name);
        }
    });
}

/// An observation of any kind that a robot with a camera sends, with a stamp that may be early, late or doubled.
fn any_observation() -> impl Strategy<Value = (i64, ObservationKind)> {
    let wheel = -400.0..400.0;
    let wheels = (wheel.clone(), wheel).prop_map(|(left, right)| ObservationKind::WheelAngles {
        left: Radians(left * 0.1),
        right: Radians(right * 0.1),
    });
    let gyro = (-9.0..9.0).prop_map(|rate| ObservationKind::TurnRate(RadiansPerSecond(rate)));
    let place = (-5.0..5.0, -5.0..5.0, -PI..PI);
    let shape = (prop::option::of((1e-8..4.0, -0.99..0.99, 1e-8..4.0, 1e-8..4.0)), any::<bool>(), -0.5..0.5);
    let fix = (place, shape).prop_map(|((x, y, heading), (covariance, has_heading, lever))| {
        ObservationKind::Fix(Fix {
            heading: has_heading.then(|| Heading::from_rad(heading)),
            covariance: covariance.map(|(xx_m2, share, yy_m2, heading_rad2): (f64, f64, f64, f64)| {
                PositionCovariance { xx_m2, xy_m2: share * (xx_m2 * yy_m2).sqrt(), yy_m2, heading_rad2 }
            }),
            tag_in_body: Point2::new(Meters(lever), Meters(0.1)),
            ..fix_of(x, y, 0.0)
        })
    });
    let velocity = (-1.0..1.0, -9.0..9.0).prop_map(|(forward, turn)| ObservationKind::BodyVelocity {
        forward: MetersPerSecond(forward),
        turn: RadiansPerSecond(turn),
    });
    let observed = prop_oneof![4 => wheels, 4 => gyro, 3 => fix, 1 => velocity];
    let step_ms = prop_oneof![8 => 0_i64..60, 2 => -500_i64..0, 1 => 0_i64..3_000];
    (step_ms, observed)
}

/// Finite, wrapped, symmetric and positive semi-definite.
fn assert_sound(name: &str, estimate: &Estimate) {
    let heading_rad = estimate.pose.heading.rad();
    assert!(heading_rad > -PI && heading_rad <= PI, "{name}: {heading_rad}");
    let numbers = [estimate.pose.x.0, estimate.pose.y.0, estimate.forward_speed.0, estimate.turn_rate.0];
    assert!(numbers.iter().all(|value| value.is_finite()), "{name}");
    let p = Matrix5::from_fn(|row, column| estimate.covariance[row][column]);
    assert!(p.iter().all(|value| value.is_finite()), "{name}: {p}");
    assert_eq!(p, p.transpose(), "{name}");
    // Scaled to correlations, so that the units of the rows do not decide what counts as zero.
    let scale = p.diagonal().map(|variance| 1.0 / variance.max(1e-12).sqrt());
    let correlations = Matrix5::from_diagonal(&scale) * p * Matrix5::from_diagonal(&scale);
    let lowest = correlations.symmetric_eigenvalues().min();
    assert!(lowest > -1e-7, "{name}: eigenvalue {lowest:e} of {p}");
}

fn cases() -> ProptestConfig {
    ProptestConfig {
        cases: 200,
        rng_seed: RngSeed::Fixed(20_260_102),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn whatever_comes_estimates_stay_sound(
        steps in prop::collection::vec(any_observation(), 1..120),
        has_start in any::<bool>(),
    ) {
        let config = if has_start { config() } else { without_start() };
        for_each(&config, |entry, mut filter| {
            let mut millis = 10_000;
            for (step_ms, observed) in &steps {
                millis += step_ms;
                let record = filter.observe(&at(millis, SensorId(7), *observed));
                assert!(record.nis >= 0.0 && record.log_likelihood.is_finite());
                let Some(latest) = filter.latest_time() else { continue };
                for ahead_ms in [-400, 0, 300, 100_000] {
                    if let Some(estimate) = filter.estimate_at(latest + TimeDelta::from_millis(ahead_ms)) {
                        assert_sound(entry.name, &estimate);
                    }
                }
            }
        });
    }

    #[test]
    fn a_turning_robot_keeps_its_heading_on_the_circle(turns in 1.0..9.0_f64, is_left in any::<bool>()) {
        let side = if is_left { 1.0 } else { -1.0 };
        for_each(&config(), |entry, mut filter| {
            let error_of = |filter: &dyn Filter, expected: f64| {
                (latest(filter).pose.heading - Heading::from_rad(expected)).0
            };
            let (mut expected, mut error_midway) = (0.0, 0.0);
            for k in 0..200_i64 {
                let turned = side * turns * k as f64 * 0.05;
                let rad = 0.5 * turned * TRACK_M / RADIUS_M;
                filter.observe(&gyro(k * 50, if k == 0 { 0.0 } else { side * turns }));
                filter.observe(&wheels(k * 50, -rad, rad));
                expected = turned;
                assert_sound(entry.name, &latest(filter.as_ref()));
                if k == 100 {
                    error_midway = error_of(filter.as_ref(), expected);
                }
            }
            let error = error_of(filter.as_ref(), expected);
            match entry.late_data {
                LateDataPolicy::Replayed => assert!(error.abs() < DEGREE, "{}: {error}", entry.name),
                // A filter of a paper begins at rest. What it misses until it believes the speed it may never make up for, but
                // it must not go on missing.
                LateDataPolicy::OnArrival => {
                    let since_midway = Heading::from_rad(error - error_midway).rad();
                    assert!(since_midway.abs() < DEGREE, "{}: {since_midway}", entry.name);
                }
            }
        });
    }
}
