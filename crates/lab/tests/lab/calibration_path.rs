//! The calibration by watched drives, on drives whose robot is known: what is found, how well it says it knows it, what it leaves
//! alone, and which mistakes it names.

use std::f64::consts::TAU;

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_lab::calibration::CalibrationError;
use posebridge_lab::calibration::free_path::{
    AS_GIVEN, CalibrationUnknown, FreePath, HypothesisTest, PathCalibration, PathStart, PositionFix, TravelStep,
    UnknownEstimate, UnknownStatus, Wiring, calibrate_path, dead_reckon,
};
use posebridge_telemetry::{Calibration, Meters, Pose, SensorNoise, StartPose, UncertainValue};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::support::{self, wheels};

const TRACK_M: f64 = 0.16;
const SIGMA_M: f64 = 0.004;
const STEP_S: f64 = 0.1;

/// A robot as it really is, against its description.
#[derive(Clone, Copy)]
struct TrueRobot {
    radius_scale: f64,
    radius_difference: f64,
    track_scale: f64,
    delay_s: f64,
    tag_m: [f64; 2],
    slip_m_per_sqrt_m: f64,
    heading_rad_per_sqrt_m: f64,
    /// Where it stands and points at the start.
    start: [f64; 3],
}

const TRUTH: TrueRobot = TrueRobot {
    radius_scale: 0.03,
    radius_difference: -0.004,
    track_scale: -0.06,
    delay_s: 0.12,
    tag_m: [0.035, -0.01],
    slip_m_per_sqrt_m: 0.002,
    heading_rad_per_sqrt_m: 0.0,
    start: [0.4, -0.2, 0.7],
};

/// Turn rates in rad/s, one per 2 s, at 0.2 m/s.
const BOTH_DIRECTIONS: [f64; 12] = [0.0, 0.8, 0.3, -0.9, 0.0, -0.5, 1.0, 0.0, -1.1, 0.4, 0.0, 0.6];

fn normal(random: &mut Pcg64) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// Drives `rounds` times through the turn rates and looks five times a second.
fn drive(truth: &TrueRobot, rates: &[f64], rounds: usize, seed: u64) -> FreePath {
    let mut random = Pcg64::seed_from_u64(seed);
    let [mut x, mut y, mut heading] = truth.start;
    let (mut steps, mut poses) = (Vec::new(), vec![[x, y, heading]]);
    let per_rate = (2.0 / STEP_S) as usize;
    for round in 0..rounds {
        for rate in rates {
            for part in 0..per_rate {
                // It begins and ends each leg slowly, so that a delay can be told from a shift.
                let speed = 0.05 + 0.3 * (part as f64 / per_rate as f64 * std::f64::consts::PI).sin();
                let rate = if round % 2 == 0 { *rate } else { 0.7 * rate };
                let (forward, turn) = (speed * STEP_S, rate * STEP_S);
                let half = 0.5 * turn * TRACK_M * (1.0 + truth.track_scale);
                let wheels = [forward - half, forward + half];
                let from_s = steps.len() as f64 * STEP_S;
                steps.push(TravelStep {
                    from_s,
                    until_s: from_s + STEP_S,
                    travel: WheelTravel {
                        left_m: wheels[0] / (1.0 + truth.radius_scale - 0.5 * truth.radius_difference),
                        right_m: wheels[1] / (1.0 + truth.radius_scale + 0.5 * truth.radius_difference),
                    },
                });
                let off = truth.slip_m_per_sqrt_m * forward.sqrt() * normal(&mut random);
                x += (forward + off) * (heading + 0.5 * turn).cos();
                y += (forward + off) * (heading + 0.5 * turn).sin();
                heading += turn;
                if truth.heading_rad_per_sqrt_m > 0.0 {
                    let heading_noise = truth.heading_rad_per_sqrt_m * forward.sqrt();
                    heading += heading_noise * normal(&mut random);
                }
                poses.push([x, y, heading]);
            }
        }
    }
    FreePath {
        name: format!("seed {seed}"),
        start: PathStart { pose: truth.start, position_sigma_m: 0.001, heading_sigma_rad: 0.001 },
        fixes: simulate_fixes(truth, &poses, &mut random),
        steps,
    }
}

