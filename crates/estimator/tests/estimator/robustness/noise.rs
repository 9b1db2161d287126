//! Noise that is not the configured one: the scale of its source follows, and the gate opens by itself.

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::CORE_STATES;
use posebridge_estimator::filters::pose::noise_scales::{NoiseGroup, NoiseSource};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::SensorId;

use crate::support::alter::{CAMERA, at, fixes, share_accepted};
use crate::support::robot::config;
use crate::support::score::{Score, mean, play, score};
use crate::support::simulation::{Camera, drive_lap};

/// The robot, configured with a multiple of the camera's true noise.
fn with_camera_noise_scaled(times: f64) -> FilterConfig {
    let mut config = config();
    config.noise.fix_position_m *= times;
    config.noise.fix_heading_rad *= times;
    config
}

fn with_outliers(share: f64) -> Camera {
    Camera { outliers: share, ..CAMERA }
}

/// The fixes' source, whose number among the kinds is 0.
const CAMERA_FIXES: NoiseSource = NoiseSource { sensor: SensorId::CAMERA, kind: 0, group: NoiseGroup::Position };

/// Geometric mean over seeds, and over the second half of each drive, of the variance scale that was learned.
fn learned_scale(config: &FilterConfig, camera: Camera, seeds: u64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..seeds {
        let drive = drive_lap(Some(camera), seed);
        let mut filter = PoseFilter::<CORE_STATES>::new(config);
        for arrival in &drive.arrivals {
            filter.observe(&arrival.observation);
            if arrival.step > drive.poses.len() / 2 {
                sum += filter.state().noise_scales.factor(CAMERA_FIXES).ln();
                count += 1.0;
            }
        }
    }
    f64::exp(sum / count)
}

#[test]
fn the_scale_of_a_source_finds_the_true_variance_when_configured_too_large_or_small() {
    for (times, outliers) in [(0.25, 0.0), (1.0, 0.0), (4.0, 0.0), (0.25, 0.03), (1.0, 0.03)] {
        let found = learned_scale(&with_camera_noise_scaled(times), with_outliers(outliers), 10);
        let ratio = found * times * times;
        println!("told {times} times the noise, {outliers} outliers: scale {found:.4}, {ratio:.3} of the truth");
        assert!((1.0 / 1.3..1.3).contains(&ratio), "told {times}: {ratio}");
    }
}

#[test]
fn without_adaptation_the_scale_stays_one() {
    let mut config = with_camera_noise_scaled(0.25);
    config.params.adapt_gain = 0.0;
    assert_eq!(learned_scale(&config, CAMERA, 1), 1.0);
}

fn mean_over(config: &FilterConfig, camera: Camera) -> Score {
    let scores: Vec<Score> = (0..10)
        .map(|seed| {
            let drive = drive_lap(Some(camera), seed);
            let played = play(&drive, config);
            let end = drive.poses.len();
            assert_eq!(at(&played, end).reset_counter, 0, "seed {seed}");
            // After the ten seconds that the scale may take.
            let late = share_accepted(&fixes(&played, &(200..end)));
            assert!(late > 0.92, "seed {seed}: {late} of the fixes are used");
            score(&drive, &played, 0)
        })
        .collect();
    mean(&scores)
}

#[test]
fn a_gate_with_a_wrong_r_does_not_lock_itself_out() {
    // Sixteen times the true variance is missing; 0.5 m of outliers come on top.
    for outliers in [0.0, 0.03] {
        let mean = mean_over(&with_camera_noise_scaled(0.25), with_outliers(outliers));
        println!("told a quarter of the noise, {outliers} outliers: {mean:?}");
        assert!(mean.position_rms_m < 0.002, "{mean:?}");
        assert!((0.79..1.24).contains(&mean.anees), "{mean:?}");
    }
}

#[test]
fn students_t_bears_outliers_without_a_gate() {
    let mut config = config();
    config.params.student_dof = 4.0;
    for outliers in [0.0, 0.03, 0.1] {
        let mean = mean_over(&config, with_outliers(outliers));
        println!("Student's t, {outliers} outliers: {mean:?}");
        assert!(mean.position_rms_m < 0.0018, "{mean:?}");
    }
    config.params.adapt_gain = 0.0;
    config.noise = with_camera_noise_scaled(0.25).noise;
    let mean = mean_over(&config, CAMERA);
    println!("Student's t, told a quarter of the noise, not adapted: {mean:?}");
    assert!(mean.position_rms_m < 0.004, "{mean:?}");
}
