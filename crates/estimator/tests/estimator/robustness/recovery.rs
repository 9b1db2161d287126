//! Kidnaps, bursts of wrong fixes that agree with each other, and starts without a pose.

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{Fix, FusionOutcome, Heading, Meters, MissingObservation, ObservationKind, SensorId};

use crate::support::alter::{CAMERA, altered, altered_fixes, at, error_at, without_headings};
use crate::support::robot::config;
use crate::support::score::{FilterRun, play};
use crate::support::simulation::{
    Camera, Carry, Drive, SimulatedSensors, add, drive_carried_lap, drive_lap, drive_lap_from_elsewhere, furnished,
};

const SEEDS: u64 = 200;
/// Lifted on the first straight, and put down 1.5 s later: elsewhere, and pointing elsewhere.
const CARRY: Carry = Carry { from: 200, steps: 30, by: (1.1, 0.9, 1.4) };
const CAMERA_1_HZ: Camera = Camera { every: 20, delay: 2, spread: 1, outliers: 0.0 };

fn students_t(config: &FilterConfig) -> FilterConfig {
    let mut heavy = config.clone();
    heavy.params.student_dof = 4.0;
    heavy
}

/// The first step from which on the estimate stays within 5 cm and 6 degrees of the truth for a second.
fn recovered_at(drive: &Drive, played: &FilterRun, from: usize) -> Option<usize> {
    let is_good = |step: usize| {
        let (position_m, heading_rad) = error_at(drive, played, step);
        position_m < 0.05 && heading_rad < 0.1 && at(played, step).validity.position
    };
    (from..drive.poses.len() - 20).find(|step| (*step..*step + 20).all(is_good))
}

fn assert_recovers(case: &str, config: &FilterConfig, drive: impl Fn(u64) -> Drive, within_steps: usize) {
    let mut waited: Vec<usize> = (0..SEEDS)
        .map(|seed| {
            let drive = drive(seed);
            let played = play(&drive, config);
            let recovered = recovered_at(&drive, &played, CARRY.end());
            recovered.map_or(usize::MAX, |step| step - CARRY.end())
        })
        .collect();
    waited.sort_unstable();
    println!("{case}: {} to {} steps", waited[0], waited[waited.len() - 1]);
    let late = waited.iter().filter(|steps| **steps > within_steps).count();
    assert_eq!(late, 0, "{case}: {late} of {SEEDS} later than {within_steps} steps, the last {:?}", waited.last());
}

#[test]
fn a_kidnapped_robot_is_found_again_by_the_camera() {
    let (gated, heavy) = (config(), students_t(&config()));
    for (case, config, camera, within_steps) in [
        ("10 Hz", &gated, CAMERA, 20),
        ("10 Hz, Student's t", &heavy, CAMERA, 20),
        ("1 Hz", &gated, CAMERA_1_HZ, 80),
        ("1 Hz, Student's t", &heavy, CAMERA_1_HZ, 80),
        ("3 % outliers", &gated, Camera { outliers: 0.03, ..CAMERA }, 30),
    ] {
        assert_recovers(case, config, |seed| drive_carried_lap(Some(camera), &CARRY, seed), within_steps);
    }
}

#[test]
fn without_a_gyro_a_kidnapped_robot_is_found_again_among_outliers() {
    // Nothing shows that it was carried, and every tenth fix is wrong by half a metre.
    let camera = Camera { outliers: 0.1, ..CAMERA };
    let drive = |seed| {
        altered(drive_carried_lap(Some(camera), &CARRY, seed), |observation| {
            (observation.sensor != SensorId::GYRO).then_some(observation)
        })
    };
    assert_recovers("no gyro, 10 % outliers", &config(), drive, 200);
}

#[test]
fn a_kidnapped_robot_is_found_again_by_a_camera_that_sees_no_heading() {
    let drive = |seed| without_headings(drive_carried_lap(Some(CAMERA), &CARRY, seed));
    assert_recovers("positions at 10 Hz", &config(), drive, 60);
}

/// Sightings of every landmark ahead twice a second, and no camera.
fn with_landmarks(mut drive: Drive, config: &FilterConfig, seed: u64) -> Drive {
    let mut sensors = SimulatedSensors::new(config, seed);
    add(&mut drive, SensorId::LANDMARKS, 10, |_, truth| sensors.landmarks(truth));
    drive
}

#[test]
fn a_kidnapped_robot_is_found_again_by_landmarks_alone() {
    let config = furnished(&config());
    for (case, config) in [("landmarks", &config), ("landmarks, Student's t", &students_t(&config))] {
        // Turned once round, so that it looks at two of them from where it is put down.
        let carry = Carry { by: (-0.6, 1.2, std::f64::consts::TAU), ..CARRY };
        let drive = |seed| with_landmarks(drive_carried_lap(None, &carry, seed), config, seed);
        assert_recovers(case, config, drive, 100);
    }
}

#[test]
fn without_a_start_the_pose_is_found_from_two_landmarks() {
    let exact = FilterConfig { start: None, ..furnished(&config()) };
    // Unknown constants must not hide that two sightings fit each other; they are found out on the way.
    let mut uncertain = exact.clone();
    uncertain.calibration.landmark_offset_m.sigma = 0.1;
    uncertain.noise.landmark_place_m = 0.02;
    for (config, within_steps) in [(exact, 100), (uncertain, 400)] {
        for seed in 0..SEEDS {
            let drive = with_landmarks(drive_lap_from_elsewhere(seed), &config, seed);
            let played = play(&drive, &config);
            assert!(!at(&played, 5).validity.position, "seed {seed}");
            let found = recovered_at(&drive, &played, 10).unwrap();
            assert!(found <= within_steps, "seed {seed}: {found}");
        }
    }
}

