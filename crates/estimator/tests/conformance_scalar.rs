//! What every filter of one quantity must do: give it by `scalar_at`, give no pose, and stay untouched by what it refuses.

#[path = "support/robot.rs"]
mod robot;
#[path = "support/stamped.rs"]
mod stamped;

use posebridge_estimator::{EstimatedQuantity, FILTERS, Filter, FilterEntry, StartPose};
use posebridge_telemetry::{
    Celsius, FusionOutcome, Heading, Meters, MetersPerSecond, Observation, ObservationKind, Pose, RadiansPerSecond,
    SensorId, TimeDelta,
};
use robot::config;
use stamped::{at, gyro, ms, wheels};

const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e12];

fn for_each(check: impl Fn(&FilterEntry, Box<dyn Filter>)) {
    for entry in FILTERS {
        if entry.quantity == EstimatedQuantity::Scalar {
            check(entry, (entry.build)(&config()));
        }
    }
}

fn start(x_m: f64) -> StartPose {
    StartPose {
        pose: Pose::new(Meters(x_m), Meters(2.0), Heading::from_rad(0.5)),
        position_sigma_m: 0.02,
        heading_sigma_rad: 0.05,
    }
}

/// What a filter believes of the last seconds and of the next, in digits that tell any two numbers apart.
fn belief(filter: &dyn Filter) -> String {
    let latest = filter.latest_time();
    let believed: Vec<_> =
        (-20..=20).filter_map(|k| filter.scalar_at(latest? + TimeDelta::from_millis(k * 100))).collect();
    format!("{latest:?} {believed:?}")
}

/// Ranges to a wall and temperatures of a bath every 100 ms from 0 to `until_ms`, with the command of an approach.
fn measure_scalars(filter: &mut dyn Filter, until_ms: i64) {
    for millis in (0..=until_ms).step_by(100) {
        filter.observe(&approach(millis, 0.2));
        filter.observe(&range(millis, 3.0 - 0.2e-3 * millis as f64));
        filter.observe(&temperature(millis, 20.0));
    }
}

fn approach(millis: i64, forward_m_per_s: f64) -> Observation {
    let observed =
        ObservationKind::BodyVelocity { forward: MetersPerSecond(forward_m_per_s), turn: RadiansPerSecond(0.0) };
    at(millis, SensorId::ODOMETER, observed)
}

fn range(millis: i64, range_m: f64) -> Observation {
    at(millis, SensorId::RANGE, ObservationKind::WallRange(Meters(range_m)))
}

fn temperature(millis: i64, celsius: f64) -> Observation {
    let observed = ObservationKind::Temperature(Celsius(celsius));
    at(millis, SensorId::THERMOMETER, observed)
}

#[test]
fn a_filter_of_one_quantity_gives_it_and_no_pose() {
    for_each(|entry, mut filter| {
        assert!(filter.scalar_at(ms(0)).is_none(), "{}", entry.name);
        measure_scalars(filter.as_mut(), 5_000);
        assert!(filter.estimate_at(ms(5_000)).is_none(), "{}", entry.name);
        for millis in [3_000, 5_000, 5_100] {
            let found = filter.scalar_at(ms(millis)).expect("it was measured");
            let is_sound = found.value.is_finite() && found.sigma > 0.0 && found.sigma < 1.0;
            assert!(is_sound, "{}: {found:?}", entry.name);
            assert_eq!(found.stamp, ms(millis), "{}", entry.name);
        }
        assert!(filter.scalar_at(ms(1_000)).is_none(), "{}", entry.name);
        filter.restart_clock();
        assert!(filter.latest_time().is_none(), "{}", entry.name);
        assert!(filter.scalar_at(ms(5_000)).is_none(), "{}", entry.name);
    });
}

#[test]
fn what_a_filter_of_one_quantity_refuses_changes_nothing() {
    let bad = BAD.into_iter().flat_map(|bad| [range(5_010, bad), temperature(5_010, bad), approach(5_010, bad)]);
    let refused: Vec<_> = bad
        .chain([range(5_000, 2.0), temperature(5_000, 20.0), approach(5_000, 0.2)])
        .map(|observation| (observation, FusionOutcome::Malformed))
        .chain([
            (range(1_500, 2.7), FusionOutcome::TooOld),
            (temperature(4_950, 20.0), FusionOutcome::TooOld),
            (approach(1_500, 0.2), FusionOutcome::TooOld),
            (temperature(31_536_000_000, 20.0), FusionOutcome::Malformed),
            (wheels(5_010, 1.0, 1.0), FusionOutcome::Unused),
            (gyro(5_010, 0.1), FusionOutcome::Unused),
        ])
        .collect();
    for_each(|entry, mut filter| {
        measure_scalars(filter.as_mut(), 5_000);
        let before = belief(filter.as_ref());
        for (observation, expected) in &refused {
            let verdict = filter.observe(observation).outcome;
            let is_expected = verdict == *expected || verdict == FusionOutcome::Unused;
            assert!(is_expected, "{}: {observation:?} {verdict:?}", entry.name);
            assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
        }
        let verdict = filter.set_pose(&start(1.0));
        assert_eq!(verdict, FusionOutcome::Unused, "{}: it has none", entry.name);
        let verdict = filter.set_pose(&start(f64::NAN));
        assert_eq!(verdict, FusionOutcome::Malformed, "{}", entry.name);
        assert_eq!(belief(filter.as_ref()), before, "{}", entry.name);
    });
}
