//! The constants of a robot, learned while it drives: wheels, track, gyro bias, the camera's delay and the tag's place.

use std::f64::consts::FRAC_PI_2;

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::state::{CAMERA_STATES, CORE_STATES, DIFFERENCE, RADIUS, TRACK};
use posebridge_estimator::{Filter, FilterConfig, find_filter};
use posebridge_telemetry::{
    Calibration, DriveGeometry, Meters, Observation, ObservationKind, SensorId, TimeDelta, UncertainValue,
};

use crate::alter::{altered, camera_10_hz, driven};
use crate::drive::{Camera, Drive, RobotSimulation, STEP_S, drive};
use crate::robot::{NOISE, RADIUS_M, TRACK_M, config};

/// How wrong the geometry may be, one standard deviation each: mean radius, difference of radii, track.
const SPREAD: [f64; 3] = [0.005, 0.005, 0.03];

fn unknown(sigma: f64) -> UncertainValue {
    UncertainValue { value: 0.0, sigma }
}

fn learning() -> FilterConfig {
    FilterConfig {
        calibration: Calibration {
            radius_scale: unknown(SPREAD[0]),
            radius_difference: unknown(SPREAD[1]),
            track_scale: unknown(SPREAD[2]),
            ..Calibration::default()
        },
        ..config()
    }
}

/// Two minutes of straights and turns in place, to the left and to the right.
fn course() -> Vec<(f64, f64)> {
    let mut steps = vec![(0.0, 0.0); 40];
    for leg in 0..12 {
        let quarter = if leg % 3 == 2 { -FRAC_PI_2 } else { FRAC_PI_2 };
        steps.extend([(0.2 * STEP_S, 0.0); 140]);
        steps.extend([(0.0, quarter / 40.0); 40]);
    }
    steps
}

const CAMERA: Camera = Camera { every: 2, delay: 3, spread: 1, outliers: 0.0 };

/// A drive of a robot whose geometry is drawn, with the true constants: radius scale, difference, track scale, bias at the end.
fn drawn(camera: Option<Camera>, seed: u64) -> (Drive, [f64; 4]) {
    let mut world = RobotSimulation::new(seed);
    let [mean, difference, track] = SPREAD.map(|sigma| sigma * world.normal());
    world.geometry = DriveGeometry {
        left_wheel_radius: Meters(RADIUS_M * (1.0 + mean - 0.5 * difference)),
        right_wheel_radius: Meters(RADIUS_M * (1.0 + mean + 0.5 * difference)),
        track_width: Meters(TRACK_M * (1.0 + track)),
        ..world.geometry
    };
    let drive = driven(&mut world, course(), camera);
    (drive, [mean, difference, track, world.bias_rad_per_s])
}

fn played<const N: usize>(config: &FilterConfig, drive: &Drive) -> PoseFilter<N> {
    let mut filter = PoseFilter::<N>::new(config);
    for arrival in &drive.arrivals {
        filter.observe(&arrival.observation);
    }
    filter
}

fn of_robot(calibration: &Calibration) -> [UncertainValue; 4] {
    [calibration.radius_scale, calibration.radius_difference, calibration.track_scale, calibration.gyro_bias_rad_per_s]
}

/// Chi-square with 40 and with 120 degrees of freedom, 0.05 % on either side, divided by these.
const BAND_OF_40: std::ops::Range<f64> = 0.42..1.905;
const BAND_OF_120: std::ops::Range<f64> = 0.628..1.481;

#[test]
fn with_a_camera_the_constants_are_learned_as_well_as_is_claimed() {
    let names = ["radius_scale", "radius_difference", "track_scale", "gyro_bias"];
    let mut nees = [0.0; 4];
    let mut sigmas = [0.0; 4];
    for seed in 0..120 {
        let (drive, truth) = drawn(Some(CAMERA), seed);
        let filter = played::<CORE_STATES>(&learning(), &drive);
        let found = of_robot(&filter.calibration().unwrap());
        for (i, known) in found.into_iter().enumerate() {
            let error = known.value - truth[i];
            assert!(error.abs() < 4.0 * known.sigma, "seed {seed}, {}: {error} of {}", names[i], known.sigma);
            nees[i] += (error / known.sigma).powi(2) / 120.0;
            sigmas[i] = known.sigma;
        }
    }
    for i in 0..4 {
        println!("{}: NEES {:.2}, sigma {:.2e}", names[i], nees[i], sigmas[i]);
        assert!(BAND_OF_120.contains(&nees[i]), "{}: {}", names[i], nees[i]);
    }
    // They are learned: a tenth of what was known before, and better.
    for i in 0..3 {
        assert!(sigmas[i] < 0.25 * SPREAD[i], "{}: {}", names[i], sigmas[i]);
    }
}

#[test]
fn what_is_given_for_certain_stays_as_it_was_given() {
    let mut given = config();
    given.calibration.radius_scale.value = 0.004;
    given.calibration.track_scale.value = -0.01;
    for seed in 0..3 {
        let (drive, _) = drawn(Some(CAMERA), seed);
        let filter = played::<CORE_STATES>(&given, &drive);
        let found = filter.calibration().unwrap();
        let exactly = |value| UncertainValue { value, sigma: 0.0 };
        assert_eq!(found.radius_scale, exactly(0.004));
        assert_eq!(found.radius_difference, exactly(0.0));
        assert_eq!(found.track_scale, exactly(-0.01));
        let p = filter.state().covariance;
        for row in [RADIUS, DIFFERENCE, TRACK] {
            assert_eq!(p.row(row).amax(), 0.0, "row {row} is certain");
        }
    }
}

