//! A noise that is told ten times wrong is found again from the innovations of the filter itself.

use std::sync::Arc;

use posebridge_estimator::{FilterConfig, Params, find_filter};
use posebridge_lab::tuning::{SearchOptions, TunedKey, default_keys, fit_run, ln_prior, maximise, offline_params};
use posebridge_telemetry::{
    Calibration, DriveGeometry, Fix, Meters, Observation, ObservationKind, Point2, Radians, SensorId, SensorNoise,
    TimeDelta, Timestamp,
};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

const TRUE_SIGMA_M: f64 = 0.02;

fn config(fix_position_m: f64) -> FilterConfig {
    FilterConfig {
        geometry: DriveGeometry {
            left_wheel_radius: Meters(0.03),
            right_wheel_radius: Meters(0.03),
            track_width: Meters(0.12),
            tick: Radians(0.01),
        },
        noise: SensorNoise {
            wheel_travel_m_per_sqrt_m: 0.001,
            fix_position_m,
            fix_heading_rad: 0.02,
            ..SensorNoise::EXACT
        },
        start: None,
        params: Params::default(),
        calibration: Calibration::default(),
        arena_map: Arc::default(),
    }
}

/// Straight along x at 0.2 m/s, with a position and a heading each second.
fn drive() -> Vec<Observation> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(11);
    let mut observations = Vec::new();
    for i in 0..6_000_u32 {
        let at_s = f64::from(i) * 0.05;
        let travel_m = 0.2 * at_s;
        let angle = Radians(travel_m / 0.03);
        observations.push((SensorId::WHEELS, at_s, ObservationKind::WheelAngles { left: angle, right: angle }));
        if i % 20 == 0 {
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let fix = Fix {
                position: Point2::new(Meters(travel_m + TRUE_SIGMA_M * normal()), Meters(TRUE_SIGMA_M * normal())),
                heading: Some(posebridge_telemetry::Heading::from_rad(0.02 * normal())),
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            };
            observations.push((SensorId::CAMERA, at_s, ObservationKind::Fix(fix)));
        }
    }
    let stamped = observations.into_iter().map(|(sensor, at_s, observed)| Observation {
        sensor,
        stamp: Timestamp::from_secs_f64(at_s),
        stamp_sigma: TimeDelta::ZERO,
        measurement: observed,
    });
    stamped.collect()
}

#[test]
fn a_fix_noise_told_ten_times_too_large_or_too_small_is_found_again() {
    let observations = drive();
    let entry = find_filter("pose").unwrap();
    let key = TunedKey::from_name("fix_position_m").unwrap();
    for factor in [10.0, 0.1] {
        let value = |point: &Vec<f64>| {
            let mut config = config(TRUE_SIGMA_M * factor);
            key.scale(&mut config, point[0].exp());
            config.params = offline_params(config.params);
            let fit = fit_run(&observations, (entry.build)(&config).as_mut());
            fit.log_likelihood() + ln_prior(point)
        };
        let found = maximise(1, &SearchOptions::default(), |points| points.iter().map(value).collect());
        let off = found.at[0] + f64::ln(factor);
        let sigma = found.sigma[0].unwrap();
        assert!(off.abs() < 3.0 * sigma + 0.04, "{factor}: {off} ± {sigma}");
        // 300 fixes of two components: 1 / sqrt(2 * 600).
        assert!((0.02..0.05).contains(&sigma), "{sigma}");
    }
}

#[test]
fn the_usual_keys_are_those_of_which_the_observations_tell() {
    let config = config(TRUE_SIGMA_M);
    let names: Vec<String> = default_keys(&drive(), &config.noise).iter().map(TunedKey::name).collect();
    assert_eq!(names, ["noise.wheel_travel_m_per_sqrt_m", "noise.fix_position_m", "noise.fix_heading_rad"]);
}
