//! Detects any change of the pose filter's estimates, intended or not.
//!
//! A seeded drive is played, and the estimate of every second is compared with what an earlier version of this program wrote. The
//! files are its own output: they show that something changed, not that anything is right. When a change is wanted:
//!
//! ```sh
//! POSEBRIDGE_WRITE_CHANGE_INDICATION=1 cargo test -p posebridge-estimator --test estimator change_indication
//! ```
//!
//! and the commit says why the numbers moved.

use std::path::PathBuf;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::SensorId;

use crate::support::filters::named;
use crate::support::robot::{config, learning_geometry, unknown};
use crate::support::simulation::{
    Camera, Drive, SimulatedSensors, add, add_accelerometers, drive_lap, drive_on_grid, furnished, stamp,
};

const HEADER: &str = "t_s,x_m,y_m,heading_rad,forward_m_per_s,turn_rad_per_s,x_sigma_m,y_sigma_m,heading_sigma_rad,reset_counter,radius_scale,track_scale,gyro_bias_rad_per_s";

/// How far a number may be off, in its own unit: beyond any difference of compilers and processors, below any of meaning.
const ALLOWED: f64 = 1e-6;

/// Twenty steps are a second.
const EVERY: usize = 20;

const CAMERA: Camera = Camera { every: 2, delay: 3, spread: 1, outliers: 0.03 };

fn rows_of(drive: &Drive, config: &FilterConfig) -> Vec<Vec<f64>> {
    let mut filter = named("pose", config);
    let mut arrivals = drive.arrivals.iter().peekable();
    let mut rows = vec![];
    for step in 1..=drive.poses.len() {
        while let Some(next) = arrivals.next_if(|next| next.step <= step) {
            filter.observe(&next.observation);
        }
        if step.is_multiple_of(EVERY) {
            let estimate = filter.estimate_at(stamp(step)).expect("it was observed");
            let learned = filter.calibration().expect("it learns");
            rows.push(vec![
                (estimate.stamp - stamp(0)).as_secs_f64(),
                estimate.pose.x.0,
                estimate.pose.y.0,
                estimate.pose.heading.rad(),
                estimate.forward_speed.0,
                estimate.turn_rate.0,
                estimate.x_sigma_m(),
                estimate.y_sigma_m(),
                estimate.heading_sigma_rad(),
                f64::from(estimate.reset_counter),
                learned.radius_scale.value,
                learned.track_scale.value,
                learned.gyro_bias_rad_per_s.value,
            ]);
        }
    }
    rows
}

fn written(rows: &[Vec<f64>]) -> String {
    let mut text = format!("{HEADER}\n");
    for row in rows {
        let numbers: Vec<String> = row.iter().map(|number| format!("{number:.9}")).collect();
        text.push_str(&numbers.join(","));
        text.push('\n');
    }
    text
}

fn read(text: &str) -> Vec<Vec<f64>> {
    let numbers = |line: &str| line.split(',').map(|number| number.parse().expect("a number")).collect();
    text.lines().skip(1).map(numbers).collect()
}

/// Compares rows with those of a file, or writes them there on request.
fn hold_against(name: &str, rows: &[Vec<f64>]) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/change_indication").join(name);
    if std::env::var_os("POSEBRIDGE_WRITE_CHANGE_INDICATION").is_some() {
        std::fs::write(&path, written(rows)).expect("the file can be written");
        return;
    }
    let text = std::fs::read_to_string(&path).expect("the file is committed");
    let earlier = read(&text);
    let hint = "if the change is wanted, write the file anew with POSEBRIDGE_WRITE_CHANGE_INDICATION=1 and say why in the commit";
    assert_eq!(text.lines().next(), Some(HEADER), "{hint}");
    assert_eq!(rows.len(), earlier.len(), "{name}: {hint}");
    let names: Vec<&str> = HEADER.split(',').collect();
    for (row, earlier) in rows.iter().zip(&earlier) {
        for (column, (found, expected)) in row.iter().zip(earlier).enumerate() {
            assert!(
                (found - expected).abs() <= ALLOWED,
                "{name}: at {} s {} is {found:.9}, was {expected:.9}; {hint}",
                row[0],
                names[column]
            );
        }
    }
}

#[test]
fn a_known_geometry_without_a_camera_is_followed_as_before() {
    hold_against("no_camera.csv", &rows_of(&drive_lap(None, 20_260_106), &config()));
}

#[test]
fn late_fixes_and_an_unknown_geometry_are_followed_as_before() {
    let (drive, _) = drive_on_grid(1, Some(CAMERA), 20_260_104);
    hold_against("late_camera.csv", &rows_of(&drive, &learning_geometry()));
}

#[test]
fn every_sensor_and_every_state_are_followed_as_before() {
    let mut config = furnished(&learning_geometry());
    config.calibration.fix_delay_s = unknown(0.1);
    config.calibration.beacon_offset_m = unknown(0.3);
    config.calibration.beacon_scale = unknown(0.02);
    let (mut drive, _) = drive_on_grid(1, Some(CAMERA), 20_260_105);
    let mut senses = SimulatedSensors::new(&config, 20_260_105);
    add(&mut drive, SensorId::LANDMARKS, 5, |_, truth| senses.landmarks(truth));
    add(&mut drive, SensorId::BEACONS, 7, |_, truth| {
        senses.beacons(truth, &[(0.2, 0.01), (0.0, 0.0), (-0.1, 0.02), (0.3, -0.01)])
    });
    add(&mut drive, SensorId::RANGE, 3, |_, truth| senses.wall(truth));
    add(&mut drive, SensorId::COMPASS, 4, |_, truth| senses.compass(truth));
    add_accelerometers(&mut drive, &mut senses);
    hold_against("every_sensor.csv", &rows_of(&drive, &config));
}
