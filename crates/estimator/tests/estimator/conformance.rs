//! What every filter of the table must do, whatever it makes of its observations, and what it must refuse without a trace.

use std::f64::consts::PI;

use nalgebra::DMatrix;
use posebridge_estimator::{EstimatedQuantity, FILTERS, Filter, FilterEntry, Initialization, LateDataPolicy};
use posebridge_telemetry::{
    Celsius, Estimate, Fix, FusionOutcome, Heading, Meters, MetersPerSecond, Observation, ObservationKind,
    PositionCovariance, RadiansPerSecond, SensorId, StartPose, TimeDelta, Timestamp,
};
use proptest::prelude::*;

use crate::support::any::{any_observation, cases, damages, of, one_of_each, without_learning};
use crate::support::filters::{drive_straight, for_each, latest, start, state_text, without_start};
use crate::support::observe::{accelerations, at, fix, fix_of, gyro, ms, wheels};
use crate::support::robot::{DEGREE, RADIUS_M, TRACK_M, config};
use crate::support::score::assert_positive;

/// An observation must be refused for one of these reasons, without a trace.
fn assert_refused(entry: &FilterEntry, filter: &mut dyn Filter, observation: &Observation, reasons: &[FusionOutcome]) {
    let before = state_text(filter);
    let outcome = filter.observe(observation).outcome;
    assert!(reasons.contains(&outcome), "{}: {outcome:?} {observation:?}", entry.name);
    assert_eq!(state_text(filter), before, "{}: {observation:?}", entry.name);
}

#[test]
fn before_the_first_observation_there_is_no_estimate() {
    for entry in FILTERS {
        let filter = (entry.build)(&config());
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        assert!(filter.estimate_at(ms(0)).is_none() && filter.scalar_at(ms(0)).is_none(), "{}", entry.name);
    }
}

#[test]
fn nothing_is_valid_before_a_fix_or_a_start_and_a_pose_that_is_set_is_a_start() {
    for_each(&without_start(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        let unknown = latest(filter.as_ref());
        assert!(!unknown.validity.position && !unknown.validity.heading, "{}", entry.name);
        assert!(unknown.validity.speeds, "{}", entry.name);
        assert!(unknown.is_dead_reckoning && unknown.fix_age.is_none());
        let _ = filter.set_pose(&start(1.0, 2.0, 0.5));
        let started = latest(filter.as_ref());
        assert!(started.validity.position && started.validity.heading, "{}", entry.name);
        assert!(started.is_dead_reckoning, "{}: a start is no fix", entry.name);
    });
}

#[test]
fn a_fix_initializes_the_filters_that_support_it_and_no_others() {
    for_each(&without_start(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        for millis in (2_050..=4_000).step_by(50) {
            filter.observe(&fix(millis, fix_of(1.0, 2.0, 0.0)));
            let rad = 0.4 / RADIUS_M;
            filter.observe(&gyro(millis, 0.0));
            filter.observe(&wheels(millis, rad, rad));
        }
        let has_pose = latest(filter.as_ref()).validity.position;
        assert_eq!(has_pose, entry.initialization == Initialization::Fix, "{}", entry.name);
    });
}

