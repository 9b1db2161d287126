//! Wheels and gyro of one instant leave the same belief whichever comes first, bit for bit and after every pair: also when a window closes,
//! when the gyro was silent, and when the tunables changed in between.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when the filter gives no estimate")]

#[path = "support/drive.rs"]
mod drive;
#[path = "support/robot.rs"]
mod robot;

use drive::{Camera, Scenario, drive, stamp};
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::state::CORE_STATES;
use posebridge_estimator::params::Params;
use posebridge_estimator::{Filter, FilterCommand};
use posebridge_telemetry::{FusionOutcome, Observation, ObservationKind, SensorId};
use robot::config;

/// Forty seconds of wheels, gyro and camera at the same instants; a list for each instant, in the order in which they are applied.
fn instants() -> Vec<Vec<Observation>> {
    let scenario = Scenario { laps: 1, camera: Some(Camera { every: 3, delay: 0, spread: 0, outliers: 0.1 }) };
    let drive = drive(&scenario, 5);
    let mut observations: Vec<Observation> = drive
        .arrivals
        .iter()
        .map(|arrival| arrival.observation)
        .filter(|observation| observation.stamp < stamp(800))
        .collect();
    // First the gyro, then the wheels.
    observations.sort_by_key(|told| (told.stamp, !is_gyro(told), !is_wheels(told)));
    let instants = observations.chunk_by(|one, next| one.stamp == next.stamp);
    instants.map(<[Observation]>::to_vec).collect()
}

const fn is_gyro(observation: &Observation) -> bool {
    matches!(observation.measurement, ObservationKind::TurnRate(_))
}

const fn is_wheels(observation: &Observation) -> bool {
    matches!(observation.measurement, ObservationKind::WheelAngles { .. })
}

fn belief(filter: &PoseFilter<CORE_STATES>) -> String {
    let latest = filter.latest_time().expect("something was observed");
    let estimate = filter.estimate_at(latest);
    assert!(estimate.is_some());
    format!("{:?} {estimate:?}", filter.state())
}

#[test]
fn a_gyro_behind_the_wheels_of_its_instant_is_as_one_before_them() {
    let mut in_order = PoseFilter::<CORE_STATES>::new(&config());
    let mut behind = PoseFilter::<CORE_STATES>::new(&config());
    for (index, instant) in instants().iter_mut().enumerate() {
        if (200..230).contains(&index) {
            instant.retain(|observation| observation.sensor != SensorId::GYRO);
        }
        for observation in instant.iter() {
            let record = in_order.observe(observation);
            assert_ne!(record.outcome, FusionOutcome::TooOld, "{observation:?}");
        }
        if let [gyro, wheels, ..] = instant.as_slice()
            && is_gyro(gyro)
            && is_wheels(wheels)
        {
            instant.swap(0, 1);
        }
        for observation in instant.iter() {
            behind.observe(observation);
        }
        assert!(belief(&behind) == belief(&in_order), "instant {index}");
    }
}

#[test]
fn what_is_told_behind_a_change_of_tunables_is_applied_by_the_new_ones() {
    let changed = Params { turn_acceleration_rad_per_s2: 9.0, acceleration_m_per_s2: 0.1, ..Params::default() };
    let changed = FilterCommand::SetParams(changed);
    let mut between = PoseFilter::<CORE_STATES>::new(&config());
    let mut before = PoseFilter::<CORE_STATES>::new(&config());
    let mut instants = instants().into_iter();
    for observation in instants.by_ref().take(101).flatten() {
        before.observe(&observation);
        between.observe(&observation);
    }
    let instant = instants.next().expect("there are eight hundred");
    let [gyro, wheels, ..] = instant.as_slice() else {
        panic!("{instant:?}");
    };
    assert_eq!(before.apply_command(&changed), FusionOutcome::Accepted);
    before.observe(gyro);
    before.observe(wheels);
    between.observe(wheels);
    assert_eq!(between.apply_command(&changed), FusionOutcome::Accepted);
    between.observe(gyro);
    assert_eq!(belief(&between), belief(&before));
}
