//! The constants of a robot, learned while it drives: wheels, track, gyro bias, the camera's delay and the tag's place.

use std::f64::consts::FRAC_PI_2;

use posebridge_estimator::Filter;
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::{
    CORE_STATES, DIFFERENCE, MEDIUM_STATES, RADIUS, SMALL_STATES, TRACK,
};
use posebridge_telemetry::{
    Calibration, MountedSensor, Mounting, ObservationKind, SensorId, TimeDelta, UncertainValue,
};

use crate::support::alter::{altered, with_tag_moved};
use crate::support::filters::named;
use crate::support::robot::{DEGREE, GEOMETRY_SIGMAS, NOISE, config, learning_geometry, unknown};
use crate::support::score::played;
use crate::support::simulation::{
    CAMERA_10_HZ, Camera, Drive, RobotSimulation, STEP_S, SimulatedSensors, add, drive_lap, drive_on_grid, drive_steps,
    furnished, stamp,
};

/// Two minutes of straights and turns in place, to the left and to the right.
fn course() -> Vec<(f64, f64)> {
    course_of(12)
}

fn course_of(legs: usize) -> Vec<(f64, f64)> {
    let mut steps = vec![(0.0, 0.0); 40];
    for leg in 0..legs {
        let quarter = if leg % 3 == 2 { -FRAC_PI_2 } else { FRAC_PI_2 };
        steps.extend([(0.2 * STEP_S, 0.0); 140]);
        steps.extend([(0.0, quarter / 40.0); 40]);
    }
    steps
}

/// A drive of a robot whose geometry is drawn, with the true constants: radius scale, difference, track scale, bias at the end.
fn drawn(seed: u64) -> (Drive, [f64; 4]) {
    let mut world = RobotSimulation::new(seed);
    let [mean, difference, track] = world.draw_geometry();
    let drive = drive_steps(&mut world, course(), Some(CAMERA_10_HZ));
    (drive, [mean, difference, track, world.bias_rad_per_s])
}

fn of_robot(calibration: &Calibration) -> [UncertainValue; 4] {
    [calibration.radius_scale, calibration.radius_difference, calibration.track_scale, calibration.gyro_bias_rad_per_s]
}

/// Chi-square with 40, 120 and 200 degrees of freedom, 0.05 % on either side, divided by these.
const BAND_OF_40: std::ops::Range<f64> = 0.42..1.905;
const BAND_OF_120: std::ops::Range<f64> = 0.628..1.481;
const BAND_OF_200: std::ops::Range<f64> = 0.703..1.362;

/// Every constant must be learned with the error that it claims in each run, and to less than a sigma in the last.
fn check_learned<const N: usize>(
    most: [(&str, f64); N],
    runs: u64,
    band: &std::ops::Range<f64>,
    run: impl Fn(u64) -> [(UncertainValue, f64); N],
) {
    let (mut nees, mut sigmas) = ([0.0; N], [0.0; N]);
    for seed in 0..runs {
        for (i, (known, truth)) in run(seed).into_iter().enumerate() {
            let error = known.value - truth;
            // Five sigmas: of thousands of draws one is beyond four.
            assert!(error.abs() < 5.0 * known.sigma, "seed {seed}, {}: {error} of {}", most[i].0, known.sigma);
            nees[i] += (error / known.sigma).powi(2) / runs as f64;
            sigmas[i] = known.sigma;
        }
    }
    for (i, (name, most)) in most.into_iter().enumerate() {
        println!("{name}: NEES {:.2}, sigma {:.2e}", nees[i], sigmas[i]);
        assert!(band.contains(&nees[i]), "{name}: {}", nees[i]);
        assert!(sigmas[i] < most, "{name}: {}", sigmas[i]);
    }
}

#[test]
fn with_a_camera_the_constants_are_learned_as_well_as_is_claimed() {
    let [radius, difference, track] = GEOMETRY_SIGMAS.map(|sigma| 0.25 * sigma);
    let most =
        [("radius_scale", radius), ("radius_difference", difference), ("track_scale", track), ("gyro_bias", f64::MAX)];
    check_learned(most, 120, &BAND_OF_120, |seed| {
        let (drive, truth) = drawn(seed);
        let found = of_robot(&played::<CORE_STATES>(&drive, &learning_geometry()).calibration().unwrap());
        [0, 1, 2, 3].map(|i| (found[i], truth[i]))
    });
}

/// The sensors on board whose mounting and delay are learned, and how often they measure, in steps.
const ON_BOARD: [(SensorId, MountedSensor, usize); 4] = [
    (SensorId::LANDMARKS, MountedSensor::Landmarks, 10),
    (SensorId::BEACONS, MountedSensor::Beacons, 10),
    (SensorId::RANGE, MountedSensor::Range, 10),
    (SensorId::COMPASS, MountedSensor::Compass, 10),
];
/// All of them arrive so many steps after the instant that they show.
const ON_BOARD_DELAY: usize = 5;

