//! A robot from any file that describes one, with the tunables that fit it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::Deserialize;

use super::Config;
use super::robot::{RobotFile, RobotStart};

/// What `--robot FILE` takes over: a robot profile's, a station's or a descriptor's `[robot]` and `[filter]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotProfile {
    /// The robot.
    pub robot: RobotFile,
    /// The tunables that fit it.
    pub filter: ProfileFilter,
}

/// The `[filter]` of a profile or a descriptor: what it does not name stays as it was.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default)]
pub struct ProfileFilter {
    /// Name of a filter.
    pub name: Option<String>,
    /// Tunables, by key.
    #[serde(flatten)]
    pub params: BTreeMap<String, f64>,
}

impl RobotProfile {
    /// Reads a TOML file: a robot profile, a station's configuration or a recording's descriptor.
    ///
    /// # Errors
    /// The file cannot be read, it has no `[robot]`, or one of its tables makes no sense.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("reading the robot from `{name}`"))?;
        Self::from_toml(&text).with_context(|| format!("robot `{name}`"))
    }

    /// The same from a text.
    ///
    /// # Errors
    /// It has no `[robot]`, or one of its tables makes no sense.
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
    /// This configuration with the robot of a profile and the tunables that fit it.
    pub fn with_robot(mut self, profile: RobotProfile) -> Self {
        self.robot = profile.robot;
        self.filter.params.extend(profile.filter.params);
        if let Some(name) = profile.filter.name {
            self.filter.name = name;
        }
        self
    }
}

/// The `[start]` of a descriptor, where it names a pose; one that is taken from the data is left to the first fixes.
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
