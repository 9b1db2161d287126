//! The flagship's state does not depend on the order in which observations arrive, bit for bit.

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::{CORE_STATES, LARGE_STATES, SMALL_STATES};
use posebridge_estimator::{Filter, FilterCommand, FilterConfig, Params};
use posebridge_telemetry::{
    BrickClock, FusionOutcome, Observation, ObservationKind, PositionCovariance, Radians, SensorId, TimeDelta,
    Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::support::any::learning_everything;
use crate::support::filters::{drive_straight, latest, without_start};
use crate::support::observe::{each_fix, gyro, wheels};
use crate::support::robot::config;
use crate::support::simulation::{Camera, SimulatedSensors, add, add_accelerometers, drive_lap, stamp};

/// The history of 3 s: every delay is shorter by a millisecond at least.
const LATEST_BY_MS: i64 = 3_000;
/// Forty seconds of driving with a turn.
const STEPS: usize = 800;
const CAMERA: Camera = Camera { every: 2, delay: 0, spread: 0, outliers: 0.1 };

/// In the order of time: fixes of which some are outliers, wheels and gyro at the same instants as the fixes.
fn observations(seed: u64) -> Vec<Observation> {
    let mut observations = drive_lap(Some(CAMERA), seed).observations();
    observations.retain(|observation| observation.stamp < stamp(STEPS));
    observations
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

/// A filter's complete final state, in enough digits to distinguish any two numbers.
fn final_state_text<const N: usize>(config: &FilterConfig, observations: &[Observation]) -> String {
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

fn assert_order_does_not_matter<const N: usize>(case: &str, config: &FilterConfig, observations: &[Observation]) {
    let expected = final_state_text::<N>(config, observations);
    for seed in 0..3 {
        let found = final_state_text::<N>(config, &shuffled(observations, seed));
        assert!(found == expected, "{case}: another belief with the order of seed {seed}");
    }
}

fn shift(observations: &mut [Observation], sensor: SensorId, by: TimeDelta) {
    for observation in observations.iter_mut().filter(|observation| observation.sensor == sensor) {
        observation.stamp = observation.stamp + by;
    }
    observations.sort_by_key(|observation| observation.stamp);
}

/// No gyro for two seconds, no wheels for one, and then counters that begin again; at the end no gyro but for the last two.
fn with_holes_and_jumps() -> Vec<Observation> {
    let mut observations = observations(5);
    observations.retain(|observation| {
        let is_within = |from, until| (stamp(from)..stamp(until)).contains(&observation.stamp);
        match observation.sensor {
            SensorId::GYRO => !is_within(200, 240) && !is_within(770, 798),
            SensorId::WHEELS => !is_within(300, 320),
            _ => true,
        }
    });
    for observation in observations.iter_mut().filter(|observation| observation.stamp >= stamp(500)) {
        if let ObservationKind::WheelAngles { left, right } = &mut observation.measurement {
            (*left, *right) = (*left - Radians(400.0), *right + Radians(300.0));
        }
    }
    observations
}

/// Twenty seconds with every sensor there is, round a corner, some of them at the same instants.
fn with_everything(config: &FilterConfig, seed: u64) -> Vec<Observation> {
    let mut drive = drive_lap(Some(CAMERA), seed);
    let mut senses = SimulatedSensors::new(config, seed);
    let errors = [(0.2, 0.01), (0.0, 0.0), (-0.1, 0.02), (0.3, -0.01)];
    add(&mut drive, SensorId::LANDMARKS, 5, |_, truth| senses.landmarks(truth));
    add(&mut drive, SensorId::BEACONS, 4, |_, truth| senses.beacons(truth, &errors));
    add(&mut drive, SensorId::RANGE, 3, |_, truth| senses.wall(truth));
    // Iron near the compass, now and then.
    add(&mut drive, SensorId::COMPASS, 2, |step, (x, y, heading)| {
        let off_rad = if step % 200 < 30 { 1.2 } else { 0.0 };
        senses.compass((x, y, heading + off_rad))
    });
    add_accelerometers(&mut drive, &mut senses);
    let mut observations = drive.observations();
    observations.retain(|observation| observation.stamp < stamp(420));
    observations
}

#[test]
fn the_order_of_arrival_does_not_matter() {
    let own_instants = |mut observations: Vec<Observation>| {
        shift(&mut observations, SensorId::GYRO, TimeDelta::from_micros(13_337));
        shift(&mut observations, SensorId::CAMERA, TimeDelta::from_micros(-21_123));
        observations
    };
    let mut headless = observations(4);
    each_fix(&mut headless, |fix| fix.heading = None);
    for (case, config, observations) in [
        ("shared instants", config(), observations(1)),
        ("instants of its own for every sensor", config(), own_instants(observations(3))),
        ("a heading still to be found", without_start(), headless),
        ("holes, and counters that jump", config(), with_holes_and_jumps()),
    ] {
        assert_order_does_not_matter::<CORE_STATES>(case, &config, &observations);
    }
}

#[test]
fn the_order_of_arrival_does_not_matter_with_every_sensor_and_every_state() {
    let config = learning_everything();
    let observations = with_everything(&config, 11);
    assert_order_does_not_matter::<LARGE_STATES>("every sensor", &config, &observations);
    let mut filter = PoseFilter::<LARGE_STATES>::new(&config);
    let records: Vec<_> = observations.iter().map(|observation| filter.observe(observation)).collect();
    for kind in ["landmark", "beacon_range", "wall_range", "compass_heading"] {
        let used = records.iter().filter(|record| record.kind == kind && record.outcome == FusionOutcome::Accepted);
        assert!(used.count() > 50, "{kind} is used");
    }
    let gated = records.iter().filter(|record| record.outcome == FusionOutcome::Gated);
    assert!(gated.count() > 20, "and some are not");
    let mut students_t = config;
    students_t.params.student_dof = 4.0;
    assert_order_does_not_matter::<LARGE_STATES>("Student's t", &students_t, &with_everything(&students_t, 13));
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
        assert_order_does_not_matter::<SMALL_STATES>("delay", &config, &observations);
    }
}

#[test]
fn two_fixes_of_one_instant_count_in_either_order() {
    let mut before = observations(6);
    let last =
        before.iter().rposition(|observation| observation.sensor == SensorId::CAMERA).expect("the camera looked");
    let one = before[last];
    before.truncate(last);
    let other = |change: &dyn Fn(&mut posebridge_telemetry::Fix)| {
        let mut other = [one];
        each_fix(&mut other, change);
        other[0]
    };
    let claiming = |variance: f64| {
        other(&|fix| {
            let own = PositionCovariance { xx_m2: variance, xy_m2: 0.0, yy_m2: variance, heading_rad2: variance };
            fix.covariance = Some(own);
        })
    };
    let result_of = |last: &[Observation]| final_state_text::<CORE_STATES>(&config(), &[&before[..], last].concat());
    for [one, two] in [[one, other(&|fix| fix.position.x.0 += 0.001)], [claiming(1e-4), claiming(4e-6)]] {
        assert!(result_of(&[one, two]) == result_of(&[two, one]));
        assert!(result_of(&[one, two]) != result_of(&[one]));
    }
}

#[test]
fn an_observation_after_a_change_of_tunables_uses_the_new_ones() {
    let changed = Params { turn_acceleration_rad_per_s2: 9.0, acceleration_m_per_s2: 0.1, ..Params::default() };
    let changed = FilterCommand::SetParams(changed);
    let mut between = PoseFilter::<CORE_STATES>::new(&config());
    let mut before = PoseFilter::<CORE_STATES>::new(&config());
    drive_straight(&mut between, 5_000);
    drive_straight(&mut before, 5_000);
    let (gyro, wheels) = (gyro(5_050, 0.4), wheels(5_050, 36.0, 36.2));
    assert_eq!(before.apply_command(&changed), FusionOutcome::Accepted);
    before.observe(&gyro);
    before.observe(&wheels);
    between.observe(&wheels);
    assert_eq!(between.apply_command(&changed), FusionOutcome::Accepted);
    between.observe(&gyro);
    let state = |filter: &PoseFilter<CORE_STATES>| format!("{:?} {:?}", filter.state(), latest(filter));
    assert_eq!(state(&between), state(&before));
}
