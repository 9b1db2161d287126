//! Landmarks, beacons, walls and a compass, beside a camera or in its place.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::pose::layout::{LARGE_STATES, StateLayout};
use posebridge_estimator::observations::StateTerm;
use posebridge_telemetry::{FusionOutcome, SensorId};

use crate::support::alter::{CAMERA, altered, at, error_at, records, step_of};
use crate::support::filters::started_at;
use crate::support::robot::{DEGREE, config, unknown};
use crate::support::score::{FilterRun, Score, mean, nis_per_dof, play, played, score};
use crate::support::simulation::{
    Drive, STEP_S, SimulatedSensors, add, add_accelerometers, drive_lap, furnished, step_between,
};

fn verdicts(played: &FilterRun, kind: &str, steps: std::ops::Range<usize>) -> Vec<FusionOutcome> {
    records(played, kind, &steps).into_iter().map(|record| record.outcome).collect()
}

/// Scores over seeds of drives with a sensor added; the mean NIS of its kind must be near one.
fn mean_with(config: &FilterConfig, kind: &str, runs: u64, sense: impl Fn(&mut Drive, &mut SimulatedSensors)) -> Score {
    let (mut scores, mut nis) = (vec![], 0.0);
    for seed in 0..runs {
        let mut drive = drive_lap(None, seed);
        sense(&mut drive, &mut SimulatedSensors::new(config, seed));
        let played = play(&drive, config);
        nis += nis_per_dof(&played, kind) / runs as f64;
        scores.push(score(&drive, &played, 0));
    }
    let mean = mean(&scores);
    println!("{kind}: {mean:?}, NIS {nis:.3}");
    assert!((0.9..1.1).contains(&nis), "{kind}: NIS {nis}");
    mean
}

#[test]
fn landmarks_alone_keep_the_robot_located_and_consistent() {
    let config = furnished(&config());
    let mean = mean_with(&config, "landmark", 40, |drive, senses| {
        add(drive, SensorId::LANDMARKS, 4, |_, truth| senses.landmarks(truth));
    });
    assert!(mean.position_rms_m < 0.02, "{mean:?}");
    // 99.9 % of chi-square with 120 degrees of freedom, for the pose of 40 runs.
    assert!((0.64..1.43).contains(&mean.anees), "{mean:?}");
}

/// Offsets and scales of the four beacons.
const BEACON_ERRORS: [(f64, f64); 4] = [(0.25, 0.01), (-0.1, 0.02), (0.4, -0.01), (0.0, 0.0)];

fn learning_beacons() -> FilterConfig {
    let mut config = furnished(&config());
    config.calibration.beacon_offset_m = unknown(0.3);
    config.calibration.beacon_scale = unknown(0.02);
    config
}

#[test]
fn beacons_with_errors_of_their_own_locate_and_their_errors_are_learned() {
    let config = learning_beacons();
    let mean = mean_with(&config, "beacon_range", 20, |drive, senses| {
        add(drive, SensorId::BEACONS, 4, |_, truth| senses.beacons(truth, &BEACON_ERRORS));
    });
    assert!(mean.position_rms_m < 0.04, "{mean:?}");
    assert!((0.55..1.6).contains(&mean.anees), "{mean:?}");

    let layout = StateLayout::new(&config, LARGE_STATES);
    let mut nees = 0.0;
    for seed in 0..20 {
        let mut drive = drive_lap(None, seed);
        let mut senses = SimulatedSensors::new(&config, seed);
        add(&mut drive, SensorId::BEACONS, 4, |_, truth| senses.beacons(truth, &BEACON_ERRORS));
        let filter = played::<LARGE_STATES>(&drive, &config);
        let state = filter.state();
        for (slot, (offset_m, scale)) in BEACON_ERRORS.into_iter().enumerate() {
            let row = layout.row(StateTerm::BeaconOffset(slot)).unwrap();
            // At a middle range the two are observed together; the range that they predict is what counts.
            let middle_m = 3.5;
            let p = &state.covariance;
            let error_m = state.mean[row] - offset_m + middle_m * (state.mean[row + 1] - scale);
            let variance =
                p[(row, row)] + 2.0 * middle_m * p[(row, row + 1)] + middle_m * middle_m * p[(row + 1, row + 1)];
            assert!(variance.sqrt() < 0.06, "seed {seed}, beacon {slot}");
            nees += error_m * error_m / variance / 80.0;
        }
    }
    println!("errors of the beacons' ranges at 3.5 m: NEES {nees:.2}");
    // 20 runs of four beacons that share the robot's place: chi-square with 20 degrees of freedom, 99.9 %.
    assert!((0.3..2.27).contains(&nees), "{nees}");
}

#[test]
fn beacons_without_estimated_errors_are_used_as_they_are() {
    let config = furnished(&config());
    let mean = mean_with(&config, "beacon_range", 10, |drive, senses| {
        add(drive, SensorId::BEACONS, 4, |_, truth| senses.beacons(truth, &[(0.0, 0.0); 4]));
    });
    assert!(mean.position_rms_m < 0.03, "{mean:?}");
}

#[test]
fn walls_ahead_keep_the_forward_position_known() {
    let mut config = furnished(&config());
    // While the robot turns the ranges depend on its heading, again and again on the same error: they contain little about the sensor.
    config.params.adapt_gain = 0.0;
    let mean = mean_with(&config, "wall_range", 40, |drive, senses| {
        add(drive, SensorId::RANGE, 2, |_, truth| senses.wall(truth));
    });
    assert!(mean.position_rms_m < 0.02, "{mean:?}");
    assert!((0.64..1.43).contains(&mean.anees), "{mean:?}");
}

