//! Robot profiles: reads a robot from any file that describes one, and writes a calibrated robot as a file for `--robot`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail};
use posebridge_telemetry::{Calibration, UncertainValue};
use serde::Deserialize;

use super::Config;
use super::calibration::{CALIBRATION_KEYS, RobotCalibration};
use super::mounting::RobotMounting;
use super::robot::{RobotFile, RobotStart};
use crate::text_file::read_text;

/// Content of the file of `--robot FILE`: `[robot]` and `[filter]` of a robot profile, a station's configuration or a descriptor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotProfile {
    pub robot: RobotFile,
    pub filter: ProfileFilter,
}

/// The `[filter]` of a profile or a descriptor; missing keys keep their values.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default)]
pub struct ProfileFilter {
    pub name: Option<String>,
    #[serde(flatten)]
    pub params: BTreeMap<String, f64>,
}

impl RobotProfile {
    /// A robot profile, a station's configuration or a recording's descriptor.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display();
        let text = read_text(path).with_context(|| format!("reading the robot from `{name}`"))?;
        Self::from_toml(&text).with_context(|| format!("robot `{name}`"))
    }

    pub fn from_toml(text: &str) -> Result<Self> {
        let table: toml::Table = toml::from_str(text)?;
        let Some(robot) = table.get("robot") else { bail!("there is no [robot] table") };
        let mut robot: RobotFile = robot.clone().try_into().context("[robot]")?;
        // A descriptor keeps the start beside the robot, because it belongs to the recording.
        if let (None, Some(start)) = (robot.start, table.get("start").and_then(toml::Value::as_table)) {
            robot.start = start_of(start);
        }
        let filter = match table.get("filter") {
            None => ProfileFilter::default(),
            Some(filter) => filter.clone().try_into().context("[filter]")?,
        };
        Ok(Self { robot, filter })
    }
}

impl Config {
    /// Replaces the robot and applies the profile's tunables.
    pub fn with_robot(mut self, profile: RobotProfile) -> Self {
        self.robot = profile.robot;
        self.filter.params.extend(profile.filter.params);
        if let Some(name) = profile.filter.name {
            self.filter.name = name;
        }
        self
    }
}

/// The `[start]` of a descriptor, if it contains a pose; a start from the data is left to the first fixes.
fn start_of(start: &toml::Table) -> Option<RobotStart> {
    let number = |key: &str| {
        let value = start.get(key)?;
        value.as_float().or(value.as_integer().map(|whole| whole as f64))
    };
    let degrees =
        |stem: &str| number(&format!("{stem}_deg")).or_else(|| number(&format!("{stem}_rad")).map(f64::to_degrees));
    Some(RobotStart {
        x_m: number("x_m")?,
        y_m: number("y_m")?,
        heading_deg: degrees("heading")?,
        position_sigma_m: number("position_sigma_m")?,
        heading_sigma_deg: degrees("heading_sigma")?,
    })
}

#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedRobot {
    /// As configured, with the geometry that the filter used.
    pub robot: RobotFile,
    /// Relative to that geometry.
    pub learned: Calibration,
    pub provenance: Provenance,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Microseconds since 1970 (UTC).
    pub utc_micros: u64,
    pub source: String,
    pub filter: String,
}

impl CalibratedRobot {
    /// The robot in the profile.
    ///
    /// Without a start pose, which belongs to the run. The brick's own description is not adopted: it would bring back the geometry to
    /// which the calibration does not belong.
    pub fn profile(&self) -> RobotFile {
        RobotFile {
            start: None,
            adopt_description: false,
            calibration: RobotCalibration::from(self.profile_calibration()),
            mounting: RobotMounting::from(&self.learned.mountings),
            ..self.robot.clone()
        }
    }

    /// The calibration at the next power-up: a gyro's bias changes each time, so its last value is a better guess than zero, but with
    /// the original sigma.
    fn profile_calibration(&self) -> Calibration {
        let bias = self.learned.gyro_bias_rad_per_s;
        Calibration {
            gyro_bias_rad_per_s: UncertainValue { sigma: bias.sigma.max(self.robot.noise.gyro_bias_rad_per_s), ..bias },
            ..self.learned
        }
    }

