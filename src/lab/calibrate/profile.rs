//! The robot profile of a calibration, for `run --robot FILE` and `replay --robot FILE`.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail};
use posebridge_telemetry::{Calibration, UncertainValue};

use crate::config::{CalibratedRobot, Provenance, RobotFile};

pub(super) struct CalibratedProfile {
    /// With the calibrated geometry.
    pub(super) robot: RobotFile,
    /// Remaining calibration, relative to that geometry.
    pub(super) calibration: Calibration,
    pub(super) source: String,
    /// The command, such as `calibrate path`.
    pub(super) method: &'static str,
    /// Residuals and findings; each becomes a comment.
    pub(super) remarks: Vec<String>,
}

impl CalibratedProfile {
    pub(super) fn to_toml(&self, utc_micros: u64) -> Result<String> {
        let calibrated = CalibratedRobot {
            robot: self.robot.clone(),
            learned: self.calibration,
            provenance: Provenance { utc_micros, source: self.source.clone(), filter: self.method.to_owned() },
        };
        let mut text = String::new();
        for remark in &self.remarks {
            for line in remark.lines() {
                // Writing to a String cannot fail.
                let _ = writeln!(text, "# {line}");
            }
        }
        text.push_str("# For a recording of the same robot: `posebridge replay RECORDING --robot FILE`.\n");
        Ok(text + &calibrated.to_toml()?)
    }

    pub(super) fn save(&self, path: &Path, utc_micros: u64) -> Result<()> {
        std::fs::write(path, self.to_toml(utc_micros)?)
            .with_context(|| format!("writing the profile `{}`", path.display()))
    }
}

/// Moves the calibration into the robot's geometry; the remaining calibration has the same sigmas about zero.
pub(super) fn fold_into_geometry(robot: &RobotFile, found: Calibration) -> Result<(RobotFile, Calibration)> {
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
        ..found
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
        let (robot, calibration) = fold_into_geometry(&RobotFile::default(), found).unwrap();
        let calibrated = CalibratedProfile {
            robot,
            calibration,
            source: "here".to_owned(),
            method: "calibrate path",
            remarks: vec!["rms 3 mm\nof 2 runs".to_owned()],
        };
        let text = calibrated.to_toml(0).unwrap();
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
        let error = fold_into_geometry(&RobotFile::default(), found).unwrap_err().to_string();
        assert!(error.contains("track_width_m"), "{error}");
    }
}
