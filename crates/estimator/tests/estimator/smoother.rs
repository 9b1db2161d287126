//! The smoothed path against truth, against the filter that had to answer at once, against the bound, and with disorder, damage, holes
//! and unconfigured offsets; and the path with a fixed lag between the two.

use std::ops::Range;

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::pose::layout::CORE_STATES;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::smoother::{
    ArrivedObservation, Convergence, GroundTruthRun, OfflineError, SmoothedPose, SmoothedTrajectory, cramer_rao_bound,
    smooth, smooth_fixed_lag, smooth_in_passes,
};
use posebridge_telemetry::{
    Arena, Heading, Meters, MetersPerSecond, MountedSensor, Observation, ObservationKind, Odom, Point2, Pose, Radians,
    RadiansPerSecond, SensorId, TimeDelta, Timestamp, quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::support::filters::without_start;
use crate::support::observe::each_fix;
use crate::support::robot::{DEGREE, RADIUS_M, TRACK_M, config, learning_geometry, unknown};
use crate::support::score::{mean, nees_per_dof, play, played, score};
use crate::support::simulation::{
    CAMERA_10_HZ, Camera, Drive, STEP_S, SimulatedSensors, add, drive_lap, drive_on_grid, furnished, stamp,
};

/// Means over runs of the smoothed poses and of the filter: position rms in m, heading rms in rad, ANEES over three.
struct Scores {
    position_rms_m: f64,
    heading_rms_rad: f64,
    anees: f64,
    filter_position_rms_m: f64,
    filter_heading_rms_rad: f64,
}

/// Squares of the position and the heading error and NEES over three degrees of freedom, each a mean over a run.
fn squares(smoothed: &SmoothedTrajectory, drive: &Drive) -> [f64; 3] {
    let mut sums = [0.0; 3];
    let mut count = 0.0;
    for at in &smoothed.poses {
        let step = (at.stamp - stamp(0)).as_secs_f64() / STEP_S;
        let before = (step.round() as usize).checked_sub(1).and_then(|before| drive.poses.get(before));
        let Some(&(x, y, heading)) = before.filter(|_| (step - step.round()).abs() < 1e-6) else { continue };
        let error = [at.pose.x.0 - x, at.pose.y.0 - y, wrap_rad(at.pose.heading.rad() - heading)];
        sums[0] += error[0] * error[0] + error[1] * error[1];
        sums[1] += error[2] * error[2];
        sums[2] += nees_per_dof(error, |row, column| at.covariance[row][column]);
        count += 1.0;
    }
    sums.map(|sum| sum / count)
}

fn smoothed(drive: &Drive, config: &FilterConfig) -> SmoothedTrajectory {
    smooth(config, &drive.observations()).expect("it converges")
}

/// The last pose of a step, which knows all observations of its instant.
fn at_step(smoothed: &SmoothedTrajectory, step: usize) -> SmoothedPose {
    *smoothed.poses.iter().rfind(|at| at.stamp == stamp(step)).expect("there was a reading")
}

fn compare(case: &str, config: &FilterConfig, runs: u64, make: impl Fn(u64) -> Drive) -> Scores {
    let mut sums = [0.0; 3];
    let mut filtered = vec![];
    for seed in 0..runs {
        let drive = make(seed);
        let of_run = squares(&smoothed(&drive, config), &drive);
        sums = std::array::from_fn(|i| sums[i] + of_run[i] / runs as f64);
        filtered.push(score(&drive, &play(&drive, config), 0));
    }
    let filtered = mean(&filtered);
    let scores = Scores {
        position_rms_m: sums[0].sqrt(),
        heading_rms_rad: sums[1].sqrt(),
        anees: sums[2],
        filter_position_rms_m: filtered.position_rms_m,
        filter_heading_rms_rad: filtered.heading_rms_rad,
    };
    println!(
        "{case}: {:.3} mm, {:.3} degrees, ANEES {:.2}; the filter: {filtered:?}",
        1e3 * scores.position_rms_m,
        scores.heading_rms_rad.to_degrees(),
        scores.anees
    );
    scores
}

#[test]
fn four_laps_with_unknown_geometry_stay_within_eight_tenths_of_a_millimetre() {
    let mut sums = [0.0; 3];
    for seed in 0..12 {
        let (drive, geometry) = drive_on_grid(4, Some(CAMERA_10_HZ), seed);
        let smoothed = smoothed(&drive, &learning_geometry());
        assert_eq!(smoothed.convergence, Convergence::Converged, "seed {seed}");
        let of_run = squares(&smoothed, &drive);
        sums = std::array::from_fn(|i| sums[i] + of_run[i] / 12.0);
        let found = smoothed.calibration.radius_scale;
        let mean_radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
        let error = found.value - (mean_radius_m / RADIUS_M - 1.0);
        assert!(error.abs() < 4.0 * found.sigma && found.sigma < 0.000_5);
    }
    println!("camera 10 Hz, unknown geometry, 4 laps: {:.3} mm, ANEES {:.2}", 1e3 * f64::sqrt(sums[0]), sums[2]);
    assert!(f64::sqrt(sums[0]) <= 0.8e-3);
    assert!((0.8..1.25).contains(&sums[2]));
}

#[test]
fn with_a_camera_the_smoother_is_clearly_better_than_the_filter_and_consistent() {
    let scores = compare("camera 10 Hz", &config(), 20, |seed| drive_lap(Some(CAMERA_10_HZ), seed));
    assert!(scores.position_rms_m < 0.7 * scores.filter_position_rms_m);
    assert!(scores.heading_rms_rad < 0.9 * scores.filter_heading_rms_rad);
    assert!((0.8..1.25).contains(&scores.anees), "{}", scores.anees);
}

#[test]
fn half_metre_outliers_do_no_harm() {
    let camera = Camera { outliers: 0.1, ..CAMERA_10_HZ };
    let scores = compare("10 % outliers of 0.5 m", &config(), 10, |seed| drive_lap(Some(camera), seed));
    assert!(scores.position_rms_m < 0.9e-3);
    assert!((0.8..1.3).contains(&scores.anees));
    let smoothed = smoothed(&drive_lap(Some(camera), 0), &config());
    let share = smoothed.fixes_rejected as f64 / (smoothed.fixes_used + smoothed.fixes_rejected) as f64;
    assert!((0.05..0.16).contains(&share), "{share}");
}

#[test]
fn without_a_camera_a_lap_has_the_covariance_that_it_claims() {
    let scores = compare("no camera", &config(), 20, |seed| drive_lap(None, seed));
    assert!((0.6..1.4).contains(&scores.anees));
    assert!(scores.position_rms_m < 1.03 * scores.filter_position_rms_m, "it does no harm");
}

#[test]
fn hindsight_bridges_a_blind_stretch_from_both_ends() {
    let scores = compare("blind", &config(), 10, |seed| {
        let mut drive = drive_lap(Some(CAMERA_10_HZ), seed);
        let blind: Range<_> = stamp(200)..stamp(1_000);
        drive.arrivals.retain(|arrival| {
            arrival.observation.sensor != SensorId::CAMERA || !blind.contains(&arrival.observation.stamp)
        });
        drive
    });
    assert!(scores.position_rms_m < 0.6 * scores.filter_position_rms_m);
    assert!((0.7..1.4).contains(&scores.anees));
}

/// Where the camera sits that sights landmarks, which the robot is not told: m, m, rad.
const MOUNTED: [f64; 3] = [0.06, -0.03, 0.08];

#[test]
fn landmarks_from_a_camera_that_sits_somewhere_give_an_honest_path_and_the_mounting() {
    let mut config = furnished(&config());
    let mounting = &mut config.calibration.mountings[MountedSensor::Landmarks];
    (mounting.x_m, mounting.y_m, mounting.yaw_rad) = (unknown(0.05), unknown(0.05), unknown(0.1));
    let mut nees = [0.0; 3];
    let make = |seed| {
        let mut drive = drive_lap(None, seed);
        let mut senses = SimulatedSensors::new(&config, seed);
        add(&mut drive, SensorId::LANDMARKS, 4, |_, (x, y, heading)| {
            let (sin, cos) = f64::sin_cos(heading);
            let [forward, left, yaw] = MOUNTED;
            senses.landmarks((x + cos * forward - sin * left, y + sin * forward + cos * left, heading + yaw))
        });
        drive
    };
    let scores = compare("landmarks, unknown mounting", &config, 20, make);
    assert!(scores.position_rms_m < 0.9 * scores.filter_position_rms_m);
    // 99.9 % of chi-square with 60 degrees of freedom, for the pose of 20 runs.
    assert!((0.53..1.66).contains(&scores.anees), "{}", scores.anees);
    for seed in 0..20 {
        let found = smoothed(&make(seed), &config).calibration.mountings[MountedSensor::Landmarks];
        for (sum, (known, truth)) in nees.iter_mut().zip([found.x_m, found.y_m, found.yaw_rad].into_iter().zip(MOUNTED))
        {
            *sum += ((known.value - truth) / known.sigma).powi(2) / 20.0;
        }
    }
    println!("mounting: NEES {nees:.2?}");
    // 20 runs: chi-square with 20 degrees of freedom, 99.9 %.
    assert!(nees.iter().all(|nees| (0.26..2.27).contains(nees)), "{nees:?}");
}

#[test]
fn beacons_with_unknown_offsets_give_an_honest_path() {
    let mut config = furnished(&config());
    config.calibration.beacon_offset_m = unknown(0.3);
    config.calibration.beacon_scale = unknown(0.02);
    let scores = compare("beacons", &config, 20, |seed| {
        let mut drive = drive_lap(None, seed);
        let mut senses = SimulatedSensors::new(&config, seed);
        let errors = [(0.25, 0.01), (-0.1, 0.02), (0.4, -0.01), (0.0, 0.0)];
        add(&mut drive, SensorId::BEACONS, 4, |_, truth| senses.beacons(truth, &errors));
        drive
    });
    assert!(scores.position_rms_m < 0.9 * scores.filter_position_rms_m);
    assert!((0.53..1.66).contains(&scores.anees), "{}", scores.anees);
}

#[test]
fn the_filter_does_not_beat_the_bound_and_comes_near_it() {
    let (mut squares_m2, mut bounds_m2) = (0.0, 0.0);
    for seed in 0..20 {
        let drive = drive_lap(Some(CAMERA_10_HZ), seed);
        squares_m2 += score(&drive, &play(&drive, &config()), 0).position_rms_m.powi(2);
        let bounds = bound_of(&drive, &config());
        bounds_m2 += bounds.iter().sum::<f64>() / bounds.len() as f64;
    }
    let ratio = f64::sqrt(squares_m2 / bounds_m2);
    println!("bound {:.3} mm, error over bound {ratio:.3}", 1e3 * f64::sqrt(bounds_m2 / 20.0));
    assert!((0.95..1.15).contains(&ratio), "{ratio}");
}

/// The bound of a drive, with its own fixes and their delays.
fn bound_of(drive: &Drive, config: &FilterConfig) -> Vec<f64> {
    let mut poses = vec![Pose::<Arena>::default()];
    poses
        .extend(drive.poses.iter().map(|&(x, y, heading)| Pose::new(Meters(x), Meters(y), Heading::from_rad(heading))));
    let mut travel = vec![];
    let mut last = (0.0, 0.0);
    let mut observations = vec![];
    for arrival in &drive.arrivals {
        let observation = &arrival.observation;
        if let ObservationKind::WheelAngles { left, right } = observation.measurement {
            travel.push(WheelTravel { left_m: RADIUS_M * (left.0 - last.0), right_m: RADIUS_M * (right.0 - last.1) });
            last = (left.0, right.0);
        } else if observation.sensor == SensorId::CAMERA {
            let exposure_step = (observation.stamp.as_secs_f64() / STEP_S).round() as usize;
            observations.push(ArrivedObservation {
                exposure_step,
                arrival_step: arrival.step,
                sensor: SensorId::CAMERA,
                measurement: observation.measurement,
            });
        }
    }
    cramer_rao_bound(
        config,
        &GroundTruthRun { poses: &poses, travel: &travel, step_s: STEP_S, observations: &observations },
    )
}

/// Whether two poses and covariances are the same but for rounding.
fn are_equal(own: &SmoothedPose, other: &SmoothedPose) -> bool {
    let largest = (0..3).map(|row| other.covariance[row][row]).fold(0.0, f64::max);
    let apart = own.covariance.iter().flatten().zip(other.covariance.iter().flatten()).map(|(a, b)| (a - b).abs());
    own.stamp == other.stamp
        && own.pose.origin().distance(other.pose.origin()).0 < 1e-8
        && (own.pose.heading - other.pose.heading).0.abs() < 1e-8
        && apart.fold(0.0, f64::max) < 1e-6 * largest
}

#[test]
fn with_a_lag_it_is_between_the_filter_and_the_smoother() {
    let mut drive = drive_lap(Some(CAMERA_10_HZ), 3);
    drive.poses.truncate(STEPS);
    drive.arrivals.retain(|arrival| arrival.observation.stamp <= stamp(STEPS));
    let observations = drive.observations();
    let lagged = |lag| smooth_fixed_lag(&config(), &observations, lag).expect("it moves").poses;
    // Beyond the run: the way back of the first pass.
    let whole = smooth_in_passes(&config(), &observations, 1).expect("it moves").poses;
    let beyond = lagged(TimeDelta::from_millis(1_000_000));
    assert_eq!(whole.len(), beyond.len());
    assert!(whole.iter().zip(&beyond).all(|(own, other)| are_equal(own, other)));
    // Without a lag: the filter, to which the encoders' rounding is no error.
    let now = lagged(TimeDelta::ZERO);
    let filter = played::<CORE_STATES>(&drive, &config());
    let (state, last) = (filter.state(), now.last().expect("it moved"));
    let rounding_rad2 = (RADIUS_M * DEGREE / TRACK_M).powi(2) / 6.0;
    let published = state.published_covariance();
    assert!((last.pose.x.0 - state.pose.x_m).hypot(last.pose.y.0 - state.pose.y_m) < 1e-9);
    assert!((last.covariance[2][2] - published[2][2] - rounding_rad2).abs() < 1e-9 * rounding_rad2);
    // Between: the more it waits the better.
    let rms_m = |poses: &[SmoothedPose]| {
        let errors = poses.iter().filter(|at| at.stamp > stamp(0)).map(|at| {
            let step = ((at.stamp - stamp(0)).as_secs_f64() / STEP_S).round() as usize;
            (at.pose.x.0 - drive.poses[step - 1].0).powi(2) + (at.pose.y.0 - drive.poses[step - 1].1).powi(2)
        });
        (errors.sum::<f64>() / poses.len() as f64).sqrt()
    };
    let second = lagged(TimeDelta::from_millis(1_000));
    println!("lag 0, 1 s, all: {:.3} {:.3} {:.3} mm", 1e3 * rms_m(&now), 1e3 * rms_m(&second), 1e3 * rms_m(&whole));
    assert!(rms_m(&second) < 0.9 * rms_m(&now) && rms_m(&whole) < 1.02 * rms_m(&second));
    assert_eq!(second.len(), whole.len());
}

#[test]
fn a_robot_that_is_carried_is_where_it_was_put_before_the_filter_knows() {
    let mut drive = drive_lap(Some(CAMERA_10_HZ), 5);
    let put_down = stamp(400);
    for arrival in drive.arrivals.iter_mut().filter(|arrival| arrival.observation.stamp > put_down) {
        if let ObservationKind::Fix(fix) = &mut arrival.observation.measurement {
            fix.position.x.0 += 2.0;
        }
    }
    for truth in &mut drive.poses[400..] {
        truth.0 += 2.0;
    }
    let played = play(&drive, &config());
    let off_m = |x_m: f64, step: usize| (x_m - drive.poses[step - 1].0).abs();
    let late = played.estimates[440].expect("it moves");
    assert!(off_m(late.pose.x.0, 441) > 1.0, "the filter waits");
    let smoothed = smoothed(&drive, &config());
    for step in [380, 399, 410, 441, 600] {
        let off_m = off_m(at_step(&smoothed, step).pose.x.0, step);
        assert!(off_m < 0.02, "step {step}: {off_m}");
    }
}

/// The first 30 s of a lap, a turn included.
const STEPS: usize = 600;

fn half_a_lap(camera: Option<Camera>) -> Drive {
    let mut drive = drive_lap(camera, 3);
    drive.poses.truncate(STEPS);
    drive.arrivals.retain(|arrival| arrival.observation.stamp <= stamp(STEPS));
    drive
}

fn with_camera() -> Drive {
    half_a_lap(Some(Camera { every: 2, delay: 0, spread: 0, outliers: 0.05 }))
}

fn is_fix(observation: &Observation) -> bool {
    observation.sensor == SensorId::CAMERA
}

/// With a second fix of the same camera and a foreign odometer at the same instants; then each once more, backwards.
#[test]
fn the_order_of_the_observations_and_copies_do_not_matter_bit_for_bit() {
    let plain = with_camera().observations();
    let mut all = plain.clone();
    for one in &plain {
        if let ObservationKind::Fix(mut fix) = one.measurement {
            fix.position.x.0 += 0.004;
            all.push(Observation { measurement: ObservationKind::Fix(fix), ..*one });
        } else if let ObservationKind::WheelAngles { left, .. } = one.measurement {
            let (forward, turn) = (MetersPerSecond(left.0.sin()), RadiansPerSecond(0.0));
            let measurement = ObservationKind::BodyVelocity { forward, turn };
            all.push(Observation { sensor: SensorId::ODOMETER, measurement, ..*one });
        }
    }
    let mut rng = Pcg64::seed_from_u64(1);
    let in_order = smooth(&config(), &all).unwrap();
    let mut keyed: Vec<(u64, Observation)> = all.iter().map(|one| (rng.random(), *one)).collect();
    keyed.sort_by_key(|one| one.0);
    let shuffled: Vec<Observation> = keyed.into_iter().map(|one| one.1).collect();
    assert!(smooth(&config(), &shuffled).unwrap() == in_order);
    let twice: Vec<Observation> = all.iter().rev().chain(&all).copied().collect();
    assert!(smooth(&config(), &twice).unwrap() == in_order, "twice");
}

#[test]
fn what_is_damaged_or_of_no_use_changes_nothing() {
    let all = with_camera().observations();
    let mut dirty = all.clone();
    for observation in all.iter().step_by(7) {
        for measurement in [
            ObservationKind::TurnRate(RadiansPerSecond(f64::NAN)),
            ObservationKind::WheelAngles { left: Radians(f64::INFINITY), right: Radians(1e300) },
        ] {
            dirty.push(Observation { measurement, ..*observation });
        }
        dirty.push(Observation { stamp: Timestamp::from_nanos(i64::MAX), ..*observation });
        dirty.push(Observation { stamp_sigma: TimeDelta::from_nanos(-1), ..*observation });
    }
    assert!(smooth(&config(), &dirty).unwrap() == smooth(&config(), &all).unwrap());
}

#[test]
fn without_motion_or_without_any_position_there_is_nothing_to_smooth() {
    let others: Vec<Observation> = with_camera().observations().into_iter().filter(|one| !is_fix(one)).collect();
    for (config, observations) in [(config(), &vec![]), (without_start(), &others)] {
        assert!(matches!(smooth(&config, observations), Err(OfflineError::NothingObserved { .. })));
    }
}

#[test]
fn a_configuration_that_is_no_number_is_refused() {
    let all = with_camera().observations();
    let mut configs = [config(), config(), config(), config()];
    configs[0].geometry.track_width = Meters(0.0);
    configs[1].noise.wheel_travel_m_per_sqrt_m = f64::NAN;
    configs[2].calibration.track_scale.sigma = f64::INFINITY;
    configs[3].start.as_mut().unwrap().heading_sigma_rad = f64::NAN;
    for config in &configs {
        assert_eq!(smooth(config, &all), Err(OfflineError::NotFinite));
    }
}

fn position_rms_m(drive: &Drive, smoothed: &SmoothedTrajectory) -> f64 {
    let [squares_m2, ..] = squares(smoothed, drive);
    squares_m2.sqrt()
}

#[test]
fn a_configuration_without_noise_gives_a_path_nevertheless() {
    let mut exact = config();
    exact.noise = posebridge_telemetry::SensorNoise::EXACT;
    let drive = half_a_lap(None);
    let end = at_step(&smoothed(&drive, &exact), STEPS).pose;
    let truth = drive.poses[STEPS - 1];
    assert!((end.x.0 - truth.0).hypot(end.y.0 - truth.1) < 0.2);
}

#[test]
fn a_delay_of_the_fixes_and_a_shifted_tag_are_found() {
    let drive = with_camera();
    let mut all = drive.observations();
    let tag = (0.04, -0.03);
    each_fix(&mut all, |fix| {
        let (sin, cos) = fix.heading.expect("this camera sees it").rad().sin_cos();
        fix.position.x.0 += cos * tag.0 - sin * tag.1;
        fix.position.y.0 += sin * tag.0 + cos * tag.1;
    });
    for observation in all.iter_mut().filter(|observation| is_fix(observation)) {
        observation.stamp = observation.stamp + TimeDelta::from_millis(83);
    }
    let mut config = config();
    config.calibration.fix_delay_s.sigma = 0.1;
    config.calibration.tag_forward_m.sigma = 0.05;
    config.calibration.tag_left_m.sigma = 0.05;
    let smoothed = smooth(&config, &all).unwrap();
    let found = &smoothed.calibration;
    for (what, known, truth) in [
        ("delay", found.fix_delay_s, 0.083),
        ("forward", found.tag_forward_m, tag.0),
        ("left", found.tag_left_m, tag.1),
    ] {
        assert!((known.value - truth).abs() < 4.0 * known.sigma, "{what} {known:?}");
        assert!(known.sigma < 0.005, "{what} {known:?}");
    }
    assert!(position_rms_m(&drive, &smoothed) < 2e-3);
}

#[test]
fn an_unknown_start_is_found_from_positions_alone() {
    let drive = with_camera();
    for turned_deg in [0.0, 75.0, 180.0, -100.0] {
        let mut all = drive.observations();
        let (sin, cos) = f64::to_radians(turned_deg).sin_cos();
        each_fix(&mut all, |fix| {
            let (x, y) = (fix.position.x.0, fix.position.y.0);
            fix.heading = None;
            fix.position = Point2::new(Meters(cos * x - sin * y + 5.0), Meters(sin * x + cos * y - 2.0));
        });
        let smoothed = smooth(&without_start(), &all).unwrap();
        let (last, truth) = (at_step(&smoothed, STEPS), drive.poses[STEPS - 1]);
        let expected = (cos * truth.0 - sin * truth.1 + 5.0, sin * truth.0 + cos * truth.1 - 2.0);
        let error_m = (last.pose.x.0 - expected.0).hypot(last.pose.y.0 - expected.1);
        let heading_rad = wrap_rad(last.pose.heading.rad() - truth.2 - f64::to_radians(turned_deg));
        assert!(error_m < 0.01, "{turned_deg} degrees: {error_m} m");
        assert!(heading_rad.abs() < 2.0 * DEGREE, "{turned_deg}: {heading_rad} rad");
    }
}

#[test]
fn a_start_that_all_fixes_contradict_gives_an_answer_and_not_a_panic() {
    let all = with_camera().observations();
    let mut misplaced = config();
    let start = misplaced.start.as_mut().unwrap();
    start.pose = Pose::new(Meters(1.0), Meters(-3.0), Heading::from_rad(0.3));
    (start.position_sigma_m, start.heading_sigma_rad) = (0.1, 0.1);
    let smoothed = smooth(&misplaced, &all).unwrap();
    let right = smooth(&config(), &all).unwrap();
    assert!(smoothed.fixes_used * 10 > right.fixes_used * 9);
    let (own, other) = (at_step(&smoothed, STEPS).pose, at_step(&right, STEPS).pose);
    assert!(own.origin().distance(other.origin()).0 < 5e-3);
}

#[test]
fn counters_that_restart_leave_a_gap_that_fixes_close() {
    let drive = with_camera();
    let mut all = drive.observations();
    // The brick counts on from zero and is silent for a second before.
    all.retain(|one| is_fix(one) || !(stamp(300)..stamp(320)).contains(&one.stamp));
    for observation in all.iter_mut().filter(|observation| observation.stamp >= stamp(320)) {
        if let ObservationKind::WheelAngles { left, right } = &mut observation.measurement {
            (left.0, right.0) = (left.0 - 900.0, right.0 + 800.0);
        }
    }
    let smoothed = smooth(&config(), &all).unwrap();
    let (after, truth) = (at_step(&smoothed, 320), drive.poses[319]);
    let error_m = (after.pose.x.0 - truth.0).hypot(after.pose.y.0 - truth.1);
    assert!(error_m < 0.02, "{error_m}");
    all.retain(|one| !is_fix(one));
    let unseen = smooth(&config(), &all).unwrap();
    let [before, after] = [299, 320].map(|step| {
        let covariance = at_step(&unseen, step).covariance;
        (covariance[0][0] + covariance[1][1]).sqrt()
    });
    assert!(before < 0.05 && after > 0.3, "{before} {after}");
}

#[test]
fn a_robot_at_rest_is_one_pose_and_its_gyro_determines_the_bias() {
    let mut all = half_a_lap(None).observations();
    all.retain(|one| one.stamp <= stamp(40));
    let smoothed = smooth(&config(), &all).unwrap();
    let first = smoothed.poses[0];
    let same = |own: &SmoothedPose| are_equal(&SmoothedPose { stamp: first.stamp, ..*own }, &first);
    assert!(smoothed.poses.iter().all(same));
    let bias = smoothed.calibration.gyro_bias_rad_per_s;
    assert!(bias.sigma < 0.2 * config().noise.gyro_bias_rad_per_s, "{bias:?}");
}

#[test]
fn a_foreign_odometer_and_held_speeds_move_the_robot_as_wheels_do() {
    let (d, turn) = (0.115 * RADIUS_M, 0.03 * RADIUS_M / TRACK_M);
    let mut pose = Pose::<Odom>::new(Meters(7.0), Meters(1.0), Heading::from_rad(2.0));
    let mut kinds = [vec![], vec![], vec![]];
    for k in 0..=100_i64 {
        let wheels = ObservationKind::WheelAngles { left: Radians(0.1 * k as f64), right: Radians(0.13 * k as f64) };
        let speeds =
            ObservationKind::BodyVelocity { forward: MetersPerSecond(d / 0.05), turn: RadiansPerSecond(turn / 0.05) };
        for (kind, measurement) in [wheels, ObservationKind::OdometerPose(pose), speeds].into_iter().enumerate() {
            kinds[kind].push(crate::support::observe::at(50 * k, SensorId::ODOMETER, measurement));
        }
        // The same rotation and shift, in the odometer's own space.
        let chord = d * (0.5 * turn).sin() / (0.5 * turn);
        let middle_rad = pose.heading.rad() + 0.5 * turn;
        pose = Pose::new(
            Meters(pose.x.0 + chord * middle_rad.cos()),
            Meters(pose.y.0 + chord * middle_rad.sin()),
            Heading::from_rad(pose.heading.rad() + turn),
        );
    }
    let ends = kinds.map(|kind| *smooth(&config(), &kind).expect("it converges").poses.last().expect("it moved"));
    for end in &ends[1..] {
        assert!(end.pose.origin().distance(ends[0].pose.origin()).0 < 1e-6);
        assert!((end.pose.heading - ends[0].pose.heading).0.abs() < 1e-6);
        assert!((end.covariance[0][0] / ends[0].covariance[0][0] - 1.0).abs() < 1e-3);
    }
    assert!(ends[0].pose.x.0.hypot(ends[0].pose.y.0) > 0.3);
}
