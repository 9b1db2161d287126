//! What the flagship believes does not depend on the order in which observations arrive, bit for bit.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when the filter gives no estimate")]

#[path = "support/drive.rs"]
mod drive;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/simulated_sensors.rs"]
mod simulated_sensors;
#[path = "support/unknown.rs"]
mod unknown;

use drive::{Camera, Scenario, drive, stamp};
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::state::{CAMERA_STATES, CORE_STATES, RANGE_STATES};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    BrickClock, Fix, FusionOutcome, Meters, Observation, ObservationKind, PositionCovariance, Radians, SensorId,
    TimeDelta, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use robot::config;
use simulated_sensors::{SimulatedSensors, add, furnished, step_between};
use unknown::all_unknown;

/// The history of 3 s: every delay is shorter by a millisecond at least.
const LATEST_BY_MS: i64 = 3_000;

fn scenario() -> Scenario {
    Scenario { laps: 1, camera: Some(Camera { every: 2, delay: 0, spread: 0, outliers: 0.1 }) }
}

/// Forty seconds of driving with a turn, in the order of time: fixes of which some are outliers, wheels and gyro at the same
/// instants as the fixes.
fn observations(seed: u64) -> Vec<Observation> {
    let drive = drive(&scenario(), seed);
    let observations =
        drive.arrivals.iter().map(|arrival| arrival.observation).filter(|observation| observation.stamp < stamp(800));
    observations.collect()
}

/// The observations as a link with random delays delivers them.
fn shuffled(observations: &[Observation], seed: u64) -> Vec<Observation> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut arrivals: Vec<(Timestamp<BrickClock>, Observation)> = observations
        .iter()
        .map(|observation| {
            let delay = TimeDelta::from_millis(rng.random_range(0..LATEST_BY_MS));
            (observation.stamp + delay, *observation)
        })
        .collect();
    arrivals.sort_by_key(|arrival| arrival.0);
    arrivals.into_iter().map(|(_, observation)| observation).collect()
}

/// Everything that a filter believes at the end, in digits that tell any two numbers apart.
fn belief(config: &FilterConfig, observations: &[Observation]) -> String {
    belief_with::<CORE_STATES>(config, observations)
}

fn belief_with<const N: usize>(config: &FilterConfig, observations: &[Observation]) -> String {
    let mut filter = PoseFilter::<N>::new(config);
    for observation in observations {
        let record = filter.observe(observation);
        assert_ne!(record.outcome, FusionOutcome::TooOld, "{observation:?}");
    }
    let latest = filter.latest_time().expect("something was observed");
    let lately: Vec<_> = (-58..=10).map(|k| filter.estimate_at(latest + TimeDelta::from_millis(k * 50))).collect();
    assert!(lately.iter().all(Option::is_some));
    format!("{:?} {lately:?} {:?}", filter.state(), filter.calibration())
}

fn assert_order_does_not_matter(config: &FilterConfig, observations: &[Observation]) {
    assert_order_does_not_matter_with::<CORE_STATES>(config, observations);
}

fn assert_order_does_not_matter_with<const N: usize>(config: &FilterConfig, observations: &[Observation]) {
    let expected = belief_with::<N>(config, observations);
    for seed in 0..6 {
        assert!(
            belief_with::<N>(config, &shuffled(observations, seed)) == expected,
            "another belief with the order of seed {seed}"
        );
    }
}

fn shift(observations: &mut [Observation], sensor: SensorId, by: TimeDelta) {
    for observation in observations {
        if observation.sensor == sensor {
            observation.stamp = observation.stamp + by;
        }
    }
}

#[test]
fn in_order_the_robot_ends_where_the_truth_is() {
    let observations = observations(1);
    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    for observation in &observations {
        filter.observe(observation);
    }
    let (x_m, y_m, _) = drive(&scenario(), 1).poses[798];
    let found = filter.estimate_at(stamp(799)).expect("something was observed");
    let error_m = (found.pose.x.0 - x_m).hypot(found.pose.y.0 - y_m);
    assert!(error_m < 0.01, "{error_m}");
}

#[test]
fn the_order_of_arrival_does_not_matter_when_all_sensors_share_their_instants() {
    for seed in [1, 2] {
        assert_order_does_not_matter(&config(), &observations(seed));
    }
}

