//! The order that paper 1 promises: raw odometry worse than wheel-kf, worse than velocity-kf, worse than ekf5.
//!
//! One lap of a 3 m square, 50 ms steps, slip and sensors of support/drive.rs, accelerometers of 0.05 m/s² at the wheels. The
//! figures are printed; docs/lab/square.md section M7 says what they mean.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers outside #[test] stop when a filter gives no estimate, and print the figures of the page"
)]

#[path = "support/accelerations.rs"]
mod accelerations;
#[path = "support/drive.rs"]
mod drive;
#[path = "support/robot.rs"]
mod robot;

use accelerations::add_accelerations;
use drive::{Drive, Scenario, drive, stamp};
use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::{FilterConfig, find_filter};
use posebridge_telemetry::{Meters, ObservationKind, UncertainValue, quantities::wrap_rad};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use robot::{NOISE, RADIUS_M, TRACK_M, config};

const SEEDS: u64 = 200;
const FILTERS: [&str; 6] = ["odometry", "wheel-kf", "velocity-kf", "ekf5", "ukf5", "ekf5-corrected"];
/// At rest before the square begins.
const REST_STEPS: usize = 40;

/// Root mean square of the position's error, m, and ANEES of the pose over its three degrees of freedom.
#[derive(Clone, Copy, Debug)]
struct Score {
    position_m: f64,
    heading_rad: f64,
    anees: f64,
}

fn square(seed: u64) -> Drive {
    let mut driven = drive(&Scenario { laps: 1, camera: None }, seed);
    add_accelerations(&mut driven, 1, 0.05, seed);
    driven
}

