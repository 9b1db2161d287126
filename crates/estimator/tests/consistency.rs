//! The flagship against truth it was told the noise of: errors must fit their covariance.
//!
//! The robot, its path and its noise are those of the Monte-Carlo in docs/maths/pose.md section 9, with the geometry known and
//! unknown. Every case prints its verdict in words.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers outside #[test] stop when the filter gives no estimate, and print the figures that they found"
)]

#[path = "support/drive.rs"]
mod drive;
#[path = "support/grid.rs"]
mod grid;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/score.rs"]
mod score;

use drive::{Camera, Scenario, drive};
use grid::{KIT, config_with, drive_on_grid};
use posebridge_telemetry::{FusionOutcome, SensorId};
use robot::config;
use score::{Score, mean, play, score};

/// 95 % band of the average NEES over `runs` independent runs, as a ratio to three degrees of freedom, widened by what errors
/// correlated over a run leave: Bar-Shalom, Li, Kirubarajan (2001), chapter 5, give [0.79, 1.24] for 50 independent samples.
const BAND: std::ops::RangeInclusive<f64> = 0.79..=1.24;

/// What an average of normalised squares says, which should be one.
fn verdict_on(average: f64) -> &'static str {
    if average > *BAND.end() {
        "over-confident: its errors are larger than it claims"
    } else if average < *BAND.start() {
        "under-confident: its errors are smaller than it claims"
    } else {
        "honest: its errors are as large as it claims"
    }
}

fn report(case: &str, result: &Score) {
    println!(
        "{case}: {:.2} mm, {:.2} degrees, ANEES {:.2}, NIS {:.2}: {}",
        result.position_rms_m * 1e3,
        result.heading_rms_rad.to_degrees(),
        result.anees,
        result.fix_nis_per_dof,
        verdict_on(result.anees)
    );
    assert!(BAND.contains(&result.anees), "{case}: {}", verdict_on(result.anees));
}

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
    let scenario = Scenario { laps: 1, camera: Some(LATE_10_HZ) };
    let result = mean_over(&scenario, 20);
    report("camera 10 Hz, 150 ± 50 ms late", &result);
    assert!((0.9..1.1).contains(&result.fix_nis_per_dof), "{result:?}");
    assert!(result.position_rms_m < 0.0015, "{result:?}");
}

#[test]
fn half_metre_outliers_are_kept_out() {
    let scenario = Scenario { laps: 1, camera: Some(Camera { outliers: 0.03, ..LATE_10_HZ }) };
    let result = mean_over(&scenario, 20);
    report("3 % outliers of 0.5 m", &result);
    assert!(result.position_rms_m < 0.0016, "{result:?}");
}

#[test]
fn without_fixes_gyro_windows_keep_the_heading_honest() {
    let scenario = Scenario { laps: 1, camera: None };
    let result = mean_over(&scenario, 200);
    report("no camera", &result);
}

/// Scores over drives of robots whose geometry is drawn anew for each, and told as unknown.
fn mean_over_kits(laps: usize, camera: Option<Camera>, runs: u64) -> Score {
    let scores: Vec<Score> = (0..runs)
        .map(|seed| {
            let (drive, _) = drive_on_grid(laps, KIT, camera, seed);
            score(&drive, &play(&drive, &config_with(KIT)), 0)
        })
        .collect();
    mean(&scores)
}

const LATE_10_HZ: Camera = Camera { every: 2, delay: 3, spread: 1, outliers: 0.0 };

#[test]
fn with_unknown_geometry_and_late_fixes_the_errors_fit_their_covariance() {
    let result = mean_over_kits(1, Some(LATE_10_HZ), 40);
    report("unknown geometry, camera 10 Hz", &result);
    assert!((0.9..1.1).contains(&result.fix_nis_per_dof), "{result:?}");
    assert!(result.position_rms_m < 0.0015, "{result:?}");
}

#[test]
fn with_unknown_geometry_and_a_fix_per_second_the_errors_fit_their_covariance() {
    let camera = Camera { every: 20, delay: 6, spread: 2, outliers: 0.0 };
    let result = mean_over_kits(1, Some(camera), 40);
    report("unknown geometry, camera 1 Hz", &result);
    assert!((0.9..1.1).contains(&result.fix_nis_per_dof), "{result:?}");
    assert!(result.position_rms_m < 0.005, "{result:?}");
}

#[test]
fn with_unknown_geometry_and_no_fixes_the_errors_fit_their_covariance() {
    let result = mean_over_kits(1, None, 200);
    report("unknown geometry, no camera", &result);
}

#[test]
fn the_gyros_windows_have_the_innovations_that_they_should() {
    let (mut nis, mut count) = (0.0, 0.0);
    for seed in 0..20 {
        let (mut drive, _) = drive_on_grid(1, KIT, None, seed);
        // The gyro first: a window that closes before its last sample has come is judged by one that was held.
        drive.arrivals.sort_by_key(|arrival| (arrival.step, arrival.observation.sensor != SensorId::GYRO));
        let played = play(&drive, &config_with(KIT));
        for record in &played.records {
            if record.degrees_of_freedom == 1 && record.outcome == FusionOutcome::Accepted {
                nis += record.nis;
                count += 1.0;
            }
        }
    }
    let average = nis / count;
    println!("gyro windows: NIS {average:.3} over {count} windows: {}", verdict_on(average));
    assert!(BAND.contains(&average), "{average}");
}