#[test]
fn a_pose_that_is_set_is_used_and_counted_with_its_jump() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        // A fix of the very same instant precedes the set pose.
        filter.observe(&fix(2_000, fix_of(0.4, 0.0, 0.0)));
        let before = latest(filter.as_ref());
        // Set with so large a sigma that the fix would pass the gate if it were applied last.
        let vague = StartPose { position_sigma_m: 3.0, heading_sigma_rad: 3.0, ..start(-1.0, 2.0, -3.0) };
        assert_eq!(filter.set_pose(&vague), FusionOutcome::PoseReset, "{}", entry.name);
        let after = latest(filter.as_ref());
        let pose = [after.pose.x.0, after.pose.y.0, after.pose.heading.rad()];
        assert_eq!(pose, [-1.0, 2.0, -3.0], "{}", entry.name);
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
        let drive_and_set_pose = |filter: &mut dyn Filter| {
            drive_straight(filter, 1_000);
            let _ = filter.set_pose(&start(5.0, 5.0, 0.0));
        };
        drive_and_set_pose(filter.as_mut());
        let mut reference = (entry.build)(&config());
        drive_and_set_pose(reference.as_mut());
        filter.observe(&wheels(975, 0.25 / RADIUS_M, 0.1 / RADIUS_M));
        assert_eq!(filter.latest_time(), Some(ms(1_000)), "{}", entry.name);
        let rad = 0.21 / RADIUS_M;
        filter.observe(&wheels(1_050, rad, rad));
        reference.observe(&wheels(1_050, rad, rad));
        let x_m = latest(filter.as_ref()).pose.x.0;
        match entry.late_data {
            LateDataPolicy::Replayed => assert!((x_m - 5.01).abs() < 1e-6, "{}: {x_m}", entry.name),
            // These smooth the counters, so the path after the jump is theirs; the past must not change it at all.
            LateDataPolicy::OnArrival => {
                assert_eq!(state_text(filter.as_ref()), state_text(reference.as_ref()));
                assert!((x_m - 5.01).abs() < 1e-3, "{}: {x_m}", entry.name);
            }
        }
    });
}

#[test]
fn a_restart_of_the_bricks_clock_keeps_the_pose_with_more_uncertainty_and_no_speed() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 5_000);
        let before = latest(filter.as_ref());
        assert!(before.forward_speed.0 > 0.15);
        filter.restart_clock();
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        assert!(filter.estimate_at(ms(5_000)).is_none(), "{}", entry.name);
        let record = filter.observe(&wheels(30, 0.0, 0.0));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{}", entry.name);
        let after = latest(filter.as_ref());
        assert_eq!((after.pose, after.forward_speed.0), (before.pose, 0.0), "{}", entry.name);
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

/// A filter that corrects nothing afterwards must give the same estimate of the past as then: it may have begun with too slow a robot,
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
                let expected = then.estimate_at(ms(millis)).expect("just observed");
                assert_eq!(estimate.pose, expected.pose, "{} at {millis}", entry.name);
                assert_eq!(estimate.covariance, expected.covariance, "{}", entry.name);
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
            let is_less_sure = ahead.heading_sigma_rad() >= now.heading_sigma_rad() * (1.0 - 1e-9);
            assert!(is_less_sure, "{} at {millis} ms", entry.name);
            assert_eq!(ahead.validity.speeds, millis <= 2_500, "{}: speeds grow stale", entry.name);
        }
    });
}

#[test]
fn numbers_that_cannot_be_are_refused_and_change_nothing() {
    let kinds = one_of_each();
    let mut refused: Vec<Observation> = kinds.iter().flat_map(|kind| damages(&of(1_010, SensorId(7), *kind))).collect();
    refused.extend([f64::NAN, f64::INFINITY].map(|bad| fix(1_010, fix_of(0.0, 0.0, bad))));
    let names: std::collections::BTreeSet<_> =
        refused.iter().map(|observation| observation.measurement.kind()).collect();
    assert_eq!(names.len(), 11, "every kind is damaged");
    for entry in FILTERS {
        let mut filter = (entry.build)(&without_learning());
        for observation in &refused {
            assert_eq!(
                filter.observe(observation).outcome,
                FusionOutcome::Malformed,
                "{}: {observation:?}",
                entry.name
            );
        }
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        drive_straight(filter.as_mut(), 1_000);
        measure_scalars(filter.as_mut(), 1_000);
        for observation in &refused {
            assert_refused(entry, filter.as_mut(), observation, &[FusionOutcome::Malformed]);
        }
    }
}

#[test]
fn a_reading_that_comes_twice_or_too_late_counts_once() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        filter.observe(&accelerations(1_000, 0.1, 0.2));
        // One that remembers only its last reading cannot distinguish a copy of an older one from a late one.
        let of_older: &[FusionOutcome] = match entry.late_data {
            LateDataPolicy::Replayed => &[FusionOutcome::Malformed, FusionOutcome::Unused],
            LateDataPolicy::OnArrival => &[FusionOutcome::Malformed, FusionOutcome::TooOld, FusionOutcome::Unused],
        };
        // Odometry has no use for a gyro; every filter with one counts it once.
        let of_same = &[FusionOutcome::Malformed, FusionOutcome::Unused][..];
        for (again, expected) in [
            (wheels(1_000, 99.0, 99.0), &of_same[..1]),
            (gyro(1_000, 2.0), of_same),
            (accelerations(1_000, 9.0, 9.0), of_same),
            (wheels(950, 0.0, 0.0), of_older),
            (gyro(950, 2.0), of_older),
        ] {
            assert_refused(entry, filter.as_mut(), &again, expected);
        }
    });
}

