//! What every filter of the table must refuse, and that what was refused leaves no trace.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when a filter gives no estimate")]

#[path = "support/conformance.rs"]
mod conformance;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/stamped.rs"]
mod stamped;

use conformance::{belief, drive_straight, fix, fix_of, for_each, latest, start};
use posebridge_estimator::{LateDataPolicy, StartPose};
use posebridge_telemetry::{
    Fix, FusionOutcome, Heading, Meters, MetersPerSecond, Observation, ObservationKind, Point2, Pose,
    PositionCovariance, RadiansPerSecond, SensorId, TimeDelta,
};
use robot::{RADIUS_M, config};
use stamped::{at, gyro, wheels};

fn malformed_fixes() -> Vec<Fix> {
    let good = fix_of(0.2, 0.1, 0.0);
    let with = |xx_m2, xy_m2, yy_m2, heading_rad2| Fix {
        covariance: Some(PositionCovariance { xx_m2, xy_m2, yy_m2, heading_rad2 }),
        ..good
    };
    let tag = |x_m, y_m| Fix { tag_in_body: Point2::new(Meters(x_m), Meters(y_m)), ..good };
    let mut fixes = vec![
        with(0.0, 0.0, 1e-4, 1e-4),
        with(1e-4, 0.0, -1e-4, 1e-4),
        with(1e-4, 2e-4, 1e-4, 1e-4),
        with(1e-4, 0.0, 1e-4, 0.0),
        with(1e-200, 0.0, 1e-200, 1e-4),
        with(1e-4, 0.0, 1e-4, f64::NAN),
        with(1e-4, 0.0, 1e-4, 1e300),
    ];
    for bad in BAD {
        fixes.extend([fix_of(bad, 0.0, 0.0), fix_of(0.0, bad, 0.0)]);
        fixes.extend([tag(bad, 0.0), tag(0.0, bad)]);
        fixes.extend([with(bad, 0.0, 1e-4, 1e-4), with(1e-4, bad, 1e-4, 1e-4), with(1e-4, 0.0, bad, 1e-4)]);
    }
    fixes.extend([f64::NAN, f64::INFINITY].map(|bad| fix_of(0.0, 0.0, bad)));
    fixes
}

const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e12];

#[test]
fn numbers_that_cannot_be_are_refused_and_change_nothing() {
    let mut observations: Vec<_> = malformed_fixes().into_iter().map(|bad| fix(1_000, bad)).collect();
    for bad in BAD {
        observations.extend([wheels(1_010, bad, 0.0), wheels(1_010, 0.0, bad)]);
        observations.push(gyro(1_010, bad));
        let forward = MetersPerSecond(bad);
        let turn = RadiansPerSecond(bad);
        for (forward, turn) in [(forward, RadiansPerSecond(0.0)), (MetersPerSecond(0.0), turn)] {
            let velocity = ObservationKind::BodyVelocity { forward, turn };
            observations.push(at(1_010, SensorId::ODOMETER, velocity));
        }
        let pose = Pose::new(Meters(bad), Meters(0.0), Heading::default());
        observations.push(at(1_010, SensorId::ODOMETER, ObservationKind::OdometerPose(pose)));
    }
    observations.push(Observation { stamp_sigma: TimeDelta::from_millis(-1), ..fix(1_000, fix_of(0.2, 0.0, 0.0)) });
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let before = belief(filter.as_ref());
        for observation in &observations {
            let verdict = filter.observe(observation).outcome;
            assert_eq!(verdict, FusionOutcome::Malformed, "{}: {observation:?}", entry.name);
            assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
        }
    });
}

#[test]
fn a_reading_that_comes_twice_counts_once() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let before = belief(filter.as_ref());
        // One that looks back no further than its last reading cannot tell a copy of an older one from a late one.
        let of_older: &[FusionOutcome] = match entry.late_data {
            LateDataPolicy::Replayed => &[FusionOutcome::Malformed],
            LateDataPolicy::OnArrival => &[FusionOutcome::Malformed, FusionOutcome::TooOld],
        };
        for (again, expected) in
            [(wheels(1_000, 99.0, 99.0), &[FusionOutcome::Malformed][..]), (wheels(950, 0.0, 0.0), of_older)]
        {
            let verdict = filter.observe(&again).outcome;
            assert!(expected.contains(&verdict), "{}: {verdict:?}", entry.name);
            assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
        }
    });
}

#[test]
fn a_fix_that_comes_twice_counts_once() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let seen = fix(990, fix_of(0.199, 0.001, 0.002));
        let first = filter.observe(&seen).outcome;
        assert!(matches!(first, FusionOutcome::Accepted | FusionOutcome::Unused), "{}: {first:?}", entry.name);
        let before = belief(filter.as_ref());
        let again = filter.observe(&seen).outcome;
        let expected = if first == FusionOutcome::Unused { FusionOutcome::Unused } else { FusionOutcome::Malformed };
        assert_eq!(again, expected, "{}", entry.name);
        assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
    });
}

/// A filter that replays takes it at its own time; one that uses what comes when it comes must refuse a counter's past, for
/// the interval since its last reading would be negative.
#[test]
fn a_reading_from_the_past_is_taken_at_its_own_time_and_the_latest_instant_stays() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let (before, latest_before) = (latest(filter.as_ref()), filter.latest_time());
        let believed_before = belief(filter.as_ref());
        let rad = 0.2 * 0.525 / RADIUS_M;
        let record = filter.observe(&wheels(525, rad, rad));
        match entry.late_data {
            LateDataPolicy::Replayed => assert_eq!(record.outcome, FusionOutcome::Accepted, "{}", entry.name),
            LateDataPolicy::OnArrival => {
                assert_eq!(record.outcome, FusionOutcome::TooOld, "{}", entry.name);
                assert_eq!(belief(filter.as_ref()), believed_before, "{}", entry.name);
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
        let before = belief(filter.as_ref());
        for (millis, expected) in [
            (6_999, FusionOutcome::TooOld),
            (-5_000_000, FusionOutcome::TooOld),
            (31_536_000_000, FusionOutcome::Malformed),
        ] {
            let verdict = filter.observe(&wheels(millis, 50.0, 50.0)).outcome;
            assert_eq!(verdict, expected, "{} at {millis} ms", entry.name);
            assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
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
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let before = belief(filter.as_ref());
        for start in &bad {
            let verdict = filter.set_pose(start);
            assert_eq!(verdict, FusionOutcome::Malformed, "{}: {start:?}", entry.name);
            assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
        }
    });
}

#[test]
fn a_fix_that_does_not_fit_leaves_the_estimate_untouched() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 2_000);
        let before = belief(filter.as_ref());
        let position_only = Fix { heading: None, ..fix_of(0.9, 0.2, 0.0) };
        for seen in [fix_of(0.4, 0.5, 0.0), fix_of(0.4, 0.0, 1.0), position_only] {
            let verdict = filter.observe(&fix(1_990, seen)).outcome;
            assert!(matches!(verdict, FusionOutcome::Gated | FusionOutcome::Unused), "{}: {verdict:?}", entry.name);
            assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
        }
    });
}
