//! The calibration that a filter estimated in a run: printed, and saved as a robot profile.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_recording::robot_names::RobotNames;
use posebridge_report::tables::{TextTable, wrapped};
use posebridge_station::{Robot, Station};
use posebridge_telemetry::{Calibration, DriveGeometry};

use super::per_robot::file_parts;
use crate::config::{CalibratedRobot, CalibrationKey, Config, Provenance, RobotFile, learnable_keys};

/// A robot's calibration before and after a run.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedCalibration {
    pub run: String,
    /// With the geometry that the filter used.
    pub robot: RobotFile,
    pub prior: Calibration,
    pub calibration: Calibration,
}

impl LearnedCalibration {
    /// Calibrations of the session's robots, if their filters are adaptive and got observations. With several robots, the robot is
    /// appended to `run`.
    pub fn of_session(station: &Station, run: &str, config: &Config) -> Result<Vec<Self>> {
        let robots = station.robots();
        let mut names = RobotNames::default();
        let mut learned = Vec::new();
        for robot in robots {
            let file = config.robot_file(Some(robot));
            let prior = config.filter_config_of(file)?.calibration;
            names.insert(robot.id(), robot.name().unwrap_or_default());
            let name = if robots.len() > 1 { format!("{run} {}", names.label(robot.id())) } else { run.to_owned() };
            learned.extend(Self::of_robot(robot, &name, file, &prior));
        }
        Ok(learned)
    }

    /// `None` if the filter is not adaptive, or without observations.
    pub fn of_robot(robot: &Robot, run: &str, file: &RobotFile, prior: &Calibration) -> Option<Self> {
        robot.latest_time()?;
        Some(Self {
            run: run.to_owned(),
            robot: with_geometry(file, robot.geometry()),
            prior: *prior,
            calibration: robot.calibration()?,
        })
    }
}

/// Replaces the file's geometry by the one in use, which a robot may have described: the calibration is relative to it.
pub fn with_geometry(robot: &RobotFile, used: DriveGeometry) -> RobotFile {
    let is_own = robot.geometry().is_ok_and(|own| own == used);
    if is_own { robot.clone() } else { robot.with_geometry(&used) }
}

/// A constant whose sigma did not shrink below this share of its prior's was not learned.
const LEARNED_SHARE: f64 = 0.99;

impl LearnedCalibration {
    /// Keys of the constants that were open and were learned.
    pub fn learned_keys(&self) -> Vec<&'static str> {
        learnable_keys().filter(|entry| self.has_learned(entry)).map(|entry| entry.key).collect()
    }

    fn has_learned(&self, entry: &CalibrationKey) -> bool {
        let (before, after) = ((entry.read)(&self.prior), (entry.read)(&self.calibration));
        before.sigma > 0.0 && after.sigma <= LEARNED_SHARE * before.sigma
    }

    /// Keys of the constants that were open and are as before.
    fn unlearned_keys(&self) -> Vec<&'static str> {
        let open = learnable_keys().filter(|entry| (entry.read)(&self.prior).sigma > 0.0);
        open.filter(|entry| !self.has_learned(entry)).map(|entry| entry.key).collect()
    }
}

/// A table of the constants that were learned in each run, and a line with the names of those that were not; empty without any.
pub fn learned_table(runs: &[LearnedCalibration]) -> String {
    let mut text = String::new();
    for learned in runs {
        if runs.len() > 1 {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{}", learned.run);
        }
        let mut table = TextTable::new(["learned", "value", "± sigma", "before", "± sigma"]);
        for entry in learnable_keys().filter(|entry| learned.has_learned(entry)) {
            let values = [&learned.calibration, &learned.prior].map(|calibration| (entry.read)(calibration));
            let cells = values.iter().flat_map(|known| [format!("{:+.5}", known.value), format!("{:.5}", known.sigma)]);
            table.push(std::iter::once(entry.key.to_owned()).chain(cells));
        }
        if !learned.learned_keys().is_empty() {
            text += &table.render();
        }
        let unlearned = learned.unlearned_keys();
        if !unlearned.is_empty() {
            text += &wrapped("not shown  ", &unlearned.join(", "));
        }
    }
    text
}

/// Writes each robot with its calibration as a profile: one to the path; for several, file names derived from it.
pub fn save_all(path: &Path, learned: &[LearnedCalibration], provenance: &Provenance) -> Result<()> {
    if let [learned] = learned {
        return save(path, learned, provenance);
    }
    let stem = path.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default();
    let parts = file_parts(learned.iter().map(|learned| learned.run.as_str()));
    for (learned, part) in learned.iter().zip(parts) {
        save(&path.with_file_name(format!("{stem}-{part}.toml")), learned, provenance)?;
    }
    Ok(())
}

pub fn save(path: &Path, learned: &LearnedCalibration, provenance: &Provenance) -> Result<()> {
    let calibrated =
        CalibratedRobot { robot: learned.robot.clone(), learned: learned.calibration, provenance: provenance.clone() };
    std::fs::write(path, calibrated.to_toml()?)
        .with_context(|| format!("writing the calibration to `{}`", path.display()))
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Meters, UncertainValue};

    use super::*;

    fn learned() -> LearnedCalibration {
        let known = |value, sigma| UncertainValue { value, sigma };
        LearnedCalibration {
            run: "robot4".to_owned(),
            robot: RobotFile::default(),
            prior: Calibration { track_scale: known(0.0, 0.1), ..Calibration::default() },
            calibration: Calibration {
                track_scale: known(0.1161, 0.0042),
                radius_scale: known(0.0, 0.0),
                ..Calibration::default()
            },
        }
    }

    #[test]
    fn a_prior_is_not_reported_as_learned() {
        let known = |value, sigma| UncertainValue { value, sigma };
        let mut learned = learned();
        learned.prior.gyro_scale = known(0.0, 0.01);
        learned.calibration.gyro_scale = known(0.0, 0.01);
        let table = learned_table(std::slice::from_ref(&learned));
        let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[1], ["track_scale", "+0.11610", "0.00420", "+0.00000", "0.10000"]);
        assert_eq!(rows[2], ["not", "shown", "gyro_scale"], "{table}");
        assert_eq!(learned.learned_keys(), ["track_scale"]);
    }

    #[test]
    fn each_robot_has_a_file_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let robots = ["a 1", "a-1"].map(|run| LearnedCalibration { run: run.to_owned(), ..learned() });
        let provenance = Provenance { utc_micros: 0, source: String::new(), filter: "pose".to_owned() };
        save_all(&folder.path().join("learned.toml"), &robots, &provenance).unwrap();
        for name in ["learned-a-1.toml", "learned-a-1-2.toml"] {
            assert!(folder.path().join(name).is_file(), "{name}");
        }
    }

    #[test]
    fn a_calibration_goes_with_the_geometry_that_the_robot_has_described() {
        let file = RobotFile::default();
        let own = file.geometry().unwrap();
        assert_eq!(with_geometry(&file, own), file);
        let described = DriveGeometry { track_width: Meters(0.2), ..own };
        let used = with_geometry(&file, described);
        assert_eq!((used.track_width_m, used.name), (0.2, file.name));
    }
}
