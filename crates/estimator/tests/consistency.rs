//! The flagship against truth it was told the noise of: errors must fit their covariance.
//!
//! The robot, its path and its noise are those of the Monte-Carlo in docs/maths/pose.md section 9, with the geometry known.
#![expect(
    clippy::expect_used,
    reason = "helpers outside #[test] stop when the filter gives no estimate"
)]

#[path = "support/drive.rs"]
mod drive;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/score.rs"]
mod score;

use drive::{Camera, Scenario, drive};
use robot::config;
use score::{Score, mean, play, score};

/// 95 % band of the average NEES over `runs` independent runs, as a ratio to three degrees of freedom, widened by what errors
/// correlated over a run leave: Bar-Shalom, Li, Kirubarajan (2001), chapter 5, give [0.79, 1.24] for 50 independent samples.
const BAND: std::ops::RangeInclusive<f64> = 0.79..=1.24;

fn mean_over(scenario: &Scenario, runs: u64) -> Score {
    let scores: Vec<Score> = (0..runs)
        .map(|seed| {
            let drive = drive(scenario, seed);
            score(&drive, &play(&drive, &config()), 0)
        })
        .collect();
    mean(&scores)
}

#[test]
fn with_late_fixes_at_10_hz_the_errors_fit_their_covariance() {
    let scenario = Scenario {
        laps: 1,
        camera: Some(Camera {
            every: 2,
            delay: 3,
            spread: 1,
            outliers: 0.0,
        }),
    };
    let result = mean_over(&scenario, 20);
    println!("camera 10 Hz, 150 ± 50 ms late: {result:?}");
    assert!(BAND.contains(&result.anees), "{result:?}");
    assert!((0.9..1.1).contains(&result.fix_nis_per_dof), "{result:?}");
    assert!(result.position_rms_m < 0.0015, "{result:?}");
}

#[test]
fn half_metre_outliers_are_kept_out() {
    let scenario = Scenario {
        laps: 1,
        camera: Some(Camera {
            every: 2,
            delay: 3,
            spread: 1,
            outliers: 0.03,
        }),
    };
    let result = mean_over(&scenario, 20);
    println!("3 % outliers of 0.5 m: {result:?}");
    assert!(result.position_rms_m < 0.0016, "{result:?}");
}

#[test]
fn without_fixes_gyro_windows_keep_the_heading_honest() {
    let scenario = Scenario {
        laps: 1,
        camera: None,
    };
    let result = mean_over(&scenario, 200);
    println!("no camera: {result:?}");
    assert!(BAND.contains(&result.anees), "{result:?}");
}