/// Fixes of two seconds that are wrong in the same way, and move with the robot.
fn with_burst(drive: Drive, from: usize) -> Drive {
    altered_fixes(drive, |step, fix| {
        let is_wrong = (from..from + 40).contains(&step);
        let (sin, cos) = 0.7_f64.sin_cos();
        let (x, y) = (fix.position.x.0, fix.position.y.0);
        let wrong = Fix {
            heading: fix.heading.map(|heading| Heading::from_rad(heading.rad() + 0.7)),
            position: posebridge_telemetry::Point2::new(
                Meters(cos * x - sin * y + 0.4),
                Meters(sin * x + cos * y - 0.3),
            ),
            ..fix
        };
        Some(if is_wrong { wrong } else { fix })
    })
}

#[test]
fn a_burst_of_wrong_fixes_that_agree_moves_nothing() {
    for seed in 0..SEEDS {
        for camera in [CAMERA, CAMERA_1_HZ] {
            let undisturbed = drive_lap(Some(camera), seed);
            let disturbed = with_burst(undisturbed.clone(), 300);
            let square_m = |drive: &Drive| {
                let played = play(drive, &config());
                let resets = at(&played, 500).reset_counter;
                let squares = (300..400).map(|step| error_at(drive, &played, step).0.powi(2));
                assert_eq!(resets, 0, "seed {seed}");
                squares.sum::<f64>()
            };
            let ratio = (square_m(&disturbed) / square_m(&undisturbed)).sqrt();
            assert!(ratio < 5.0, "seed {seed}: {ratio}");
        }
    }
}

#[test]
fn a_burst_after_a_kidnap_delays_the_recovery_and_no_more() {
    for seed in 0..SEEDS {
        let drive = with_burst(drive_carried_lap(Some(CAMERA), &CARRY, seed), CARRY.end());
        let played = play(&drive, &config());
        let recovered = recovered_at(&drive, &played, CARRY.end()).unwrap();
        assert!(recovered <= CARRY.end() + 60, "seed {seed}: {recovered}");
        let resets = played.records.iter().filter(|record| record.outcome == FusionOutcome::PoseReset);
        assert!(resets.count() <= 2, "seed {seed}: to the burst, and back");
    }
}

/// Ranges to every beacon twice a second, and no camera.
fn with_beacons(mut drive: Drive, config: &FilterConfig, seed: u64) -> Drive {
    let mut sensors = SimulatedSensors::new(config, seed);
    add(&mut drive, SensorId::BEACONS, 10, |_, truth| sensors.beacons(truth, &[(0.0, 0.0); 4]));
    drive
}

#[test]
fn a_robot_without_a_pose_says_what_is_missing() {
    let config = FilterConfig { start: None, ..furnished(&config()) };
    let nothing = drive_lap_from_elsewhere(0);
    let with_beacons = with_beacons(nothing.clone(), &config, 0);
    let only = |drive: &Drive, is_seen: fn(&ObservationKind) -> bool| {
        altered(drive.clone(), |observation| {
            let is_motion = [SensorId::WHEELS, SensorId::GYRO].contains(&observation.sensor);
            (is_motion || is_seen(&observation.measurement)).then_some(observation)
        })
    };
    let two_beacons = |seen: &ObservationKind| matches!(seen, ObservationKind::BeaconRange { id, .. } if id.0 < 12);
    let one_landmark = |seen: &ObservationKind| matches!(seen, ObservationKind::Landmark { id, .. } if id.0 == 2);
    let with_landmarks = with_landmarks(nothing.clone(), &config, 0);
    let at_rest = 30;
    for (drive, missing) in [
        (&nothing, MissingObservation::Position),
        (&with_beacons, MissingObservation::Motion),
        (&only(&with_beacons, two_beacons), MissingObservation::ThirdBeacon),
        (&only(&with_landmarks, one_landmark), MissingObservation::SecondLandmark),
    ] {
        assert_eq!(at(&play(drive, &config), at_rest).missing, Some(missing));
    }
    let played = play(&with_beacons, &config);
    assert_eq!(at(&played, with_beacons.poses.len()).missing, None);
}

#[test]
fn by_beacons_alone_a_pose_is_found_without_a_start_and_after_a_kidnap() {
    let config = furnished(&config());
    let carry = Carry { by: (-0.6, 1.2, 2.0), ..CARRY };
    let drive = |seed| with_beacons(drive_carried_lap(None, &carry, seed), &config, seed);
    assert_recovers("beacons", &config, drive, 160);
    let without_start = FilterConfig { start: None, ..config.clone() };
    let mut found: Vec<usize> = (0..SEEDS)
        .map(|seed| {
            let drive = with_beacons(drive_lap_from_elsewhere(seed), &config, seed);
            let played = play(&drive, &without_start);
            recovered_at(&drive, &played, 10).unwrap_or(usize::MAX)
        })
        .collect();
    found.sort_unstable();
    println!("start by beacons: {} to {} steps", found[0], found[found.len() - 1]);
    assert!(found[found.len() - 1] < 200, "{found:?}");
}