#[test]
fn a_fix_that_comes_twice_counts_once() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let repeated = fix(990, fix_of(0.199, 0.001, 0.002));
        let first = filter.observe(&repeated).outcome;
        assert!(matches!(first, FusionOutcome::Accepted | FusionOutcome::Unused), "{}: {first:?}", entry.name);
        let expected = if first == FusionOutcome::Unused { FusionOutcome::Unused } else { FusionOutcome::Malformed };
        assert_refused(entry, filter.as_mut(), &repeated, &[expected]);
    });
}

/// A filter that replays takes it at its own time; one that uses what comes when it comes must refuse a counter's past, for
/// the interval since its last reading would be negative.
#[test]
fn a_reading_from_the_past_is_taken_at_its_own_time_and_the_latest_instant_stays() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let (before, latest_before) = (latest(filter.as_ref()), filter.latest_time());
        let state_before = state_text(filter.as_ref());
        let rad = 0.2 * 0.525 / RADIUS_M;
        let record = filter.observe(&wheels(525, rad, rad));
        match entry.late_data {
            LateDataPolicy::Replayed => assert_eq!(record.outcome, FusionOutcome::Accepted, "{}", entry.name),
            LateDataPolicy::OnArrival => {
                assert_eq!(record.outcome, FusionOutcome::TooOld, "{}", entry.name);
                assert_eq!(state_text(filter.as_ref()), state_before, "{}", entry.name);
            }
        }
        assert_eq!(record.lag, TimeDelta::from_millis(475), "{}", entry.name);
        assert_eq!(filter.latest_time(), latest_before, "{}", entry.name);
        let moved_m = latest(filter.as_ref()).pose.x.0 - before.pose.x.0;
        assert!(moved_m.abs() < 1e-9, "{}: {moved_m}", entry.name);
    });
}

#[test]
fn a_stamp_of_long_ago_or_of_next_year_is_refused_and_changes_nothing() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 10_000);
        for (millis, expected) in [
            (6_999, FusionOutcome::TooOld),
            (-5_000_000, FusionOutcome::TooOld),
            (31_536_000_000, FusionOutcome::Malformed),
        ] {
            assert_refused(entry, filter.as_mut(), &wheels(millis, 50.0, 50.0), &[expected]);
        }
    });
}

#[test]
fn a_pose_that_cannot_be_is_not_set() {
    let good = start(1.0, 1.0, 0.0);
    let bad = [
        start(f64::NAN, 0.0, 0.0),
        start(0.0, f64::INFINITY, 0.0),
        start(0.0, 0.0, f64::NAN),
        StartPose { position_sigma_m: -0.1, ..good },
        StartPose { heading_sigma_rad: f64::NAN, ..good },
    ];
    for entry in FILTERS {
        let mut filter = (entry.build)(&config());
        drive_straight(filter.as_mut(), 1_000);
        let before = state_text(filter.as_ref());
        for start in &bad {
            assert_eq!(filter.set_pose(start), FusionOutcome::Malformed, "{}: {start:?}", entry.name);
            assert_eq!(state_text(filter.as_ref()), before, "{}", entry.name);
        }
    }
}

#[test]
fn a_fix_that_does_not_fit_leaves_the_estimate_untouched() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        let position_only = Fix { heading: None, ..fix_of(0.9, 0.2, 0.0) };
        for measured in [fix_of(0.4, 0.5, 0.0), fix_of(0.4, 0.0, 1.0), position_only] {
            let expected = [FusionOutcome::Gated, FusionOutcome::Unused];
            assert_refused(entry, filter.as_mut(), &fix(1_990, measured), &expected);
        }
    });
}

