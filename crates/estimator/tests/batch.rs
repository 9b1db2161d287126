//! The smoothed path against truth, and against the filter that had to answer at once.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when there is no smoothed path")]

#[path = "support/drive.rs"]
mod drive;
#[path = "support/grid.rs"]
mod grid;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/score.rs"]
mod score;

use drive::{Camera, Drive, Scenario, drive, stamp};
use grid::{KIT, config_with, drive_on_grid};
use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::smoother::{
    FixArrival, FixContent, GroundTruthRun, SmoothedTrajectory, batch, cramer_rao_bound,
};
use posebridge_telemetry::{
    Arena, Heading, Meters, Observation, ObservationKind, Pose, SensorId, quantities::wrap_rad,
};
use robot::{RADIUS_M, config};

/// 10 Hz, 150 ± 50 ms late.
const CAMERA: Camera = Camera { every: 2, delay: 3, spread: 1, outliers: 0.0 };

fn observations(drive: &Drive) -> Vec<Observation> {
    let arrivals = drive.arrivals.iter();
    arrivals.map(|arrival| arrival.observation).collect()
}

fn smooth(drive: &Drive, config: &FilterConfig) -> SmoothedTrajectory {
    batch(config, &observations(drive)).expect("it converges")
}

/// Means over runs: squares of the position error and of the heading error, NEES over three degrees of freedom.
#[derive(Default)]
struct Scores {
    runs: f64,
    position_m2: f64,
    heading_rad2: f64,
    nees: f64,
}

impl Scores {
    fn add(&mut self, drive: &Drive, smoothed: &SmoothedTrajectory) {
        assert_eq!(smoothed.poses.len(), drive.poses.len());
        let count = drive.poses.len() as f64;
        self.runs += 1.0;
        for (index, (own, truth)) in smoothed.poses.iter().zip(&drive.poses).enumerate() {
            assert_eq!(own.stamp, stamp(index + 1));
            let error = Vector3::new(
                own.pose.x.0 - truth.0,
                own.pose.y.0 - truth.1,
                wrap_rad(own.pose.heading.rad() - truth.2),
            );
            let p = Matrix3::from_fn(|row, column| own.covariance[row][column]);
            let inverse = p.try_inverse().expect("a covariance");
            self.position_m2 += (error[0] * error[0] + error[1] * error[1]) / count;
            self.heading_rad2 += error[2] * error[2] / count;
            self.nees += (error.transpose() * inverse * error)[0] / 3.0 / count;
        }
    }

    fn position_rms_m(&self) -> f64 {
        (self.position_m2 / self.runs).sqrt()
    }

    fn heading_rms_rad(&self) -> f64 {
        (self.heading_rad2 / self.runs).sqrt()
    }

    fn anees(&self) -> f64 {
        self.nees / self.runs
    }

    fn summary(&self, what: &str) -> String {
        format!(
            "{what}: {} runs, {:.3} mm, {:.3} degrees, ANEES {:.2}",
            self.runs,
            1e3 * self.position_rms_m(),
            self.heading_rms_rad().to_degrees(),
            self.anees()
        )
    }
}

#[test]
fn four_laps_with_unknown_geometry_stay_within_eight_tenths_of_a_millimetre() {
    let mut scores = Scores::default();
    for seed in 0..12 {
        let (drive, geometry) = drive_on_grid(4, KIT, Some(CAMERA), seed);
        let smoothed = smooth(&drive, &config_with(KIT));
        scores.add(&drive, &smoothed);
        let found = smoothed.calibration.radius_scale;
        let mean_radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
        let error = found.value - (mean_radius_m / RADIUS_M - 1.0);
        assert!(error.abs() < 4.0 * found.sigma && found.sigma < 0.000_5);
    }
    println!("{}", scores.summary("camera 10 Hz, unknown geometry, 4 laps"));
    assert!(scores.position_rms_m() <= 0.8e-3);
    assert!((0.8..1.25).contains(&scores.anees()));
}