#[test]
fn a_compass_keeps_the_heading_and_disturbances_are_gated() {
    let config = furnished(&config());
    let disturbed = 500..620;
    for seed in 0..10 {
        let mut drive = drive_lap(None, seed);
        let mut senses = SimulatedSensors::new(&config, seed);
        let near_iron = disturbed.clone();
        add(&mut drive, SensorId::COMPASS, 2, |step, (x, y, heading)| {
            let is_near = near_iron.contains(&step);
            let off_rad = if is_near { 80.0 * DEGREE } else { 0.0 };
            senses.compass((x, y, heading + off_rad))
        });
        let played = play(&drive, &config);
        let of_disturbed = verdicts(&played, "compass_heading", disturbed.clone());
        assert!(of_disturbed.iter().all(|verdict| *verdict == FusionOutcome::Gated), "seed {seed}");
        let after = verdicts(&played, "compass_heading", disturbed.end..800);
        let used = after.iter().filter(|verdict| **verdict == FusionOutcome::Accepted);
        assert!(used.count() as f64 > 0.97 * after.len() as f64, "seed {seed}");
        for step in [disturbed.start - 1, disturbed.end, drive.poses.len()] {
            let (_, heading_rad) = error_at(&drive, &played, step);
            assert!(heading_rad < 2.5 * DEGREE, "seed {seed}, step {step}: {heading_rad}");
        }
        assert_eq!(at(&played, drive.poses.len()).reset_counter, 0);
    }
}

#[test]
fn a_compass_and_a_wall_that_agree_do_not_silence_the_camera_that_disagrees() {
    for (kind, sensor) in [("compass_heading", SensorId::COMPASS), ("wall_range", SensorId::RANGE)] {
        let mut config = furnished(&started_at(0.0, 0.7, 0.0));
        // A heading that is known so well that the wall ahead does not determine the position along it.
        if let Some(start) = &mut config.start {
            start.heading_sigma_rad = 0.002;
        }
        // As configured, so that no widening gate helps.
        config.params.adapt_gain = 0.0;
        let mut drive = drive_lap(Some(CAMERA), 3);
        let mut senses = SimulatedSensors::new(&config, 3);
        add(&mut drive, sensor, 2, |_, truth| match sensor {
            SensorId::COMPASS => senses.compass(truth),
            _ => senses.wall(truth),
        });
        let played = play(&drive, &config);
        let agreed = verdicts(&played, kind, 2..30);
        assert!(agreed.contains(&FusionOutcome::Accepted), "{kind}: {agreed:?}");
        assert_eq!(at(&played, 120).reset_counter, 1, "{kind}");
        assert!(error_at(&drive, &played, 120).0 < 0.03, "{kind}");
    }
}

#[test]
fn observations_of_an_unconfigured_world_are_unused() {
    let without_map = config();
    let furnished = furnished(&config());
    let mut drive = drive_lap(None, 1);
    let mut senses = SimulatedSensors::new(&furnished, 1);
    add(&mut drive, SensorId::LANDMARKS, 10, |_, truth| senses.landmarks(truth));
    add(&mut drive, SensorId::BEACONS, 10, |_, truth| senses.beacons(truth, &[(0.0, 0.0); 4]));
    add(&mut drive, SensorId::RANGE, 10, |_, truth| senses.wall(truth));
    let played = play(&drive, &without_map);
    let end = drive.poses.len() + 1;
    for kind in ["landmark", "beacon_range", "wall_range"] {
        let found = verdicts(&played, kind, 0..end);
        assert!(found.len() > 10, "{kind}");
        assert!(found.iter().all(|verdict| *verdict == FusionOutcome::Unused), "{kind}");
    }
}

/// Root mean square of the error of the forward speed, with wheels that are read at 5 Hz.
fn forward_speed_rms(config: &FilterConfig, drive: Drive) -> f64 {
    let poses = drive.poses.clone();
    let sparse = altered(drive, |observation| {
        let is_read = step_of(&observation).is_multiple_of(4);
        (observation.sensor != SensorId::WHEELS || is_read).then_some(observation)
    });
    let played = play(&sparse, config);
    let (mut squares, mut count) = (0.0, 0.0);
    for step in 45..poses.len() {
        let (forward_m, _) = step_between(poses[step - 2], poses[step - 1]);
        squares += (at(&played, step).forward_speed.0 - forward_m / STEP_S).powi(2);
        count += 1.0;
    }
    f64::sqrt(squares / count)
}

#[test]
fn accelerations_determine_the_speed_between_two_readings_of_the_wheels() {
    let mut config = furnished(&config());
    config.noise.accelerometer_m_per_s2 = 0.05;
    let mut felt = drive_lap(None, 1);
    let without = forward_speed_rms(&config, drive_lap(None, 1));
    let mut senses = SimulatedSensors::new(&config, 1);
    add_accelerometers(&mut felt, &mut senses);
    let with = forward_speed_rms(&config, felt);
    println!("forward speed: {without:.4} m/s without, {with:.4} m/s with accelerometers");
    assert!(with < 0.7 * without, "{with} {without}");
}