#[test]
fn without_fixes_what_was_learned_is_kept_and_does_not_grow_uncertain() {
    let (drive, _) = drawn(Some(CAMERA), 5);
    let blind_from = 700;
    let drive = altered(drive, |observation| {
        let is_blind = observation.stamp >= crate::drive::stamp(blind_from);
        (observation.sensor != SensorId::CAMERA || !is_blind).then_some(observation)
    });
    let mut filter = PoseFilter::<CORE_STATES>::new(&learning());
    let mut before = None;
    for arrival in &drive.arrivals {
        filter.observe(&arrival.observation);
        // Three seconds after the last fix nothing tells of wear any longer.
        if arrival.step == blind_from + 60 {
            before = filter.calibration();
        }
    }
    let (before, after) = (before.unwrap(), filter.calibration().unwrap());
    for (before, after) in of_robot(&before).into_iter().zip(of_robot(&after)).take(3) {
        assert!(before.sigma > 0.0);
        assert!(after.sigma <= before.sigma * (1.0 + 1e-9), "{before:?} {after:?}");
        let moved = (after.value - before.value).abs();
        assert!(moved < 2.0 * before.sigma, "{before:?} {after:?}");
    }
}

#[test]
fn a_restart_of_the_bricks_clock_keeps_what_was_learned_about_the_robot() {
    let (drive, _) = drawn(Some(CAMERA), 6);
    let mut camera = learning();
    camera.calibration.fix_delay_s = unknown(0.1);
    camera.calibration.tag_forward_m = unknown(0.03);
    let mut filter = played::<CAMERA_STATES>(&camera, &drive);
    let before = filter.calibration().unwrap();
    filter.restart_clock();
    let after = filter.calibration().unwrap();
    let but_bias = Calibration { gyro_bias_rad_per_s: before.gyro_bias_rad_per_s, ..after };
    assert_eq!(but_bias, before);
    // The gyro warms up anew.
    assert_eq!(after.gyro_bias_rad_per_s, unknown(NOISE.gyro_bias_rad_per_s));
}

/// Fixes that carry a stamp which is `late` after the instant that they show, of a tag that is not where they say.
pub(crate) fn delayed(drive: Drive, late: TimeDelta, (forward_m, left_m): (f64, f64)) -> Drive {
    let poses = drive.poses.clone();
    altered(drive, |observation| {
        let ObservationKind::Fix(mut fix) = observation.measurement else {
            return Some(observation);
        };
        let step = crate::alter::step_of(&observation);
        let (sin, cos) = poses[step - 1].2.sin_cos();
        fix.position.x += Meters(cos * forward_m - sin * left_m);
        fix.position.y += Meters(sin * forward_m + cos * left_m);
        Some(Observation { stamp: observation.stamp + late, measurement: ObservationKind::Fix(fix), ..observation })
    })
}

#[test]
fn delay_and_lever_are_learned_as_well_as_is_claimed() {
    let truth = [0.15, 0.03, -0.02];
    let names = ["fix_delay_s", "tag_forward_m", "tag_left_m"];
    let mut told = config();
    told.calibration.fix_delay_s = unknown(0.15);
    told.calibration.tag_forward_m = unknown(0.03);
    told.calibration.tag_left_m = unknown(0.03);
    let (mut nees, mut sigmas) = ([0.0; 3], [0.0; 3]);
    for seed in 0..40 {
        let mut world = RobotSimulation::new(seed);
        let drive = driven(&mut world, course(), Some(Camera { delay: 4, ..CAMERA }));
        let late = TimeDelta::from_millis(150);
        let drive = delayed(drive, late, (truth[1], truth[2]));
        let calibration = played::<CAMERA_STATES>(&told, &drive).calibration().unwrap();
        let found = [calibration.fix_delay_s, calibration.tag_forward_m, calibration.tag_left_m];
        for (i, known) in found.into_iter().enumerate() {
            let error = known.value - truth[i];
            nees[i] += (error / known.sigma).powi(2) / 40.0;
            sigmas[i] = known.sigma;
            println!("seed {seed} {}: {error:.5} of {:.5}", names[i], known.sigma);
        }
    }
    for i in 0..3 {
        println!("{}: NEES {:.2}, sigma {:.2e}", names[i], nees[i], sigmas[i]);
        assert!(BAND_OF_40.contains(&nees[i]), "{}: {}", names[i], nees[i]);
    }
    assert!(sigmas[0] < 0.01 && sigmas[1] < 0.003 && sigmas[2] < 0.003);
}

#[test]
fn the_filter_in_the_table_has_as_many_states_as_are_asked_for() {
    let drive = drive(&camera_10_hz(), 1);
    let mut asked = config();
    asked.calibration.fix_delay_s = unknown(0.1);
    let mut filter = (find_filter("pose").unwrap().build)(&asked);
    for arrival in drive.arrivals.iter().take(1_000) {
        filter.observe(&arrival.observation);
    }
    let found = filter.calibration().unwrap();
    assert!(found.fix_delay_s.sigma < 0.05, "{found:?}");
    assert_eq!(found.tag_forward_m, UncertainValue::default());
    let plain = (find_filter("pose").unwrap().build)(&config());
    assert_eq!(plain.calibration().unwrap().fix_delay_s, UncertainValue::default());
}