#[test]
fn hindsight_is_clearly_better_than_the_filter_and_honest() {
    let scenario = Scenario { laps: 1, camera: Some(CAMERA) };
    let mut scores = Scores::default();
    let mut filtered = vec![];
    for seed in 0..20 {
        let drive = drive(&scenario, seed);
        scores.add(&drive, &smooth(&drive, &config()));
        filtered.push(score::score(&drive, &score::play(&drive, &config()), 0));
    }
    println!("{}", scores.summary("camera 10 Hz, known geometry, 1 lap"));
    let filtered = score::mean(&filtered);
    println!("the filter: {filtered:?}");
    assert!((0.8..1.25).contains(&scores.anees()));
    assert!(scores.position_rms_m() < 0.7 * filtered.position_rms_m);
    assert!(scores.heading_rms_rad() < 0.9 * filtered.heading_rms_rad);
}

#[test]
fn half_metre_outliers_do_no_harm() {
    let scenario = Scenario { laps: 1, camera: Some(Camera { outliers: 0.1, ..CAMERA }) };
    let mut scores = Scores::default();
    for seed in 0..10 {
        let drive = drive(&scenario, seed);
        let smoothed = smooth(&drive, &config());
        let fixes = smoothed.fixes_used + smoothed.fixes_rejected;
        let share = smoothed.fixes_rejected as f64 / fixes as f64;
        assert!((0.05..0.16).contains(&share), "seed {seed}: {share}");
        scores.add(&drive, &smoothed);
    }
    println!("{}", scores.summary("10 % outliers of 0.5 m"));
    assert!(scores.position_rms_m() < 0.9e-3);
    assert!((0.8..1.3).contains(&scores.anees()));
}

#[test]
fn without_a_camera_a_lap_has_the_covariance_that_it_claims() {
    let scenario = Scenario { laps: 1, camera: None };
    let mut scores = Scores::default();
    for seed in 0..60 {
        let drive = drive(&scenario, seed);
        scores.add(&drive, &smooth(&drive, &config()));
    }
    println!("{}", scores.summary("no camera, 1 lap"));
    assert!((0.7..1.3).contains(&scores.anees()));
}

#[test]
fn the_filter_does_not_beat_the_bound_and_comes_near_it() {
    let scenario = Scenario { laps: 1, camera: Some(CAMERA) };
    let (mut squares_m2, mut bounds_m2) = (0.0, 0.0);
    for seed in 0..20 {
        let drive = drive(&scenario, seed);
        let played = score::play(&drive, &config());
        squares_m2 += score::score(&drive, &played, 0).position_rms_m.powi(2);
        let bounds = bound_of(&drive, &config());
        bounds_m2 += bounds.iter().sum::<f64>() / bounds.len() as f64;
    }
    let ratio = f64::sqrt(squares_m2 / bounds_m2);
    println!("bound {:.3} mm, error over bound {ratio:.3}", 1e3 * f64::sqrt(bounds_m2 / 20.0));
    assert!((0.95..1.15).contains(&ratio), "{ratio}");
}

/// The bound of a drive, with its own fixes and their delays.
fn bound_of(drive: &Drive, config: &FilterConfig) -> Vec<f64> {
    let mut poses = vec![Pose::<Arena>::default()];
    poses
        .extend(drive.poses.iter().map(|&(x, y, heading)| Pose::new(Meters(x), Meters(y), Heading::from_rad(heading))));
    let mut travel = vec![];
    let mut last = (0.0, 0.0);
    let mut fixes = vec![];
    for arrival in &drive.arrivals {
        let observation = &arrival.observation;
        if let ObservationKind::WheelAngles { left, right } = observation.measurement {
            travel.push(WheelTravel { left_m: RADIUS_M * (left.0 - last.0), right_m: RADIUS_M * (right.0 - last.1) });
            last = (left.0, right.0);
        } else if observation.sensor == SensorId::CAMERA {
            let taken = (observation.stamp.as_secs_f64() / drive::STEP_S).round();
            fixes.push(FixArrival {
                exposure_step: taken as usize,
                arrival_step: arrival.step,
                content: FixContent::Pose,
            });
        }
    }
    cramer_rao_bound(config, &GroundTruthRun { poses: &poses, travel: &travel, step_s: drive::STEP_S, fixes: &fixes })
}