/// What is seen of the tag on the way through these poses.
fn simulate_fixes(truth: &TrueRobot, poses: &[[f64; 3]], random: &mut Pcg64) -> Vec<PositionFix> {
    let fixes = (0..poses.len() - 1).step_by(2).map(|index| {
        let [x, y, heading] = poses[index];
        let (sin, cos) = heading.sin_cos();
        let [ahead, left] = truth.tag_m;
        let mut measured = |exact: f64| exact + SIGMA_M * normal(random);
        PositionFix {
            at_s: index as f64 * STEP_S + truth.delay_s,
            position_m: [measured(x + cos * ahead - sin * left), measured(y + sin * ahead + cos * left)],
            sigma_m: SIGMA_M,
            tag_m: [0.0; 2],
        }
    });
    fixes.collect()
}

fn known(value: f64, sigma: f64) -> UncertainValue {
    UncertainValue { value, sigma }
}

fn config() -> FilterConfig {
    let noise = SensorNoise { travel_m_per_sqrt_m: 0.002, ..SensorNoise::EXACT };
    let calibration = Calibration {
        radius_scale: known(0.0, 0.05),
        radius_difference: known(0.0, 0.02),
        track_scale: known(0.0, 0.1),
        fix_delay_s: known(0.0, 0.3),
        tag_forward_m: known(0.0, 0.1),
        tag_left_m: known(0.0, 0.1),
        ..Calibration::default()
    };
    FilterConfig { calibration, ..support::config([0.03; 2], TRACK_M, TAU / 1000.0, noise) }
}

fn truth_of(unknown: CalibrationUnknown, truth: &TrueRobot) -> f64 {
    match unknown {
        CalibrationUnknown::RadiusScale => truth.radius_scale,
        CalibrationUnknown::TrackScale => truth.track_scale,
        CalibrationUnknown::RadiusDifference => truth.radius_difference,
        CalibrationUnknown::FixDelay => truth.delay_s,
        CalibrationUnknown::TagForward => truth.tag_m[0],
        CalibrationUnknown::TagLeft => truth.tag_m[1],
    }
}

fn calibrated(config: &FilterConfig, paths: &[FreePath]) -> PathCalibration {
    calibrate_path(config, paths).expect("the drives suffice")
}

#[test]
fn every_number_is_found_within_its_sigma_over_many_drives() {
    const DRIVES: u64 = 12;
    let mut squares = [0.0; 6];
    for seed in 0..DRIVES {
        let found = calibrated(&config(), &[drive(&TRUTH, &BOTH_DIRECTIONS, 4, seed)]);
        assert!(found.hypothesis_test.as_ref().is_some_and(HypothesisTest::is_sound));
        for (square, entry) in squares.iter_mut().zip(&found.entries) {
            assert_eq!(entry.status, UnknownStatus::Estimated, "{entry:?}");
            let off = entry.after.value - truth_of(entry.unknown, &TRUTH);
            assert!(off.abs() < 5.0 * entry.after.sigma, "{seed}: {off} {entry:?}");
            *square += (off / entry.after.sigma).powi(2) / DRIVES as f64;
        }
        assert!((0.7..1.4).contains(&found.consistency), "{}", found.consistency);
    }
    // The sigmas mean what they say, on average over numbers and drives.
    let mean = squares.iter().sum::<f64>() / 6.0;
    assert!((0.4..2.0).contains(&mean), "{squares:?}");
}

#[test]
fn where_the_heading_wanders_the_sigmas_say_so_if_they_are_told() {
    const DRIVES: u64 = 24;
    const HEADING_NOISE: f64 = 0.02;
    let truth = TrueRobot { heading_rad_per_sqrt_m: HEADING_NOISE, ..TRUTH };
    let mut with_noise = config();
    with_noise.noise.heading_rad_per_sqrt_m = HEADING_NOISE;
    // Squares of the errors over their sigmas: told of the wandering, and not told.
    let mut squares = [[0.0; 2]; 2];
    let mut founds = [[0_u32; 2]; 2];
    for seed in 0..DRIVES {
        let path = [drive(&truth, &BOTH_DIRECTIONS, 4, seed)];
        for (config_index, config) in [with_noise.clone(), config()].iter().enumerate() {
            let found = calibrated(config, &path);
            for (index, unknown) in
                [CalibrationUnknown::RadiusDifference, CalibrationUnknown::TrackScale].into_iter().enumerate()
            {
                let entry = found.entries.iter().find(|one| one.unknown == unknown);
                let entry = entry.expect("it is looked for");
                // Now and then a wandering looks as if wheels and track could not be told apart.
                if entry.status == UnknownStatus::Estimated {
                    let off = entry.after.value - truth_of(unknown, &truth);
                    squares[config_index][index] += (off / entry.after.sigma).powi(2);
                    founds[config_index][index] += 1;
                }
            }
        }
    }
    for (squares, founds) in squares.iter_mut().zip(founds) {
        for (square, found) in squares.iter_mut().zip(founds) {
            assert!(found >= 20, "{founds:?} of {DRIVES}");
            *square /= f64::from(found);
        }
    }
    println!("told of the wandering and not: {squares:.2?}");
    let [with_noise, without_noise] = squares;
    // 24 drives: 95 % of the means of a chi-square of one lie between 0.5 and 1.7.
    assert!((0.5..1.7).contains(&with_noise[0]), "{with_noise:?}");
    assert!(without_noise[0] > 4.0, "{without_noise:?}");
    // The track is known better than is said, with and without: its sigma carries that of the length.
    assert!(with_noise[1] < 1.7, "{with_noise:?}");
}