/// What is known of the gyro's scale and of every sensor on board: x, y, yaw, delay.
fn on_board(calibration: &Calibration) -> (UncertainValue, [[UncertainValue; 4]; 4]) {
    let delays = [
        calibration.landmark_delay_s,
        calibration.beacon_delay_s,
        calibration.range_delay_s,
        calibration.compass_delay_s,
    ];
    let of_sensor = |i: usize| {
        let mounting = calibration.mountings[ON_BOARD[i].1];
        [mounting.x_m, mounting.y_m, mounting.yaw_rad, delays[i]]
    };
    (calibration.gyro_scale, [0, 1, 2, 3].map(of_sensor))
}

#[test]
fn gyro_scale_mountings_and_delays_are_learned_as_well_as_is_claimed() {
    let (place, yaw) = (unknown(0.05), unknown(3.0 * DEGREE));
    let late = UncertainValue { value: 0.1, sigma: 0.03 };
    let mut configured = furnished(&learning_geometry());
    let priors = &mut configured.calibration;
    priors.gyro_scale = unknown(0.01);
    (priors.landmark_delay_s, priors.beacon_delay_s, priors.range_delay_s, priors.compass_delay_s) =
        (late, late, late, late);
    priors.mountings[MountedSensor::Landmarks] = Mounting { x_m: place, y_m: place, yaw_rad: yaw };
    priors.mountings[MountedSensor::Beacons] = Mounting { x_m: place, y_m: place, ..Mounting::default() };
    // The range to a wall ahead changes with the square of the yaw, which no derivative shows: its prior is narrower.
    priors.mountings[MountedSensor::Range] = Mounting { x_m: place, y_m: place, yaw_rad: unknown(1.0 * DEGREE) };
    priors.mountings[MountedSensor::Compass] = Mounting { yaw_rad: yaw, ..Mounting::default() };
    let (scale_prior, sensor_priors) = on_board(&configured.calibration);
    let most = [
        ("gyro scale", 0.003),
        ("landmarks x", 0.005),
        ("landmarks y", 0.007),
        ("landmarks yaw", 0.3 * DEGREE),
        ("landmarks delay", 0.015),
        ("beacons x", 0.01),
        ("beacons y", 0.006),
        ("beacons delay", 0.028),
        ("range x", 0.003),
        ("range yaw", 0.8 * DEGREE),
        ("compass yaw", 0.6 * DEGREE),
        ("compass delay", 0.025),
    ];
    check_learned(most, 200, &BAND_OF_200, |seed| {
        // Of another stream than the drive's noise.
        let mut draws = RobotSimulation::new(seed + 1_000);
        let mut draw = |prior: UncertainValue| prior.value + prior.sigma * draws.normal();
        let (scale, sensors) = (draw(scale_prior), sensor_priors.map(|of_sensor| of_sensor.map(&mut draw)));
        let (mut drive, _) = drive_on_grid(1, Some(CAMERA_10_HZ), seed);
        let mut senses = SimulatedSensors::new(&configured, seed);
        for (i, (sensor, _, every)) in ON_BOARD.into_iter().enumerate() {
            let [forward_m, left_m, yaw_rad, _] = sensors[i];
            add(&mut drive, sensor, every, |_, (x_m, y_m, heading_rad)| {
                let (sin, cos) = heading_rad.sin_cos();
                let (x_m, y_m) = (x_m + cos * forward_m - sin * left_m, y_m + sin * forward_m + cos * left_m);
                let at = (x_m, y_m, heading_rad + yaw_rad);
                match sensor {
                    SensorId::LANDMARKS => senses.landmarks(at),
                    SensorId::BEACONS => senses.beacons(at, &[(0.0, 0.0); 4]),
                    SensorId::RANGE => senses.wall(at),
                    _ => senses.compass(at),
                }
            });
        }
        for arrival in &mut drive.arrivals {
            let observation = &mut arrival.observation;
            if let Some(i) = ON_BOARD.iter().position(|(sensor, ..)| *sensor == observation.sensor) {
                observation.stamp = observation.stamp + TimeDelta::from_secs_f64(sensors[i][3]);
                arrival.step += ON_BOARD_DELAY;
            } else if let ObservationKind::TurnRate(rate) = &mut observation.measurement {
                rate.0 *= 1.0 + scale;
            }
        }
        drive.arrivals.sort_by_key(|arrival| arrival.step);
        let (found_scale, found) =
            on_board(&played::<MEDIUM_STATES>(&drive, &configured).calibration().expect("it has constants"));
        let of = |sensor: usize, term: usize| (found[sensor][term], sensors[sensor][term]);
        let [landmarks, beacons, range, compass] = [0, 1, 2, 3];
        [
            (found_scale, scale),
            of(landmarks, 0),
            of(landmarks, 1),
            of(landmarks, 2),
            of(landmarks, 3),
            of(beacons, 0),
            of(beacons, 1),
            of(beacons, 3),
            of(range, 0),
            of(range, 2),
            of(compass, 2),
            of(compass, 3),
        ]
    });
}