/// Finite, wrapped, symmetric and positive semi-definite.
fn assert_sound(name: &str, estimate: &Estimate) {
    let heading_rad = estimate.pose.heading.rad();
    assert!(heading_rad > -PI && heading_rad <= PI, "{name}: {heading_rad}");
    let numbers = [estimate.pose.x.0, estimate.pose.y.0, estimate.forward_speed.0, estimate.turn_rate.0];
    assert!(numbers.iter().all(|value| value.is_finite()), "{name}");
    assert_positive(name, &DMatrix::from_fn(5, 5, |row, column| estimate.covariance[row][column]), 1e-7);
}

proptest! {
    #![proptest_config(cases(200, 20_260_102))]

    #[test]
    fn for_any_input_estimates_stay_sound(
        steps in prop::collection::vec(any_observation(), 1..120),
        has_start in any::<bool>(),
    ) {
        let mut config = without_learning();
        config.start = config.start.filter(|_| has_start);
        for_each(&config, |entry, mut filter| {
            let mut millis = 10_000;
            for (step_ms, sensor, measurement) in &steps {
                millis += step_ms;
                let record = filter.observe(&of(millis, *sensor, measurement.0));
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
                // A filter of a paper begins at rest. What it misses until its speed has converged it may never make up for, but
                // it must not go on missing.
                LateDataPolicy::OnArrival => {
                    let since_midway = Heading::from_rad(error - error_midway).rad();
                    assert!(since_midway.abs() < DEGREE, "{}: {since_midway}", entry.name);
                }
            }
        });
    }
}

fn approach(millis: i64, forward_m_per_s: f64) -> Observation {
    let (forward, turn) = (MetersPerSecond(forward_m_per_s), RadiansPerSecond(0.0));
    at(millis, SensorId::ODOMETER, ObservationKind::BodyVelocity { forward, turn })
}

fn range(millis: i64, range_m: f64) -> Observation {
    at(millis, SensorId::RANGE, ObservationKind::WallRange(Meters(range_m)))
}

fn temperature(millis: i64, celsius: f64) -> Observation {
    at(millis, SensorId::THERMOMETER, ObservationKind::Temperature(Celsius(celsius)))
}

/// Ranges to a wall and temperatures of a bath every 100 ms from 0 to `until_ms`, with the command of an approach.
fn measure_scalars(filter: &mut dyn Filter, until_ms: i64) {
    for millis in (0..=until_ms).step_by(100) {
        filter.observe(&approach(millis, 0.2));
        filter.observe(&range(millis, 3.0 - 0.2e-3 * millis as f64));
        filter.observe(&temperature(millis, 20.0));
    }
}

fn for_each_scalar(check: impl Fn(&FilterEntry, Box<dyn Filter>)) {
    for entry in FILTERS.iter().filter(|entry| entry.quantity != EstimatedQuantity::Pose) {
        let mut filter = (entry.build)(&config());
        measure_scalars(filter.as_mut(), 5_000);
        check(entry, filter);
    }
}

#[test]
fn a_filter_of_one_quantity_estimates_it_and_no_pose() {
    for_each_scalar(|entry, mut filter| {
        assert!(filter.estimate_at(ms(5_000)).is_none(), "{}", entry.name);
        for millis in [3_000, 5_000, 5_100] {
            let found = filter.scalar_at(ms(millis)).expect("it was measured");
            let is_sound = found.value.is_finite() && found.sigma > 0.0 && found.sigma < 1.0;
            assert!(is_sound && found.stamp == ms(millis), "{}: {found:?}", entry.name);
        }
        assert!(filter.scalar_at(ms(1_000)).is_none(), "{}", entry.name);
        filter.restart_clock();
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        assert!(filter.scalar_at(ms(5_000)).is_none(), "{}", entry.name);
    });
}

