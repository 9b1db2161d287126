//! What the batch solution makes of disorder, damage, holes and of things that it was not told.

#[path = "support/drive.rs"]
mod drive;
#[path = "support/robot.rs"]
mod robot;

use drive::{Camera, Drive, Scenario, drive, stamp};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::smoother::{OfflineError, SmoothedTrajectory, batch};
use posebridge_telemetry::{
    Heading, Meters, MetersPerSecond, Observation, ObservationKind, Odom, Point2, Pose, Radians, RadiansPerSecond,
    SensorId, TimeDelta, Timestamp, quantities::wrap_rad,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use robot::{DEGREE, RADIUS_M, TRACK_M, config};

const CAMERA: Camera = Camera { every: 2, delay: 0, spread: 0, outliers: 0.05 };

/// The first 30 s of a lap, a turn included.
const STEPS: usize = 600;

fn lap(camera: Option<Camera>) -> Drive {
    let mut drive = drive(&Scenario { laps: 1, camera }, 3);
    drive.poses.truncate(STEPS);
    drive.arrivals.retain(|arrival| arrival.observation.stamp <= stamp(STEPS));
    drive
}

fn observations(drive: &Drive) -> Vec<Observation> {
    let arrivals = drive.arrivals.iter();
    arrivals.map(|arrival| arrival.observation).collect()
}

fn position_rms_m(drive: &Drive, smoothed: &SmoothedTrajectory) -> f64 {
    let pairs = smoothed.poses.iter().zip(&drive.poses);
    let squares: f64 =
        pairs.map(|(own, truth)| (own.pose.x.0 - truth.0).powi(2) + (own.pose.y.0 - truth.1).powi(2)).sum();
    (squares / drive.poses.len() as f64).sqrt()
}

fn position_sigma_m(smoothed: &SmoothedTrajectory, reading: usize) -> f64 {
    let covariance = smoothed.poses[reading].covariance;
    (covariance[0][0] + covariance[1][1]).sqrt()
}

/// Changes every fix of a run.
fn each_fix(all: &mut [Observation], mut change: impl FnMut(&mut Observation)) {
    let fixes = all.iter_mut().filter(|observation| matches!(observation.measurement, ObservationKind::Fix(_)));
    fixes.for_each(&mut change);
}

#[test]
fn the_order_of_the_observations_does_not_matter_bit_for_bit() {
    let all = observations(&lap(Some(CAMERA)));
    let in_order = batch(&config(), &all).unwrap();
    let mut rng = Pcg64::seed_from_u64(1);
    for _ in 0..3 {
        let mut keyed: Vec<(u64, Observation)> = all.iter().map(|one| (rng.random(), *one)).collect();
        keyed.sort_by_key(|one| one.0);
        let shuffled: Vec<Observation> = keyed.into_iter().map(|one| one.1).collect();
        assert_eq!(batch(&config(), &shuffled).unwrap(), in_order);
    }
}

#[test]
fn what_is_damaged_repeated_or_of_no_use_changes_nothing() {
    let all = observations(&lap(Some(CAMERA)));
    let clean = batch(&config(), &all).unwrap();
    let mut dirty = all.clone();
    for observation in all.iter().step_by(7) {
        dirty.push(*observation);
        let mut damaged = *observation;
        damaged.measurement = ObservationKind::TurnRate(RadiansPerSecond(f64::NAN));
        dirty.push(damaged);
        damaged.measurement = ObservationKind::WheelAngles { left: Radians(f64::INFINITY), right: Radians(1e300) };
        dirty.push(damaged);
        damaged.measurement = ObservationKind::WallRange(Meters(1.0));
        dirty.push(damaged);
        damaged = *observation;
        damaged.stamp = Timestamp::from_nanos(i64::MAX);
        dirty.push(damaged);
        damaged.stamp_sigma = TimeDelta::from_nanos(-1);
        dirty.push(damaged);
    }
    assert_eq!(batch(&config(), &dirty).unwrap(), clean);
}

#[test]
fn without_motion_or_without_any_place_there_is_nothing_to_smooth() {
    let all = observations(&lap(Some(CAMERA)));
    let unplaced = FilterConfig { start: None, ..config() };
    let (fixes, others): (Vec<Observation>, Vec<Observation>) =
        all.iter().partition(|one| matches!(one.measurement, ObservationKind::Fix(_)));
    let mut fixed_later = others.clone();
    fixed_later
        .extend(fixes.iter().map(|fix| Observation { stamp: fix.stamp + TimeDelta::from_millis(1_000_000), ..*fix }));
    for (config, observations) in
        [(config(), vec![]), (config(), fixes), (unplaced.clone(), others), (unplaced, fixed_later)]
    {
        let error = batch(&config, &observations).unwrap_err();
        assert!(matches!(error, OfflineError::NothingObserved { .. }));
    }
}

#[test]
fn a_configuration_that_is_no_number_is_refused() {
    let all = observations(&lap(Some(CAMERA)));
    let mut no_track = config();
    no_track.geometry.track_width = Meters(0.0);
    let mut no_noise = config();
    no_noise.noise.wheel_travel_m_per_sqrt_m = f64::NAN;
    let mut no_prior = config();
    no_prior.calibration.track_scale.sigma = f64::INFINITY;
    let mut no_start = config();
    no_start.start.as_mut().unwrap().heading_sigma_rad = f64::NAN;
    for config in [no_track, no_noise, no_prior, no_start] {
        assert_eq!(batch(&config, &all), Err(OfflineError::NotFinite));
    }
}

#[test]
fn a_robot_that_is_told_no_noise_at_all_has_a_path_nevertheless() {
    let mut exact = config();
    exact.noise = posebridge_telemetry::SensorNoise::EXACT;
    let drive = lap(None);
    let smoothed = batch(&exact, &observations(&drive)).unwrap();
    assert!(position_rms_m(&drive, &smoothed) < 0.2);
}

#[test]
fn a_delay_of_the_fixes_and_a_shifted_tag_are_found() {
    let drive = lap(Some(CAMERA));
    let mut all = observations(&drive);
    let tag = (0.04, -0.03);
    each_fix(&mut all, |observation| {
        observation.stamp = observation.stamp + TimeDelta::from_millis(83);
        if let ObservationKind::Fix(fix) = &mut observation.measurement {
            let (sin, cos) = fix.heading.expect("this camera sees it").rad().sin_cos();
            fix.position.x.0 += cos * tag.0 - sin * tag.1;
            fix.position.y.0 += sin * tag.0 + cos * tag.1;
        }
    });
    let mut config = config();
    config.calibration.fix_delay_s.sigma = 0.1;
    config.calibration.tag_forward_m.sigma = 0.05;
    config.calibration.tag_left_m.sigma = 0.05;
    let smoothed = batch(&config, &all).unwrap();
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
    let drive = lap(Some(CAMERA));
    let unplaced = FilterConfig { start: None, ..config() };
    for turned_deg in [0.0, 75.0, 180.0, -100.0] {
        let mut all = observations(&drive);
        let (sin, cos) = f64::to_radians(turned_deg).sin_cos();
        each_fix(&mut all, |observation| {
            if let ObservationKind::Fix(fix) = &mut observation.measurement {
                fix.heading = None;
                let (x, y) = (fix.position.x.0, fix.position.y.0);
                fix.position = Point2::new(Meters(cos * x - sin * y + 5.0), Meters(sin * x + cos * y - 2.0));
            }
        });
        let smoothed = batch(&unplaced, &all).unwrap();
        let (last, truth) = (smoothed.poses[STEPS - 1], drive.poses[STEPS - 1]);
        let expected = (cos * truth.0 - sin * truth.1 + 5.0, sin * truth.0 + cos * truth.1 - 2.0);
        let error_m = (last.pose.x.0 - expected.0).hypot(last.pose.y.0 - expected.1);
        let heading_rad = wrap_rad(last.pose.heading.rad() - truth.2 - f64::to_radians(turned_deg));
        assert!(error_m < 0.01, "{turned_deg} degrees: {error_m} m");
        assert!(heading_rad.abs() < 2.0 * DEGREE, "{turned_deg}: {heading_rad} rad");
    }
}

#[test]
fn a_start_that_all_fixes_contradict_gives_an_answer_and_not_a_panic() {
    let all = observations(&lap(Some(CAMERA)));
    let mut misplaced = config();
    let start = misplaced.start.as_mut().unwrap();
    start.pose = Pose::new(Meters(1.0), Meters(-3.0), Heading::from_rad(0.3));
    (start.position_sigma_m, start.heading_sigma_rad) = (0.1, 0.1);
    let smoothed = batch(&misplaced, &all).unwrap();
    let right = batch(&config(), &all).unwrap();
    assert!(smoothed.fixes_used * 10 > right.fixes_used * 9);
    let (own, other) = (smoothed.poses[STEPS - 1].pose, right.poses[STEPS - 1].pose);
    assert!(own.origin().distance(other.origin()).0 < 5e-3);
}

#[test]
fn counters_that_restart_leave_a_gap_that_fixes_close() {
    let drive = lap(Some(CAMERA));
    let mut all = observations(&drive);
    // The brick counts on from zero and is silent for a second before.
    all.retain(|one| {
        matches!(one.measurement, ObservationKind::Fix(_)) || !(stamp(300)..stamp(320)).contains(&one.stamp)
    });
    for observation in &mut all {
        if let ObservationKind::WheelAngles { left, right } = &mut observation.measurement
            && observation.stamp >= stamp(320)
        {
            (left.0, right.0) = (left.0 - 900.0, right.0 + 800.0);
        }
    }
    let smoothed = batch(&config(), &all).unwrap();
    let after = smoothed.poses.iter().position(|pose| pose.stamp == stamp(320)).unwrap();
    let truth = drive.poses[319];
    let error_m = (smoothed.poses[after].pose.x.0 - truth.0).hypot(smoothed.poses[after].pose.y.0 - truth.1);
    assert!(error_m < 0.02, "{error_m}");
    all.retain(|one| !matches!(one.measurement, ObservationKind::Fix(_)));
    let unseen = batch(&config(), &all).unwrap();
    let (before, after) = (position_sigma_m(&unseen, after - 1), position_sigma_m(&unseen, after));
    assert!(before < 0.05 && after > 0.3, "{before} {after}");
}

#[test]
fn a_robot_that_stands_is_one_pose_and_its_gyro_tells_the_bias() {
    let mut all = observations(&lap(None));
    all.retain(|one| one.stamp <= stamp(40));
    let smoothed = batch(&config(), &all).unwrap();
    let first = smoothed.poses[0];
    assert!(smoothed.poses.iter().all(|own| own.pose == first.pose && own.covariance == first.covariance));
    let bias = smoothed.calibration.gyro_bias_rad_per_s;
    assert!(bias.sigma < 0.2 * config().noise.gyro_bias_rad_per_s, "{bias:?}");
}

#[test]
fn a_foreign_odometer_and_held_speeds_move_the_robot_as_wheels_do() {
    let wheels = |k: i64| (0.1 * k as f64, 0.13 * k as f64);
    let (d, turn) = (0.115 * RADIUS_M, 0.03 * RADIUS_M / TRACK_M);
    let mut pose = Pose::<Odom>::new(Meters(7.0), Meters(1.0), Heading::from_rad(2.0));
    let mut kinds = [vec![], vec![], vec![]];
    for k in 0..=100 {
        let (left, right) = wheels(k);
        let speeds =
            ObservationKind::BodyVelocity { forward: MetersPerSecond(d / 0.05), turn: RadiansPerSecond(turn / 0.05) };
        let wheels = ObservationKind::WheelAngles { left: Radians(left), right: Radians(right) };
        for (kind, observed) in [wheels, ObservationKind::OdometerPose(pose), speeds].into_iter().enumerate() {
            kinds[kind].push(Observation {
                sensor: SensorId::ODOMETER,
                stamp: Timestamp::from_millis(50 * k),
                stamp_sigma: TimeDelta::ZERO,
                measurement: observed,
            });
        }
        let chord = d * (0.5 * turn).sin() / (0.5 * turn);
        let step = Pose::<Odom>::new(
            Meters(chord * (0.5 * turn).cos()),
            Meters(chord * (0.5 * turn).sin()),
            Heading::from_rad(turn),
        );
        // The same rotation and shift, in the odometer's own space.
        let (sin, cos) = pose.heading.rad().sin_cos();
        pose = Pose::new(
            Meters(pose.x.0 + cos * step.x.0 - sin * step.y.0),
            Meters(pose.y.0 + sin * step.x.0 + cos * step.y.0),
            Heading::from_rad(pose.heading.rad() + turn),
        );
    }
    let ends = kinds.map(|kind| {
        let smoothed = batch(&config(), &kind).expect("it converges");
        smoothed.poses[100]
    });
    for end in &ends[1..] {
        assert!(end.pose.origin().distance(ends[0].pose.origin()).0 < 1e-6);
        assert!((end.pose.heading - ends[0].pose.heading).0.abs() < 1e-6);
        assert!((end.covariance[0][0] / ends[0].covariance[0][0] - 1.0).abs() < 1e-3);
    }
    assert!(ends[0].pose.x.0.hypot(ends[0].pose.y.0) > 0.3);
}