    /// The profile as TOML. Fails if a learned value is outside the limits that `--robot` accepts.
    pub fn to_toml(&self) -> Result<String> {
        let profile = self.profile();
        profile.calibration().context("what was learned is no calibration")?;
        let mut robot = toml::Table::try_from(profile)?;
        let noise = robot.remove("noise");
        // A table inside a table would make sections of one number each.
        robot.remove("calibration");
        let mounting = robot.remove("mounting");
        let from = &self.provenance;
        let text = |value: &str| toml::Value::String(value.to_owned());
        let mut page = String::from(
            "# A robot with what a filter has learned about it; give it with `posebridge run --robot FILE`.\n",
        );
        // Writing to a String cannot fail.
        let _ = writeln!(page, "\n[calibrated]");
        let _ = writeln!(page, "date = {}", utc_date(from.utc_micros));
        let _ = writeln!(page, "source = {}", text(&from.source));
        let _ = writeln!(page, "filter = {}", text(&from.filter));
        write_section(&mut page, "robot", &robot);
        if let Some(toml::Value::Table(noise)) = noise {
            write_section(&mut page, "robot.noise", &noise);
        }
        if let Some(toml::Value::Table(mounting)) = mounting {
            write_section(&mut page, "robot.mounting", &mounting);
        }
        let _ = writeln!(page, "\n[robot.calibration]");
        let profile = self.profile_calibration();
        for entry in CALIBRATION_KEYS {
            let UncertainValue { value, sigma } = (entry.read)(&profile);
            let (value, sigma) = (toml::Value::Float(value), toml::Value::Float(sigma));
            let _ = writeln!(page, "{} = {{ value = {value}, sigma = {sigma} }}", entry.key);
        }
        let bias = self.learned.gyro_bias_rad_per_s;
        let _ = writeln!(
            page,
            "# The gyro's bias was known to {} rad/s at the end; the next power-up brings another one.",
            bias.sigma
        );
        Ok(page)
    }
}

fn write_section(page: &mut String, name: &str, section: &toml::Table) {
    // Writing to a String cannot fail.
    let _ = writeln!(page, "\n[{name}]");
    for (key, value) in section {
        let _ = writeln!(page, "{key} = {value}");
    }
}

/// Days from 0000-03-01 to 1970-01-01 in the Gregorian calendar.
const DAYS_BEFORE_EPOCH: u64 = 719_468;
/// Days of 400 Gregorian years, after which the calendar repeats.
const DAYS_OF_ERA: u64 = 146_097;