fn score(name: &str, driven: &Drive, config: &FilterConfig) -> Score {
    let mut filter = (find_filter(name).expect("it is in the table").build)(config);
    let mut arrivals = driven.arrivals.iter().peekable();
    let (mut squares, mut heading_squares, mut nees, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (index, truth) in driven.poses.iter().enumerate() {
        let step = index + 1;
        while let Some(next) = arrivals.next_if(|next| next.step <= step) {
            filter.observe(&next.observation);
        }
        let estimate = filter.estimate_at(stamp(step)).expect("it was observed");
        let heading_rad = wrap_rad(estimate.pose.heading.rad() - truth.2);
        let error = Vector3::new(estimate.pose.x.0 - truth.0, estimate.pose.y.0 - truth.1, heading_rad);
        let p = Matrix3::from_fn(|i, j| estimate.covariance[i][j]);
        squares += error[0].powi(2) + error[1].powi(2);
        heading_squares += heading_rad.powi(2);
        if step > REST_STEPS {
            nees += (error.transpose() * p.try_inverse().expect("positive definite") * error)[0] / 3.0;
        }
        count += 1.0;
    }
    Score {
        position_m: f64::sqrt(squares / count),
        heading_rad: f64::sqrt(heading_squares / count),
        anees: nees / (count - REST_STEPS as f64),
    }
}

/// What a robot's owner does before: the gyro's mean while the robot stands is its bias.
fn with_known_bias(mut config: FilterConfig, driven: &Drive) -> FilterConfig {
    let at_rest: Vec<f64> = driven
        .arrivals
        .iter()
        .filter(|arrival| arrival.step <= REST_STEPS)
        .filter_map(|arrival| {
            let ObservationKind::TurnRate(rate) = arrival.observation.measurement else {
                return None;
            };
            Some(rate.0)
        })
        .collect();
    config.calibration.gyro_bias_rad_per_s = UncertainValue {
        value: at_rest.iter().sum::<f64>() / at_rest.len() as f64,
        sigma: NOISE.gyro_rad_per_s / (at_rest.len() as f64).sqrt(),
    };
    config
}

/// Wheels and track as somebody measured them: 0.5 % off in mean radius and in their difference, 3 % in the track. The noise of
/// the motion is told to allow for it, as docs/maths/pose.md section 2 advises.
fn with_measured_geometry(mut config: FilterConfig, seed: u64) -> FilterConfig {
    let mut normals = Pcg64::seed_from_u64(seed ^ 0x6e0);
    let mut off = |sigma: f64| {
        let normal: f64 = normals.sample(StandardNormal);
        sigma * normal
    };
    let (mean, difference, track) = (off(0.005), off(0.005), off(0.03));
    config.geometry.left_wheel_radius = Meters(RADIUS_M * (1.0 + mean - 0.5 * difference));
    config.geometry.right_wheel_radius = Meters(RADIUS_M * (1.0 + mean + 0.5 * difference));
    config.geometry.track_width = Meters(TRACK_M * (1.0 + track));
    config.noise.heading_rad_per_sqrt_m = 0.03;
    config.noise.turn_rad_per_sqrt_rad = 0.02;
    config
}

/// Scores of every filter over the seeds, in the order of [`FILTERS`].
fn scores(case: &str, configured: impl Fn(u64, &Drive) -> FilterConfig) -> Vec<[Score; 6]> {
    let all: Vec<[Score; 6]> = (0..SEEDS)
        .map(|seed| {
            let driven = square(seed);
            let config = configured(seed, &driven);
            FILTERS.map(|name| score(name, &driven, &config))
        })
        .collect();
    println!("{case}, {SEEDS} seeds");
    for (index, name) in FILTERS.into_iter().enumerate() {
        let mean = |pick: fn(&Score) -> f64| all.iter().map(|scores| pick(&scores[index])).sum::<f64>() / SEEDS as f64;
        println!(
            "  {name:15} position rms {:6.1} mm, heading rms {:5.2} degrees, ANEES {:.2}",
            1e3 * mean(|score| score.position_m.powi(2)).sqrt(),
            mean(|score| score.heading_rad.powi(2)).sqrt().to_degrees(),
            mean(|score| score.anees),
        );
    }
    for (worse, better) in [(0, 1), (1, 2), (2, 3), (0, 3), (3, 5), (0, 5)] {
        println!(
            "  {} worse than {}: {:.0} % of the seeds",
            FILTERS[worse],
            FILTERS[better],
            100.0 * share(&all, worse, better)
        );
    }
    all
}

/// How often one filter's position is worse than another's.
fn share(all: &[[Score; 6]], worse: usize, better: usize) -> f64 {
    let count = all.iter().filter(|scores| scores[worse].position_m > scores[better].position_m).count();
    count as f64 / all.len() as f64
}

/// What a long record at rest would tell: the bias at the start of the drive itself, which the drive draws first.
fn with_exact_bias(mut config: FilterConfig, seed: u64) -> FilterConfig {
    let normal: f64 = Pcg64::seed_from_u64(seed).sample(StandardNormal);
    config.calibration.gyro_bias_rad_per_s = UncertainValue { value: NOISE.gyro_bias_rad_per_s * normal, sigma: 1e-4 };
    config
}

/// 95 % band of the average NEES over 200 independent runs, as a ratio to three degrees of freedom: chi-square with 600 of them,
/// Bar-Shalom, Li, Kirubarajan (2001), chapter 5. The mean over a run, whose errors are correlated, scatters less than one of them.
const HONEST: std::ops::RangeInclusive<f64> = 0.89..=1.12;

fn rms(all: &[[Score; 6]], name: &str) -> f64 {
    let index = index_of(name);
    let mean = all.iter().map(|scores| scores[index].position_m.powi(2)).sum::<f64>() / all.len() as f64;
    mean.sqrt()
}

fn anees(all: &[[Score; 6]], name: &str) -> f64 {
    let index = index_of(name);
    all.iter().map(|scores| scores[index].anees).sum::<f64>() / all.len() as f64
}

fn index_of(name: &str) -> usize {
    FILTERS.iter().position(|other| *other == name).expect("it is compared")
}

#[test]
fn with_wheels_that_were_measured_and_a_good_bias_ekf5_beats_the_encoders_and_nothing_else_does() {
    let all = scores("geometry measured, bias exact", |seed, _| {
        with_measured_geometry(with_exact_bias(config(), seed), seed)
    });
    assert!(share(&all, index_of("odometry"), index_of("ekf5")) >= 0.95);
    assert!(share(&all, index_of("velocity-kf"), index_of("ekf5")) >= 0.95);
    // A tossed coin: neither filter knows anything that the encoders do not.
    for (worse, better) in [("odometry", "wheel-kf"), ("wheel-kf", "velocity-kf")] {
        let holds = share(&all, index_of(worse), index_of(better));
        assert!((0.4..0.6).contains(&holds), "{worse}, {better}: {holds}");
    }
    assert!(rms(&all, "ekf5-corrected") < 0.7 * rms(&all, "ekf5"));
}

#[test]
fn with_wheels_that_were_measured_and_a_bias_of_two_seconds_the_order_is_below_the_papers_95_per_cent() {
    let all = scores("geometry measured, bias of 2 s at rest", |seed, driven| {
        with_measured_geometry(with_known_bias(config(), driven), seed)
    });
    let holds = share(&all, index_of("odometry"), index_of("ekf5"));
    assert!((0.8..0.95).contains(&holds), "{holds}");
}

#[test]
fn with_known_wheels_the_corrected_filter_is_honest_and_the_faithful_one_is_not() {
    let all = scores("geometry known, bias of 2 s at rest", |_, driven| with_known_bias(config(), driven));
    let corrected = anees(&all, "ekf5-corrected");
    assert!(HONEST.contains(&corrected), "{corrected}");
    assert!(anees(&all, "ekf5") > 10.0, "over-confident by design");
    assert!(rms(&all, "ekf5-corrected") < 0.9 * rms(&all, "odometry"));
    assert!(rms(&all, "ekf5") > 1.5 * rms(&all, "odometry"));
    // Filtering the wheels one by one neither helps nor hurts; the accelerometers' noise hurts.
    assert!((rms(&all, "wheel-kf") / rms(&all, "odometry") - 1.0).abs() < 0.01);
    assert!(rms(&all, "velocity-kf") > 1.2 * rms(&all, "odometry"));
    assert!((rms(&all, "ukf5") / rms(&all, "ekf5") - 1.0).abs() < 0.001);
}

#[test]
fn a_bias_that_nobody_told_ruins_ekf5_and_is_learned_by_the_corrected_filter() {
    let all = scores("geometry known, bias unknown", |_, _| config());
    assert!(rms(&all, "ekf5") > 10.0 * rms(&all, "odometry"));
    assert!(rms(&all, "ekf5-corrected") < 0.9 * rms(&all, "odometry"));
    let corrected = anees(&all, "ekf5-corrected");
    assert!(HONEST.contains(&corrected), "{corrected}");
}
