//! The flagship against truth with the configured noise: errors must fit their covariance.
//!
//! The robot, its path and its noise are those of the Monte-Carlo in docs/maths/pose.md section 9, with the geometry known and
//! unknown. Every case prints its verdict in words.

use posebridge_telemetry::{FusionOutcome, SensorId};

use crate::support::robot::{config, learning_geometry};
use crate::support::score::{mean_score, play};
use crate::support::simulation::{CAMERA_10_HZ, Camera, drive_lap, drive_on_grid};

/// 95 % band of the average NEES over independent runs, as a ratio to three degrees of freedom, widened by what errors
/// correlated over a run leave: Bar-Shalom, Li, Kirubarajan (2001), chapter 5, give [0.79, 1.24] for 50 independent samples.
const BAND: std::ops::RangeInclusive<f64> = 0.79..=1.24;

/// An average of normalised squares, which should be one.
fn verdict_on(average: f64) -> &'static str {
    if average > *BAND.end() {
        "over-confident: its errors are larger than it claims"
    } else if average < *BAND.start() {
        "under-confident: its errors are smaller than it claims"
    } else {
        "honest: its errors are as large as it claims"
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Geometry {
    Known,
    /// Drawn anew for each run, and configured as unknown.
    Learned,
}

/// Plays runs of one lap; the errors must fit their covariance, those of fixes too, and be smaller than `most_m`.
fn check(case: &str, geometry: Geometry, camera: Option<Camera>, runs: u64, most_m: f64) {
    let result = mean_score(runs, 0, |seed| match geometry {
        Geometry::Known => (drive_lap(camera, seed), config()),
        Geometry::Learned => (drive_on_grid(1, camera, seed).0, learning_geometry()),
    });
    println!(
        "{case}: {:.2} mm, {:.2} degrees, ANEES {:.2}, NIS {:.2}: {}",
        result.position_rms_m * 1e3,
        result.heading_rms_rad.to_degrees(),
        result.anees,
        result.fix_nis_per_dof,
        verdict_on(result.anees)
    );
    assert!(BAND.contains(&result.anees), "{case}: {}", verdict_on(result.anees));
    let has_outliers = camera.is_some_and(|camera| camera.outliers > 0.0);
    assert!(camera.is_none() || has_outliers || (0.9..1.1).contains(&result.fix_nis_per_dof), "{case}: {result:?}");
    assert!(result.position_rms_m < most_m, "{case}: {result:?}");
}

#[test]
fn with_fixes_the_errors_fit_their_covariance() {
    let outliers = Camera { outliers: 0.03, ..CAMERA_10_HZ };
    let one_hz = Camera { every: 20, delay: 6, spread: 2, outliers: 0.0 };
    check("camera 10 Hz, 150 ± 50 ms late", Geometry::Known, Some(CAMERA_10_HZ), 20, 0.0015);
    check("3 % outliers of 0.5 m", Geometry::Known, Some(outliers), 20, 0.0016);
    check("unknown geometry, camera 10 Hz", Geometry::Learned, Some(CAMERA_10_HZ), 40, 0.0015);
    check("unknown geometry, camera 1 Hz", Geometry::Learned, Some(one_hz), 40, 0.005);
}

#[test]
fn without_fixes_the_errors_fit_their_covariance() {
    check("no camera", Geometry::Known, None, 200, f64::INFINITY);
    check("unknown geometry, no camera", Geometry::Learned, None, 200, f64::INFINITY);
}

#[test]
fn the_gyros_windows_have_the_innovations_that_they_should() {
    let (mut nis, mut count) = (0.0, 0.0);
    for seed in 0..20 {
        let (mut drive, _) = drive_on_grid(1, None, seed);
        // The gyro first: a window that closes before its last sample has come is evaluated with one that was held.
        drive.arrivals.sort_by_key(|arrival| (arrival.step, arrival.observation.sensor != SensorId::GYRO));
        for record in &play(&drive, &learning_geometry()).records {
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