#[test]
fn play_is_not_taken_for_geometry() {
    let mut configured = learning_geometry();
    configured.calibration.backlash_rad = unknown(3.0 * DEGREE);
    let names = ["radius_scale", "radius_difference", "track_scale", "backlash_rad"];
    for (case, camera, has_gyro) in
        [("gyro and camera", Some(CAMERA_10_HZ), true), ("camera", Some(CAMERA_10_HZ), false), ("gyro", None, true)]
    {
        let (mut within, mut track_sigma) = ([0; 4], 0.0);
        for seed in 0..200 {
            let mut world = RobotSimulation::new(seed).with_backlash(4.0 * DEGREE);
            let [mean, difference, track] = world.draw_geometry();
            let drive = altered(drive_steps(&mut world, course_of(20), camera), |observation| {
                (has_gyro || observation.sensor != SensorId::GYRO).then_some(observation)
            });
            let found = played::<CORE_STATES>(&drive, &configured).calibration().unwrap();
            let found = [found.radius_scale, found.radius_difference, found.track_scale, found.backlash_rad];
            for (i, truth) in [mean, difference, track, 4.0 * DEGREE].into_iter().enumerate() {
                within[i] += i32::from((found[i].value - truth).abs() < 2.0 * found[i].sigma);
            }
            track_sigma = found[2].sigma;
        }
        println!("{case}: {within:?} of 200 within two sigmas, track known to {:.2} %", 100.0 * track_sigma);
        for (name, within) in names.into_iter().zip(within) {
            assert!(within >= 186, "{case}: {name} within two sigmas in {within} of 200 seeds");
        }
    }
}

#[test]
fn constants_without_uncertainty_stay_as_configured() {
    let mut exact = config();
    exact.calibration.radius_scale.value = 0.004;
    exact.calibration.track_scale.value = -0.01;
    for seed in 0..3 {
        let (drive, _) = drawn(seed);
        let filter = played::<CORE_STATES>(&drive, &exact);
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
    let (drive, _) = drawn(5);
    let blind_from = 700;
    let drive = altered(drive, |observation| {
        let is_blind = observation.stamp >= stamp(blind_from);
        (observation.sensor != SensorId::CAMERA || !is_blind).then_some(observation)
    });
    let mut filter = PoseFilter::<CORE_STATES>::new(&learning_geometry());
    let mut before = None;
    for arrival in &drive.arrivals {
        filter.observe(&arrival.observation);
        // Three seconds after the last fix nothing observes wear any longer.
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
    let (drive, _) = drawn(6);
    let mut camera = learning_geometry();
    camera.calibration.fix_delay_s = unknown(0.1);
    camera.calibration.tag_forward_m = unknown(0.03);
    let mut filter = played::<SMALL_STATES>(&drive, &camera);
    let before = filter.calibration().unwrap();
    filter.restart_clock();
    let after = filter.calibration().unwrap();
    let but_bias = Calibration { gyro_bias_rad_per_s: before.gyro_bias_rad_per_s, ..after };
    assert_eq!(but_bias, before);
    // The gyro warms up anew.
    assert_eq!(after.gyro_bias_rad_per_s, unknown(NOISE.gyro_bias_rad_per_s));
}

#[test]
fn delay_and_lever_are_learned_as_well_as_is_claimed() {
    let (late, forward_m, left_m) = (TimeDelta::from_millis(150), 0.03, -0.02);
    let mut configured = config();
    configured.calibration.fix_delay_s = unknown(0.15);
    configured.calibration.tag_forward_m = unknown(0.03);
    configured.calibration.tag_left_m = unknown(0.03);
    let most = [("fix_delay_s", 0.01), ("tag_forward_m", 0.003), ("tag_left_m", 0.003)];
    check_learned(most, 40, &BAND_OF_40, |seed| {
        let camera = Camera { delay: 4, ..CAMERA_10_HZ };
        let drive = drive_steps(&mut RobotSimulation::new(seed), course(), Some(camera));
        let drive = with_tag_moved(drive, (forward_m, left_m), late);
        let found = played::<SMALL_STATES>(&drive, &configured).calibration().unwrap();
        [(found.fix_delay_s, late.as_secs_f64()), (found.tag_forward_m, forward_m), (found.tag_left_m, left_m)]
    });
}

#[test]
fn the_filter_in_the_table_has_as_many_states_as_configured() {
    let drive = drive_lap(Some(CAMERA_10_HZ), 1);
    let mut configured = config();
    configured.calibration.fix_delay_s = unknown(0.1);
    let mut filter = named("pose", &configured);
    for arrival in drive.arrivals.iter().take(1_000) {
        filter.observe(&arrival.observation);
    }
    let found = filter.calibration().unwrap();
    assert!(found.fix_delay_s.sigma < 0.05, "{found:?}");
    assert_eq!(found.tag_forward_m, UncertainValue::default());
    let plain = named("pose", &config());
    assert_eq!(plain.calibration().unwrap().fix_delay_s, UncertainValue::default());
}
