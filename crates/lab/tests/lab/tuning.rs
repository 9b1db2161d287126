//! A noise that is told ten times wrong is found again from the innovations of the filter itself.

use posebridge_estimator::{FilterConfig, find_filter};
use posebridge_lab::tuning::{SearchOptions, TunedKey, default_keys, fit_run, ln_prior, maximise, offline_params};
use posebridge_telemetry::{Observation, SensorNoise};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use crate::support;

const TRUE_SIGMA_M: f64 = 0.02;

fn config(fix_position_m: f64) -> FilterConfig {
    let noise =
        SensorNoise { wheel_travel_m_per_sqrt_m: 0.001, fix_position_m, fix_heading_rad: 0.02, ..SensorNoise::EXACT };
    support::config([0.03; 2], 0.12, 0.01, noise)
}

/// Straight along x at 0.2 m/s, with a position and a heading each second.
fn drive() -> Vec<Observation> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(11);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut observations = Vec::new();
    for i in 0..6_000_i64 {
        let travel_m = 0.01 * i as f64;
        observations.push(support::wheels(50 * i, travel_m / 0.03, travel_m / 0.03));
        if i % 20 == 0 {
            let x_m = travel_m + TRUE_SIGMA_M * normal();
            observations.push(support::fix(50 * i, x_m, TRUE_SIGMA_M * normal(), Some(0.02 * normal())));
        }
    }
    observations
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
