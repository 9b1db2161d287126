//! The path in hindsight and the bound, on a straight way where both are known by hand.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::smoother::{OfflineError, smooth};
use posebridge_lab::accuracy::{ObservationArrival, ReferenceDrive, error_bound, score_smoother};
use posebridge_lab::statistics::RunningMean;
use posebridge_report::TimedPose;
use posebridge_telemetry::{
    Arena, BrickClock, Heading, Meters, Pose, Radians, SensorId, SensorNoise, StartPose, Timestamp,
};

use crate::support;

/// Way of a step, m.
const STEP_M: f64 = 0.01;
/// Noise of a wheel, m per sqrt(m).
const WHEEL: f64 = 0.001;
/// Of the start, m and rad.
const START_SIGMA: f64 = 1e-4;

/// Its wheels differ, so that one cannot be taken for the other.
fn config() -> FilterConfig {
    let noise = SensorNoise {
        wheel_travel_m_per_sqrt_m: WHEEL,
        gyro_rad_per_s: 1e-9,
        fix_position_m: 0.001,
        fix_heading_rad: 0.01,
        ..SensorNoise::EXACT
    };
    let start = StartPose { pose: Pose::default(), position_sigma_m: START_SIGMA, heading_sigma_rad: START_SIGMA };
    FilterConfig { start: Some(start), ..support::config([0.05, 0.1], 0.2, 0.001, noise) }
}

fn stamp(step: usize) -> Timestamp<BrickClock> {
    Timestamp::from_millis(step as i64 * 50)
}

fn pose(x_m: f64) -> Pose<Arena> {
    Pose::new(Meters(x_m), Meters(0.0), Heading::default())
}

/// What each wheel turns in a step.
const TURN: [Radians; 2] = [Radians(STEP_M / 0.05), Radians(STEP_M / 0.1)];

/// Straight along x. Fixes are of the step `taken` and arrive two steps later, so far beside the truth.
fn straight(steps: usize, fixes: &[(usize, f64)]) -> ReferenceDrive {
    let mut arrivals = Vec::new();
    for step in 0..=steps {
        let turned = |turn: Radians| turn.0 * step as f64;
        let observation = support::wheels(50 * step as i64, turned(TURN[0]), turned(TURN[1]));
        arrivals.push(ObservationArrival { step, measured_step: step, observation });
        for (taken, off_m) in fixes.iter().filter(|(taken, _)| taken + 2 == step) {
            let observation = support::fix(50 * *taken as i64, STEP_M * *taken as f64, *off_m, None);
            arrivals.push(ObservationArrival { step, measured_step: *taken, observation });
        }
    }
    let truth = (0..=steps).map(|step| TimedPose { time: stamp(step), pose: pose(STEP_M * step as f64) });
    ReferenceDrive { truth: truth.collect(), arrivals, scored_from: 1, ..ReferenceDrive::default() }
}

fn bound_of(drive: &ReferenceDrive) -> RunningMean {
    error_bound(&config(), drive, &vec![TURN; drive.truth.len() - 1]).unwrap()
}

#[test]
fn without_a_fix_the_bound_is_the_start_and_the_noise_of_the_wheels() {
    // The gyro is perfect: the heading is as good as at the start, and the distance is the mean of both wheels.
    let variance = |step: usize| {
        let distance_m = STEP_M * step as f64;
        2.0 * START_SIGMA.powi(2) + (distance_m * START_SIGMA).powi(2) + 0.5 * WHEEL.powi(2) * distance_m
    };
    let mut drive = straight(20, &[]);
    let expected = |from: usize| {
        let steps = from..=20;
        let count = steps.clone().count() as f64;
        (steps.map(variance).sum::<f64>() / count).sqrt()
    };
    assert!((bound_of(&drive).root().unwrap() / expected(1) - 1.0).abs() < 1e-6);
    drive.scored_from = 15;
    let late = bound_of(&drive);
    assert!((late.root().unwrap() / expected(15) - 1.0).abs() < 1e-6);
    // Six steps and another six: the same mean.
    let mut twice = late;
    twice.merge(&late);
    assert!((twice.root().unwrap() / expected(15) - 1.0).abs() < 1e-6);
    assert_eq!(RunningMean::default().root(), None);
}

#[test]
fn a_fix_lowers_the_bound_from_the_step_of_its_arrival_on() {
    // What arrives after the last step is among the arrivals as well.
    let last_step = |steps, fixes: &[(usize, f64)]| {
        let mut drive = straight(110, fixes);
        drive.truth.truncate(steps + 1);
        drive.scored_from = steps;
        bound_of(&drive).root().unwrap()
    };
    // A hundred of the same step: the position at that step is known to a tenth of a millimetre.
    let fixes = [(100, 0.0); 100];
    assert_eq!(last_step(101, &fixes), last_step(101, &[]));
    assert!(last_step(102, &fixes) < 0.5 * last_step(102, &[]));
}

#[test]
fn there_is_no_bound_where_its_assumptions_do_not_hold() {
    let drive = straight(20, &[(4, 0.0)]);
    assert_eq!(error_bound(&config(), &drive, &[]), None);
    assert_eq!(error_bound(&config(), &ReferenceDrive::default(), &[]), None);
    let mut config = config();
    config.noise.wheel_travel_m_per_sqrt_m = f64::NAN;
    assert_eq!(error_bound(&config, &drive, &[TURN; 20]), None);
}

#[test]
fn in_hindsight_the_first_step_knows_the_last_fix() {
    // Told to start 50 mm beside, give or take; the fixes tell better, and one of them is half a metre off.
    let assumed = FilterConfig {
        start: Some(StartPose {
            pose: Pose::new(Meters(0.0), Meters(0.05), Heading::default()),
            position_sigma_m: 0.1,
            heading_sigma_rad: 0.1,
        }),
        ..config()
    };
    let drive = straight(60, &[(10, 0.0), (20, 0.0), (30, 0.0), (40, 0.5), (50, 0.0), (55, 0.0)]);
    let result = score_smoother(&drive, &assumed, smooth);
    assert_eq!(result.refusal, None);
    let score = result.score;
    assert_eq!((score.runs, score.steps(), score.steps_without_estimate), (1, 60, 0));
    assert!(score.position_max_m.unwrap() < 0.001);
    assert!(score.claimed_rms_m().unwrap() < 0.002);
    let camera = score.sources[0];
    assert_eq!((camera.sensor, camera.used, camera.gated), (SensorId::CAMERA, 5, 1));
}

#[test]
fn without_a_path_no_step_has_an_estimate_and_the_reason_is_told() {
    let nowhere = FilterConfig { start: None, ..config() };
    let result = score_smoother(&straight(20, &[]), &nowhere, smooth);
    let refusal = result.refusal.unwrap();
    assert!(matches!(refusal, OfflineError::NothingObserved { .. }));
    assert_eq!((result.score.runs, result.score.steps(), result.score.steps_without_estimate), (1, 0, 20));
    assert!(result.score.sources.is_empty() && result.score.run_rms_m.is_empty());
}