#[test]
fn dead_reckoning_with_what_was_found_stays_with_the_robot_on_another_drive() {
    let config = config();
    let found = calibrated(&config, &[drive(&TRUTH, &BOTH_DIRECTIONS, 4, 1)]);
    let other = drive(&TRUTH, &BOTH_DIRECTIONS, 3, 77);
    let rms_m = |numbers| dead_reckon(&config, numbers, &other, other.start.pose[2]).error.rms_m;
    let (before, after) = (rms_m(&found.before), rms_m(&found.after));
    assert!(after < 0.1 * before && after < 0.02, "{before} {after}");
}

#[test]
fn a_held_number_stays_and_is_said_to_be_held() {
    let mut config = config();
    config.calibration.radius_scale = known(0.03, 0.0);
    let found = calibrated(&config, &[drive(&TRUTH, &BOTH_DIRECTIONS, 4, 2)]);
    let UnknownEstimate { after, status, .. } = found.entry(CalibrationUnknown::RadiusScale);
    assert_eq!((after, status), (known(0.03, 0.0), UnknownStatus::Fixed));
    let track = found.entry(CalibrationUnknown::TrackScale).after;
    assert!((track.value - TRUTH.track_scale).abs() < 5.0 * track.sigma, "{track:?}");
}

#[test]
fn on_a_straight_line_the_track_is_left_alone() {
    let found = calibrated(&config(), &[drive(&TRUTH, &[0.0; 6], 2, 3)]);
    let track = found.entry(CalibrationUnknown::TrackScale);
    assert_eq!((track.after, track.status), (known(0.0, 0.1), UnknownStatus::Unobservable));
    let radius = found.entry(CalibrationUnknown::RadiusScale);
    assert_eq!(radius.status, UnknownStatus::Estimated);
    assert!((radius.after.value - TRUTH.radius_scale).abs() < 5.0 * radius.after.sigma);
}

#[test]
fn on_one_circle_unequal_wheels_are_not_told_from_the_track() {
    let truth = TrueRobot { delay_s: 0.0, tag_m: [0.0; 2], ..TRUTH };
    // On a circle a tag to the left is a larger wheel, and a tag ahead is a camera that is late.
    let mut config = config();
    config.calibration.fix_delay_s = known(0.0, 0.0);
    config.calibration.tag_forward_m = known(0.0, 0.0);
    config.calibration.tag_left_m = known(0.0, 0.0);
    let found = calibrated(&config, &[drive(&truth, &[0.5], 12, 4)]);
    let difference = found.entry(CalibrationUnknown::RadiusDifference);
    assert_ne!(difference.status, UnknownStatus::Estimated, "{found:?}");
    assert_eq!(difference.after.value, 0.0);
    // The track pays for the wheels' difference, and its sigma says so.
    let track = found.entry(CalibrationUnknown::TrackScale).after;
    let off = (track.value - truth.track_scale).abs();
    assert!(off < 2.0 * track.sigma && track.sigma > 0.01, "{track:?}");
}

#[test]
fn a_start_that_nobody_knows_is_found() {
    let mut path = drive(&TRUTH, &BOTH_DIRECTIONS, 4, 5);
    path.start = PathStart {
        pose: [path.fixes[0].position_m[0], path.fixes[0].position_m[1], 0.0],
        position_sigma_m: 1e3,
        heading_sigma_rad: 10.0,
    };
    let found = calibrated(&config(), &[path]);
    let off = (found.headings_rad[0] - TRUTH.start[2]).abs();
    assert!(off < 0.05, "{off}");
    let track = found.entry(CalibrationUnknown::TrackScale).after;
    assert!((track.value - TRUTH.track_scale).abs() < 5.0 * track.sigma, "{track:?}");
}