/// Date and time of day as in RFC 3339, to the second.
///
/// Years are counted from March, so that the leap day is the last of its year and months follow a pattern of 153 days in five.
pub fn utc_date(utc_micros: u64) -> String {
    let seconds = utc_micros / 1_000_000;
    let days = seconds / 86_400 + DAYS_BEFORE_EPOCH;
    let (era, day_of_era) = (days / DAYS_OF_ERA, days % DAYS_OF_ERA);
    let leap_days = day_of_era / 1_460 + day_of_era / 146_096 - day_of_era / 36_524;
    let year_of_era = (day_of_era - leap_days) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = (month_from_march + 2) % 12 + 1;
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute, second) = (seconds / 3_600 % 24, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{RobotProfile, RobotStart};

    #[test]
    fn a_profile_brings_its_tunables_and_leaves_the_others() {
        let mut config = Config::default();
        config.filter.params.insert("history_s".to_owned(), 5.0);
        config.filter.params.insert("slip_nis".to_owned(), 6.0);
        let text = "[robot]\ntrack_width_m = 0.2\n[filter]\nslip_nis = 7\n";
        let profile = RobotProfile::from_toml(text).unwrap();
        let filter_config = config.with_robot(profile).filter_config().unwrap();
        assert_eq!(filter_config.geometry.track_width.0, 0.2);
        assert_eq!(filter_config.params.history_s, 5.0);
        assert_eq!(filter_config.params.slip_nis, 7.0);
    }

    #[test]
    fn a_profile_may_name_its_filter() {
        let text = "[robot]\n[filter]\nname = \"odometry\"\n";
        let profile = RobotProfile::from_toml(text).unwrap();
        assert_eq!(Config::default().with_robot(profile).filter.name, "odometry");
    }

    #[test]
    fn a_file_without_a_robot_is_no_profile() {
        let error = RobotProfile::from_toml("[filter]\n").unwrap_err();
        assert_eq!(error.to_string(), "there is no [robot] table");
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        // `date -u -d @SECONDS`
        for (seconds, date) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_709_251_200, "2024-03-01T00:00:00Z"),
            (1_767_225_599, "2025-12-31T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(utc_date(seconds * 1_000_000 + 999_999), date);
        }
    }

    fn calibrated() -> CalibratedRobot {
        let mut robot = RobotFile {
            name: "a \"blue\" robot".to_owned(),
            track_width_m: 0.155,
            start: Some(RobotStart {
                x_m: 1.0,
                y_m: 2.0,
                heading_deg: 90.0,
                position_sigma_m: 0.1,
                heading_sigma_deg: 1.0,
            }),
            ..RobotFile::default()
        };
        robot.noise.gyro_bias_rad_per_s = 0.03;
        let known = |value, sigma| UncertainValue { value, sigma };
        CalibratedRobot {
            robot,
            learned: Calibration {
                track_scale: known(0.116, 0.004),
                fix_delay_s: known(0.1875, 0.0123),
                gyro_bias_rad_per_s: known(-0.0101, 0.0002),
                ..Calibration::default()
            },
            provenance: Provenance {
                utc_micros: 1_709_251_200_000_000,
                source: "lego \\ run".to_owned(),
                filter: "pose".to_owned(),
            },
        }
    }

    #[test]
    fn a_saved_robot_is_loaded_as_it_was_learned() {
        let calibrated = calibrated();
        let text = calibrated.to_toml().unwrap();
        let loaded = RobotProfile::from_toml(&text).unwrap().robot;
        assert_eq!(loaded, calibrated.profile(), "{text}");
        let prior = loaded.calibration().unwrap();
        assert_eq!(prior.track_scale, calibrated.learned.track_scale);
        assert_eq!(prior.fix_delay_s, calibrated.learned.fix_delay_s);
        assert_eq!(loaded.geometry().unwrap(), calibrated.robot.geometry().unwrap());
        assert_eq!(loaded.noise, calibrated.robot.noise);
        assert_eq!((loaded.start, loaded.adopt_description), (None, false));
    }

    #[test]
    fn a_gyro_s_bias_is_not_trusted_beyond_the_power_up() {
        let profile = calibrated().profile();
        let prior = profile.calibration().unwrap().gyro_bias_rad_per_s;
        assert_eq!((prior.value, prior.sigma), (-0.0101, 0.03));
    }

    #[test]
    fn what_could_not_be_loaded_again_is_not_saved() {
        for value in [0.6, f64::NAN] {
            let mut calibrated = calibrated();
            calibrated.learned.track_scale.value = value;
            let error = format!("{:#}", calibrated.to_toml().unwrap_err());
            assert!(error.contains("robot.calibration.track_scale"), "{error}");
        }
    }

    #[test]
    fn a_saved_robot_says_whence_it_comes() {
        let page: toml::Table = toml::from_str(&calibrated().to_toml().unwrap()).unwrap();
        let from = page["calibrated"].as_table().unwrap();
        assert_eq!(from["date"].to_string(), "2024-03-01T00:00:00Z");
        assert_eq!(from["source"].as_str(), Some("lego \\ run"));
        assert_eq!(from["filter"].as_str(), Some("pose"));
    }
}
