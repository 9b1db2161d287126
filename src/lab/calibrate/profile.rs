//! The robot profile of a calibration, for `run --robot FILE` and `replay --robot FILE`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use posebridge_link::HostTimer;
use posebridge_report::report::Report;
use posebridge_telemetry::{Calibration, UncertainValue};

use crate::config::{CalibratedRobot, Provenance, RobotFile};

/// Writes a profile; the report's lines become its comments. `calibration` is relative to the geometry of `robot`, and `method` the
/// command, such as `calibrate path`.
pub(super) fn save_profile(
    path: &Path,
    timer: &HostTimer,
    report: &Report,
    method: &str,
    source: String,
    (robot, learned): (RobotFile, Calibration),
) -> Result<()> {
    let provenance = Provenance { utc_micros: timer.utc_start(), source, filter: method.to_owned() };
    let text = profile_text(&report.text(), &CalibratedRobot { robot, learned, provenance })?;
    std::fs::write(path, text).with_context(|| format!("writing the profile `{}`", path.display()))
}

fn profile_text(remarks: &str, calibrated: &CalibratedRobot) -> Result<String> {
    let remarks: Vec<String> = remarks.lines().map(|line| format!("# {line}\n")).collect();
    Ok(format!(
        "{}# For a recording of the same robot: `posebridge replay RECORDING --robot FILE`.\n{}",
        remarks.concat(),
        calibrated.to_toml()?
    ))
}

/// Moves the calibration into the robot's geometry; the remaining calibration has the same sigmas about zero.
pub(super) fn fold_into_geometry(robot: &RobotFile, found: &Calibration) -> Result<(RobotFile, Calibration)> {
    let (scale, difference) = (found.radius_scale, found.radius_difference);
    let robot = RobotFile {
        left_wheel_radius_m: robot.left_wheel_radius_m * (1.0 + scale.value - 0.5 * difference.value),
        right_wheel_radius_m: robot.right_wheel_radius_m * (1.0 + scale.value + 0.5 * difference.value),
        track_width_m: robot.track_width_m * (1.0 + found.track_scale.value),
        ..robot.clone()
    };
    if let Err(error) = robot.geometry() {
        bail!("what was found is no robot: {error}");
    }
    // Relative to the new geometry a sigma is as much smaller as the geometry is larger.
    let about_zero = |known: UncertainValue| UncertainValue {
        value: 0.0,
        sigma: known.sigma / (1.0 + known.value).max(f64::MIN_POSITIVE),
    };
    let left = Calibration {
        radius_scale: about_zero(scale),
        radius_difference: UncertainValue { value: 0.0, ..difference },
        track_scale: about_zero(found.track_scale),
        ..*found
    };
    Ok((robot, left))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RobotProfile;

    #[test]
    fn a_profile_brings_the_geometry_its_sigmas_and_its_remarks_back() {
        let known = |value, sigma| UncertainValue { value, sigma };
        let found = Calibration {
            radius_scale: known(0.1, 0.011),
            radius_difference: known(0.02, 0.001),
            track_scale: known(-0.5, 0.01),
            ..Calibration::default()
        };
        let (robot, learned) = fold_into_geometry(&RobotFile::default(), &found).unwrap();
        let provenance = Provenance { utc_micros: 0, source: "here".to_owned(), filter: "calibrate path".to_owned() };
        let text = profile_text("rms 3 mm\nof 2 runs", &CalibratedRobot { robot, learned, provenance }).unwrap();
        assert!(text.starts_with("# rms 3 mm\n# of 2 runs\n"), "{text}");
        for command in ["run --robot FILE", "replay RECORDING --robot FILE"] {
            assert!(text.contains(command), "{text}");
        }
        let robot = RobotProfile::from_toml(&text).unwrap().robot;
        assert!((robot.left_wheel_radius_m - 0.028 * 1.09).abs() < 1e-15);
        assert!((robot.right_wheel_radius_m - 0.028 * 1.11).abs() < 1e-15);
        assert!((robot.track_width_m - 0.056).abs() < 1e-15);
        let prior = robot.calibration().unwrap();
        assert!((prior.radius_scale.sigma - 0.01).abs() < 1e-15);
        assert!((prior.track_scale.sigma - 0.02).abs() < 1e-15);
        assert_eq!(prior.track_scale.value, 0.0);
    }

    #[test]
    fn what_is_no_robot_is_not_written() {
        let found = Calibration { track_scale: UncertainValue { value: -1.5, sigma: 0.1 }, ..Calibration::default() };
        let error = fold_into_geometry(&RobotFile::default(), &found).unwrap_err().to_string();
        assert!(error.contains("track_width_m"), "{error}");
    }
}
