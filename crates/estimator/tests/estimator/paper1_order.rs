//! The order that paper 1 promises: raw odometry worse than wheel-kf, worse than velocity-kf, worse than ekf5.
//!
//! One lap of a 3 m square, 50 ms steps, slip and sensors of support/simulation.rs, accelerometers of 0.05 m/s² at the wheels. The
//! figures are printed; docs/lab/square.md section M7 explains them.

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{Meters, ObservationKind, UncertainValue};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::support::robot::{GEOMETRY_SIGMAS, NOISE, RADIUS_M, TRACK_M, config};
use crate::support::score::{Score, mean, play_with, score};
use crate::support::simulation::{Drive, add_accelerations, drive_lap};

const SEEDS: u64 = 200;
const FILTERS: [&str; 6] = ["odometry", "wheel-kf", "velocity-kf", "ekf5", "ukf5", "ekf5-corrected"];
/// At rest before the square begins.
const REST_STEPS: usize = 40;

fn square(seed: u64) -> Drive {
    let mut driven = drive_lap(None, seed);
    add_accelerations(&mut driven, 0.05, seed);
    driven
}

/// Errors over the whole drive, consistency from the first motion on.
fn score_of(name: &str, driven: &Drive, config: &FilterConfig) -> Score {
    let played = play_with(name, driven, config);
    Score { anees: score(driven, &played, REST_STEPS).anees, ..score(driven, &played, 0) }
}

/// The calibration before a drive: the gyro's mean at rest is its bias.
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

/// Wheels and track as measured by hand: 0.5 % off in mean radius and in their difference, 3 % in the track. The noise of
/// the motion is configured to allow for it, as docs/maths/pose.md section 2 advises.
fn with_measured_geometry(mut config: FilterConfig, seed: u64) -> FilterConfig {
    let mut normals = Pcg64::seed_from_u64(seed ^ 0x6e0);
    let [mean, difference, track] = GEOMETRY_SIGMAS.map(|sigma| sigma * normals.sample::<f64, _>(StandardNormal));
    config.geometry.left_wheel_radius = Meters(RADIUS_M * (1.0 + mean - 0.5 * difference));
    config.geometry.right_wheel_radius = Meters(RADIUS_M * (1.0 + mean + 0.5 * difference));
    config.geometry.track_width = Meters(TRACK_M * (1.0 + track));
    config.noise.heading_rad_per_sqrt_m = 0.03;
    config.noise.turn_rad_per_sqrt_rad = 0.02;
    config
}

/// The scores of every filter in each run.
struct Scores(Vec<[Score; 6]>);

impl Scores {
    /// Over the seeds, printed.
    fn over(case: &str, configured: impl Fn(u64, &Drive) -> FilterConfig) -> Self {
        let of_run = |seed| {
            let driven = square(seed);
            let config = configured(seed, &driven);
            FILTERS.map(|name| score_of(name, &driven, &config))
        };
        let all = Self((0..SEEDS).map(of_run).collect());
        println!("{case}, {SEEDS} seeds");
        for name in FILTERS {
            let mean = all.mean(name);
            println!(
                "  {name:15} position rms {:6.1} mm, heading rms {:5.2} degrees, ANEES {:.2}",
                1e3 * mean.position_rms_m,
                mean.heading_rms_rad.to_degrees(),
                mean.anees,
            );
        }
        for (worse, better) in [(0, 1), (1, 2), (2, 3), (0, 3), (3, 5), (0, 5)] {
            let (worse, better) = (FILTERS[worse], FILTERS[better]);
            println!("  {worse} worse than {better}: {:.0} % of the seeds", 100.0 * all.share(worse, better));
        }
        all
    }