/// What a brick that has this mistake would say.
fn with_wiring_error(path: &FreePath, wiring: Wiring, travel_factor: f64) -> FreePath {
    let mut path = path.clone();
    for step in &mut path.steps {
        let WheelTravel { left_m, right_m } = step.travel;
        let (left_m, right_m) = match wiring {
            Wiring::AsGiven => (left_m, right_m),
            Wiring::Swapped => (right_m, left_m),
            Wiring::BothReversed => (-left_m, -right_m),
            Wiring::LeftReversed => (-left_m, right_m),
            Wiring::RightReversed => (left_m, -right_m),
            // What is called left is the right wheel.
            Wiring::SwappedLeftReversed => (-right_m, left_m),
            Wiring::SwappedRightReversed => (right_m, -left_m),
        };
        step.travel = WheelTravel { left_m: left_m / travel_factor, right_m: right_m / travel_factor };
    }
    path
}

#[test]
fn mistakes_in_the_description_are_named_and_undone() {
    let path = drive(&TRUTH, &BOTH_DIRECTIONS, 3, 6);
    for wiring in Wiring::ALL {
        for (track_factor, travel_factor) in [(1.0, 1.0), (2.0, 1.0), (0.5, 1.0), (1.0, 4.0), (2.0, 0.5)] {
            let mut config = config();
            config.geometry.track_width = Meters(TRACK_M / track_factor);
            let found = calibrated(&config, &[with_wiring_error(&path, wiring, travel_factor)]);
            let hypothesis = found.hypothesis();
            let case = format!("{wiring:?} {track_factor} {travel_factor}: {hypothesis:?}");
            assert_eq!(hypothesis.wiring, wiring, "{case}");
            assert_eq!(hypothesis.track_factor, track_factor, "{case}");
            assert_eq!(hypothesis.travel_factor, travel_factor, "{case}");
            let track_m = found.after.track_width_m;
            assert!((track_m / TRACK_M - 1.0 - TRUTH.track_scale).abs() < 0.01, "{case}");
        }
    }
}

#[test]
fn a_track_that_is_off_by_a_tenth_is_calibrated_and_not_called_a_mistake() {
    for track_scale in [-0.15, 0.15] {
        let truth = TrueRobot { track_scale, ..TRUTH };
        let mut config = config();
        config.calibration.track_scale = known(0.0, 0.2);
        let found = calibrated(&config, &[drive(&truth, &BOTH_DIRECTIONS, 3, 7)]);
        assert_eq!(found.hypothesis(), AS_GIVEN);
        let track = found.entry(CalibrationUnknown::TrackScale).after;
        assert!((track.value - track_scale).abs() < 0.01, "{track:?}");
    }
}

#[test]
fn a_drive_is_made_of_usable_observations_in_any_order() {
    let config = FilterConfig {
        start: Some(StartPose { pose: Pose::default(), position_sigma_m: 0.01, heading_sigma_rad: 0.1 }),
        ..config()
    };
    let good = [wheels(0, 0.0, 0.0), wheels(100, 0.0, 0.0), wheels(200, 1.0, 0.5), wheels(300, 1.5, 1.5)];
    let mut odd = good.to_vec();
    odd.reverse();
    odd.push(wheels(250, f64::NAN, 0.0));
    odd.push(good[2]);
    let fix = |at_s: f64, x: f64| PositionFix { at_s, position_m: [x, 0.0], sigma_m: 0.01, tag_m: [0.0; 2] };
    let fixes = [fix(0.3, 0.1), fix(f64::NAN, 0.0), fix(0.0, 0.0), fix(0.05, 9.0), fix(0.2, f64::INFINITY)];
    let path = FreePath::new("odd", &config, &odd, fixes);
    // At rest nothing rolls, and the second of two sights that are too close is left out.
    assert_eq!(path, FreePath::new("odd", &config, &good, [fix(0.0, 0.0), fix(0.3, 0.1)]));
    assert_eq!((path.steps.len(), path.fixes.len()), (2, 2));
    assert!((path.steps[0].travel.left_m - 0.03).abs() < 1e-15);
    assert!((path.length_m() - 0.03 * 1.5).abs() < 1e-15);
}

#[test]
fn without_motion_or_sights_it_says_so() {
    let mut path = drive(&TRUTH, &BOTH_DIRECTIONS, 1, 8);
    path.fixes.truncate(2);
    assert!(matches!(calibrate_path(&config(), &[path.clone()]), Err(CalibrationError::TooFewData { found: 2, .. })));
    path.steps.clear();
    assert!(matches!(calibrate_path(&config(), &[path]), Err(CalibrationError::TooFewData { found: 0, .. })));
    assert!(calibrate_path(&config(), &[]).is_err());
}