#[test]
fn the_order_of_arrival_does_not_matter_when_every_sensor_has_instants_of_its_own() {
    let mut observations = observations(3);
    shift(&mut observations, SensorId::GYRO, TimeDelta::from_micros(13_337));
    shift(&mut observations, SensorId::CAMERA, TimeDelta::from_micros(-21_123));
    observations.sort_by_key(|observation| observation.stamp);
    assert_order_does_not_matter(&config(), &observations);
}

#[test]
fn the_order_of_arrival_does_not_matter_while_the_heading_is_still_to_be_found() {
    let mut observations = observations(4);
    for observation in &mut observations {
        if let ObservationKind::Fix(fix) = observation.measurement {
            observation.measurement = ObservationKind::Fix(Fix { heading: None, ..fix });
        }
    }
    let mut config = config();
    config.start = None;
    assert_order_does_not_matter(&config, &observations);
}

#[test]
fn the_order_of_arrival_does_not_matter_across_holes_and_jumps_of_the_counters() {
    let mut observations = observations(5);
    // No gyro for two seconds, no wheels for one, and then counters that begin again; at the end no gyro but for the last two.
    observations.retain(|observation| match observation.sensor {
        SensorId::GYRO => {
            !(stamp(200)..stamp(240)).contains(&observation.stamp)
                && !(stamp(770)..stamp(798)).contains(&observation.stamp)
        }
        SensorId::WHEELS => !(stamp(300)..stamp(320)).contains(&observation.stamp),
        _ => true,
    });
    for observation in &mut observations {
        let is_after_the_jump = observation.stamp >= stamp(500);
        if let ObservationKind::WheelAngles { left, right } = observation.measurement
            && is_after_the_jump
        {
            observation.measurement =
                ObservationKind::WheelAngles { left: left - Radians(400.0), right: right + Radians(300.0) };
        }
    }
    assert_order_does_not_matter(&config(), &observations);
}

/// What came before the last fix, and that.
fn until_a_fix(mut observations: Vec<Observation>) -> (Vec<Observation>, Observation) {
    loop {
        let last = observations.pop().expect("the camera looked");
        if last.sensor == SensorId::CAMERA {
            return (observations, last);
        }
    }
}

#[test]
fn two_fixes_of_one_instant_count_in_either_order_and_one_that_comes_twice_counts_once() {
    let (before, one) = until_a_fix(observations(6));
    let two = moved_by(&one, 0.001);
    let together = |pair: [Observation; 2]| belief(&config(), &[before.clone(), pair.to_vec()].concat());
    assert!(together([one, two]) == together([two, one]));
    assert!(together([one, two]) != belief(&config(), &[before.clone(), vec![one]].concat()));

    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    for observation in before.iter().chain([&one]) {
        filter.observe(observation);
    }
    let once = format!("{:?}", filter.state());
    assert_eq!(filter.observe(&one).outcome, FusionOutcome::Malformed);
    assert_eq!(format!("{:?}", filter.state()), once);
}

/// The same fix, seen a little further east.
fn moved_by(seen: &Observation, east_m: f64) -> Observation {
    let ObservationKind::Fix(mut fix) = seen.measurement else {
        return *seen;
    };
    fix.position.x += Meters(east_m);
    Observation { measurement: ObservationKind::Fix(fix), ..*seen }
}

#[test]
fn a_late_fix_does_what_the_same_fix_does_in_time() {
    let in_time = observations(7);
    let mut late = in_time.clone();
    let index = late
        .iter()
        .position(|observation| observation.sensor == SensorId::CAMERA && observation.stamp == stamp(750))
        .expect("the camera looks at every second step");
    let fix = late.remove(index);
    late.push(fix);
    assert!(stamp(799) - fix.stamp > TimeDelta::from_millis(2_000), "it is late");
    assert!(belief(&config(), &in_time) == belief(&config(), &late));
    late.pop();
    assert!(belief(&config(), &in_time) != belief(&config(), &late));
}

#[test]
fn an_observation_older_than_the_history_is_refused_and_changes_nothing() {
    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    let observations = observations(8);
    for observation in &observations {
        filter.observe(observation);
    }
    let latest = filter.latest_time().expect("something was observed");
    let before = format!("{:?} {:?}", filter.state(), filter.estimate_at(latest));
    for kind in [SensorId::CAMERA, SensorId::WHEELS, SensorId::GYRO] {
        let mut old = *observations.iter().find(|observation| observation.sensor == kind).expect("every sensor spoke");
        old.stamp = latest - TimeDelta::from_millis(3_001);
        let record = filter.observe(&old);
        assert_eq!(record.outcome, FusionOutcome::TooOld);
        assert_eq!(record.outcome.reason(), "too old");
        assert_eq!(record.lag, TimeDelta::from_millis(3_001));
    }
    assert_eq!(format!("{:?} {:?}", filter.state(), filter.estimate_at(latest)), before);
}