    fn of<'a>(&'a self, name: &str) -> impl Iterator<Item = &'a Score> {
        let index = FILTERS.iter().position(|other| *other == name).expect("it is compared");
        self.0.iter().map(move |scores| &scores[index])
    }

    fn mean(&self, name: &str) -> Score {
        mean(&self.of(name).copied().collect::<Vec<_>>())
    }

    /// How often one filter's position is worse than another's.
    fn share(&self, worse: &str, better: &str) -> f64 {
        let pairs = self.of(worse).zip(self.of(better));
        pairs.filter(|(worse, better)| worse.position_rms_m > better.position_rms_m).count() as f64
            / self.0.len() as f64
    }

    fn rms(&self, name: &str) -> f64 {
        self.mean(name).position_rms_m
    }
}

/// The result of a long record at rest: the bias at the start of the drive itself, which the drive draws first.
fn with_exact_bias(mut config: FilterConfig, seed: u64) -> FilterConfig {
    let normal: f64 = Pcg64::seed_from_u64(seed).sample(StandardNormal);
    config.calibration.gyro_bias_rad_per_s = UncertainValue { value: NOISE.gyro_bias_rad_per_s * normal, sigma: 1e-4 };
    config
}

/// 95 % band of the average NEES over 200 independent runs, as a ratio to three degrees of freedom: chi-square with 600 of them,
/// Bar-Shalom, Li, Kirubarajan (2001), chapter 5. The mean over a run, whose errors are correlated, scatters less than one of them.
const HONEST: std::ops::RangeInclusive<f64> = 0.89..=1.12;

#[test]
fn with_wheels_that_were_measured_and_a_good_bias_ekf5_beats_the_encoders_and_nothing_else_does() {
    let all = Scores::over("geometry measured, bias exact", |seed, _| {
        with_measured_geometry(with_exact_bias(config(), seed), seed)
    });
    assert!(all.share("odometry", "ekf5") >= 0.95);
    assert!(all.share("velocity-kf", "ekf5") >= 0.95);
    // A tossed coin: neither filter knows anything that the encoders do not.
    for (worse, better) in [("odometry", "wheel-kf"), ("wheel-kf", "velocity-kf")] {
        let holds = all.share(worse, better);
        assert!((0.4..0.6).contains(&holds), "{worse}, {better}: {holds}");
    }
    assert!(all.rms("ekf5-corrected") < 0.7 * all.rms("ekf5"));
}

#[test]
fn with_wheels_that_were_measured_and_a_bias_of_two_seconds_the_order_is_below_the_papers_95_per_cent() {
    let all = Scores::over("geometry measured, bias of 2 s at rest", |seed, driven| {
        with_measured_geometry(with_known_bias(config(), driven), seed)
    });
    let holds = all.share("odometry", "ekf5");
    assert!((0.8..0.95).contains(&holds), "{holds}");
}

#[test]
fn with_known_wheels_the_corrected_filter_is_consistent_and_the_faithful_one_is_not() {
    let all = Scores::over("geometry known, bias of 2 s at rest", |_, driven| with_known_bias(config(), driven));
    let corrected = all.mean("ekf5-corrected").anees;
    assert!(HONEST.contains(&corrected), "{corrected}");
    assert!(all.mean("ekf5").anees > 10.0, "over-confident by design");
    assert!(all.rms("ekf5-corrected") < 0.9 * all.rms("odometry"));
    assert!(all.rms("ekf5") > 1.5 * all.rms("odometry"));
    // Filtering the wheels one by one neither helps nor hurts; the accelerometers' noise hurts.
    assert!((all.rms("wheel-kf") / all.rms("odometry") - 1.0).abs() < 0.01);
    assert!(all.rms("velocity-kf") > 1.2 * all.rms("odometry"));
    assert!((all.rms("ukf5") / all.rms("ekf5") - 1.0).abs() < 0.001);
}

#[test]
fn an_unconfigured_bias_ruins_ekf5_and_is_learned_by_the_corrected_filter() {
    let all = Scores::over("geometry known, bias unknown", |_, _| config());
    assert!(all.rms("ekf5") > 10.0 * all.rms("odometry"));
    assert!(all.rms("ekf5-corrected") < 0.9 * all.rms("odometry"));
    let corrected = all.mean("ekf5-corrected").anees;
    assert!(HONEST.contains(&corrected), "{corrected}");
}
