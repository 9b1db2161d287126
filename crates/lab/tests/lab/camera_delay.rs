//! A camera's delay out of motion: found with a sigma that covers, and refused where nothing tells of it.

use posebridge_lab::noise_identification::{
    CameraSample, CumulativeMotion, DelayError, DelaySearch, cumulative_motion_of, find_delay,
};
use posebridge_telemetry::SensorNoise;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use crate::support;

const SEARCH: DelaySearch = DelaySearch { from_s: -0.2, to_s: 0.8 };

/// How far a robot has turned that turns to and fro, in radians.
fn turned_rad(at_s: f64) -> f64 {
    0.6 * (2.0 * at_s).sin() + 0.3 * (3.7 * at_s).sin()
}

fn cumulative_motion(seconds: u32, turn: fn(f64) -> f64) -> CumulativeMotion {
    let wheels = (0..seconds * 20).map(|i| {
        let at_s = f64::from(i) * 0.05;
        let (driven_m, half_m) = (0.1 * at_s, 0.5 * turn(at_s) * 0.12);
        support::wheels(50 * i64::from(i), (driven_m - half_m) / 0.03, (driven_m + half_m) / 0.03)
    });
    let geometry = support::config([0.03; 2], 0.12, 0.0, SensorNoise::EXACT).geometry;
    cumulative_motion_of(&wheels.collect::<Vec<_>>(), &geometry)
}

/// Ten a second, late by so much, with heading noise of one degree and a drift of the wheels against the camera.
fn camera_samples(seconds: u32, delay_s: f64, seed: u64) -> Vec<CameraSample> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let sighting = |i: u32| {
        let at_s = f64::from(i) * 0.1;
        let noise: f64 = StandardNormal.sample(&mut rng);
        let heading = turned_rad(at_s - delay_s) + 0.005 * at_s + 0.0175 * noise;
        CameraSample { at_s, position_m: [0.0, 0.0], heading_rad: Some(heading) }
    };
    (0..seconds * 10).map(sighting).collect()
}

#[test]
fn a_delay_is_found_within_three_sigma_and_mostly_within_two() {
    let mut within_two = 0;
    for seed in 0..10 {
        let found = find_delay(&cumulative_motion(60, turned_rad), &camera_samples(60, 0.137, seed), &SEARCH).unwrap();
        let off = (found.delay_s - 0.137) / found.sigma_s;
        assert!(off.abs() < 3.0 && found.by_heading, "{seed}: {} ± {}", found.delay_s, found.sigma_s);
        assert!(found.sigma_s < 0.005, "{seed}: {}", found.sigma_s);
        within_two += i32::from(off.abs() < 2.0);
    }
    assert!(within_two >= 8, "{within_two} of 10");
}

#[test]
fn what_tells_no_delay_says_why() {
    let motion = camera_samples(60, 0.137, 1);
    let resting = cumulative_motion(60, |_| 0.0);
    assert!(matches!(find_delay(&resting, &motion, &SEARCH), Err(DelayError::NoMotion(_))));
    let short = find_delay(&cumulative_motion(60, turned_rad), &motion[..20], &SEARCH);
    assert!(matches!(short, Err(DelayError::TooFew(_))));
    let narrow = DelaySearch { from_s: 0.2, to_s: 0.5 };
    let edge = find_delay(&cumulative_motion(60, turned_rad), &motion, &narrow);
    assert!(matches!(edge, Err(DelayError::AtSearchLimit(_))), "{edge:?}");
    let none = DelaySearch { from_s: 0.2, to_s: f64::NAN };
    assert_eq!(find_delay(&resting, &motion, &none), Err(DelayError::NoRange));
    assert!(find_delay(&CumulativeMotion::default(), &motion, &SEARCH).is_err());
}

#[test]
fn sightings_that_make_no_sense_are_left_out() {
    let (levels, clean) = (cumulative_motion(60, turned_rad), camera_samples(60, 0.137, 3));
    let mut broken = clean.clone();
    broken.insert(300, CameraSample { at_s: f64::NAN, ..clean[300] });
    broken.insert(310, CameraSample { position_m: [f64::INFINITY, 0.0], ..clean[300] });
    broken.insert(320, CameraSample { at_s: 1.0, ..clean[300] });
    let found = find_delay(&levels, &broken, &SEARCH).unwrap();
    assert_eq!(found, find_delay(&levels, &clean, &SEARCH).unwrap());
}