#[test]
fn what_a_filter_of_one_quantity_refuses_changes_nothing() {
    let refused = [
        (range(5_000, 2.0), FusionOutcome::Malformed),
        (temperature(5_000, 20.0), FusionOutcome::Malformed),
        (approach(5_000, 0.2), FusionOutcome::Malformed),
        (range(1_500, 2.7), FusionOutcome::TooOld),
        (temperature(4_950, 20.0), FusionOutcome::TooOld),
        (approach(1_500, 0.2), FusionOutcome::TooOld),
        (temperature(31_536_000_000, 20.0), FusionOutcome::Malformed),
        (wheels(5_010, 1.0, 1.0), FusionOutcome::Unused),
        (gyro(5_010, 0.1), FusionOutcome::Unused),
    ];
    for_each_scalar(|entry, mut filter| {
        for (observation, expected) in &refused {
            assert_refused(entry, filter.as_mut(), observation, &[*expected, FusionOutcome::Unused]);
        }
        let before = state_text(filter.as_ref());
        assert_eq!(filter.set_pose(&start(1.0, 2.0, 0.5)), FusionOutcome::Unused, "{}: it has none", entry.name);
        assert_eq!(state_text(filter.as_ref()), before, "{}", entry.name);
    });
}

/// Finite numbers within and beyond what a filter takes.
fn hostile() -> impl Strategy<Value = f64> {
    prop::sample::select(&[0.0, 1e-300, 1e-9, 1.0, 1e4, 1e9, -1e9, 1e18, 1e150, -1e300, f64::MAX][..])
}

fn any_hostile() -> impl Strategy<Value = ObservationKind> {
    let covariance = (hostile(), hostile(), hostile()).prop_map(|(variance, share, heading_rad2)| PositionCovariance {
        xx_m2: variance,
        xy_m2: share,
        yy_m2: variance,
        heading_rad2,
    });
    let fix = (hostile(), hostile(), prop::option::of(covariance))
        .prop_map(|(x, y, covariance)| ObservationKind::Fix(Fix { covariance, ..fix_of(x, y, x) }));
    let others = (hostile(), hostile(), 0..10_usize).prop_map(|(one, other, kind)| {
        let mut measurement = one_of_each()[kind];
        match &mut measurement {
            ObservationKind::WheelAngles { left, right } => (left.0, right.0) = (one, other),
            ObservationKind::OdometerPose(pose) => (pose.x.0, pose.y.0) = (one, other),
            ObservationKind::BodyVelocity { forward, turn } => (forward.0, turn.0) = (one, other),
            ObservationKind::TurnRate(rate) => rate.0 = one,
            ObservationKind::WheelAccelerations { left, right } => (left.0, right.0) = (one, other),
            ObservationKind::Fix(fix) => (fix.position.x.0, fix.position.y.0) = (one, other),
            ObservationKind::Landmark { range, bearing, .. } => (range.0, bearing.0) = (one, other),
            ObservationKind::BeaconRange { range, .. } | ObservationKind::WallRange(range) => range.0 = one,
            ObservationKind::CompassHeading(heading) => *heading = Heading::from_rad(one),
            ObservationKind::Temperature(shown) => shown.0 = one,
        }
        measurement
    });
    prop_oneof![1 => fix, 2 => others]
}

proptest! {
    #![proptest_config(cases(60, 20_261_129))]

    #[test]
    fn no_number_however_large_makes_an_estimate_valid_that_is_not_finite(
        steps in prop::collection::vec((prop::sample::select(&[1_i64, 1_000, 50_000_000, 3_599_000_000_000][..]), any_hostile()), 1..40),
        has_start in any::<bool>(),
    ) {
        let config = if has_start { without_learning() } else { without_start() };
        for entry in FILTERS {
            let mut filter = (entry.build)(&config);
            let mut stamp = Timestamp::ZERO;
            for (step_nanos, measurement) in &steps {
                stamp = stamp + TimeDelta::from_nanos(*step_nanos);
                filter.observe(&Observation { stamp, ..of(0, SensorId::WHEELS, *measurement) });
                for ahead in [TimeDelta::ZERO, TimeDelta::from_millis(1_000)] {
                    let Some(estimate) = filter.estimate_at(stamp + ahead) else { continue };
                    let validity = estimate.validity;
                    let is_valid = validity.position || validity.heading || validity.speeds;
                    prop_assert!(estimate.is_finite() || !is_valid, "{}: {estimate:?}", entry.name);
                }
            }
        }
    }
}