/// Twenty seconds with every sensor there is, round a corner, some of them at the same instants.
fn with_everything(config: &FilterConfig, seed: u64) -> Vec<Observation> {
    let mut drive = drive(&scenario(), seed);
    let mut senses = SimulatedSensors::new(config, seed);
    let poses = drive.poses.clone();
    let errors = [(0.2, 0.01), (0.0, 0.0), (-0.1, 0.02), (0.3, -0.01)];
    add(&mut drive, SensorId::LANDMARKS, 5, |_, truth| senses.landmarks(truth));
    add(&mut drive, SensorId::BEACONS, 4, |_, truth| senses.beacons(truth, &errors));
    add(&mut drive, SensorId::RANGE, 3, |_, truth| senses.wall(truth));
    // Iron near the compass, now and then.
    add(&mut drive, SensorId::COMPASS, 2, |step, (x, y, heading)| {
        let off_rad = if step % 200 < 30 { 1.2 } else { 0.0 };
        senses.compass((x, y, heading + off_rad))
    });
    add(&mut drive, SensorId::ACCELEROMETER, 1, |step, _| {
        let Some(first) = step.checked_sub(3) else {
            return vec![];
        };
        let steps = [0, 1].map(|k| step_between(poses[first + k], poses[first + k + 1]));
        senses.accelerations(steps)
    });
    let observations = drive.arrivals.iter().map(|arrival| arrival.observation);
    observations.filter(|observation| observation.stamp < stamp(420)).collect()
}

/// A configuration that asks for every state there is.
fn learning_everything() -> FilterConfig {
    FilterConfig { calibration: all_unknown(), ..furnished(&config()) }
}

#[test]
fn the_order_of_arrival_does_not_matter_with_every_sensor_and_every_state() {
    let config = learning_everything();
    let observations = with_everything(&config, 11);
    assert_order_does_not_matter_with::<RANGE_STATES>(&config, &observations);
    let kinds = ["landmark", "beacon_range", "wall_range", "compass_heading"];
    let mut filter = PoseFilter::<RANGE_STATES>::new(&config);
    let records: Vec<_> = observations.iter().map(|o| filter.observe(o)).collect();
    for kind in kinds {
        let of_kind = records.iter().filter(|record| record.kind == kind);
        let used = of_kind.filter(|record| record.outcome == FusionOutcome::Accepted);
        assert!(used.count() > 50, "{kind} is used");
    }
    let gated = records.iter().filter(|r| r.outcome == FusionOutcome::Gated);
    assert!(gated.count() > 20, "and some are not");
}

#[test]
fn the_order_of_arrival_does_not_matter_with_students_t() {
    let mut config = learning_everything();
    config.params.student_dof = 4.0;
    let observations = with_everything(&config, 13);
    assert_order_does_not_matter_with::<RANGE_STATES>(&config, &observations);
}

#[test]
fn the_order_of_arrival_does_not_matter_with_a_camera_whose_delay_is_learned() {
    let mut config = learning_everything();
    config.arena_map = std::sync::Arc::default();
    // A quarter of the camera's noise, so that the gate refuses and the scale learns.
    config.noise.fix_position_m *= 0.25;
    for late in [TimeDelta::from_millis(150), TimeDelta::from_micros(-83_210)] {
        let mut observations = observations(14);
        shift(&mut observations, SensorId::CAMERA, late);
        observations.sort_by_key(|observation| observation.stamp);
        assert_order_does_not_matter_with::<CAMERA_STATES>(&config, &observations);
    }
}

#[test]
fn two_fixes_of_one_instant_and_place_that_claim_other_noise_count_in_either_order() {
    let (before, one) = until_a_fix(observations(6));
    let claims = |variance: f64| {
        let ObservationKind::Fix(mut fix) = one.measurement else {
            return one;
        };
        fix.covariance =
            Some(PositionCovariance { xx_m2: variance, xy_m2: 0.0, yy_m2: variance, heading_rad2: variance });
        Observation { measurement: ObservationKind::Fix(fix), ..one }
    };
    let together = |pair: [Observation; 2]| belief(&config(), &[before.clone(), pair.to_vec()].concat());
    let pair = [claims(1e-4), claims(4e-6)];
    assert!(together(pair) == together([pair[1], pair[0]]));
}
