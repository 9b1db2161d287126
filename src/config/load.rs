//! Loads a [`Config`] from files and flags, and tracks the origin of each value; every error names the file, the line and the key.

use std::fmt::{self, Write as _};
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};

use super::profile::RobotProfile;
use super::robot_blocks::split_robot_list;
use super::sensor::SensorSection;
use super::station::Config;
use crate::text_file::read_text;

/// The default configuration, which documents every key.
pub const DEFAULT_TOML: &str = include_str!("../../config/default.toml");

#[derive(Clone, Debug)]
pub struct Loaded {
    pub config: Config,
    /// The parsed file, to tell the origin of each value.
    pub file: toml::Table,
    pub settings: Vec<Setting>,
}

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    #[error("cannot read the configuration `{path}`: {why}")]
    Unreadable { path: String, why: std::io::Error },
    #[error("configuration `{path}`: {why}")]
    Wrong { path: String, why: String },
    #[error("`--set {setting}`: {why}")]
    WrongSetting { setting: String, why: String },
}

/// Loads a file, or the embedded default without a path, and applies settings.
pub fn load(path: Option<&Path>, settings: &[Setting]) -> Result<Loaded, ConfigError> {
    let Some(path) = path else {
        let loaded = load_text("config/default.toml (embedded)", DEFAULT_TOML, settings)?;
        // What stands there is the default: it is a default.
        return Ok(Loaded { file: toml::Table::new(), ..loaded });
    };
    let name = path.display().to_string();
    let text = read_text(path).map_err(|why| ConfigError::Unreadable { path: name.clone(), why })?;
    load_text(&name, &text, settings)
}

pub fn load_text(name: &str, text: &str, settings: &[Setting]) -> Result<Loaded, ConfigError> {
    let wrong = |why: String| ConfigError::Wrong { path: name.to_owned(), why };
    let mut file: toml::Table = toml::from_str(text).map_err(|error| wrong(located(&error, text)))?;
    let config: Config = if split_robot_list(&mut file).map_err(&wrong)? {
        file.clone().try_into().map_err(|error: toml::de::Error| wrong(error.message().to_owned()))?
    } else {
        toml::from_str(text).map_err(|error| wrong(located(&error, text)))?
    };
    Ok(Loaded { config: apply_overrides(&config, settings)?, file, settings: settings.to_vec() })
}

/// Applies settings together, because several keys may form one section without a default. An error names the setting at fault, or all
/// if it cannot be determined.
pub fn apply_overrides(config: &Config, settings: &[Setting]) -> Result<Config, ConfigError> {
    let all: Vec<&Setting> = settings.iter().collect();
    with_overrides(config, &all).map_err(|why| {
        let guilty = offending_settings(config, &all, &why);
        let names: Vec<String> = guilty.iter().map(ToString::to_string).collect();
        ConfigError::WrongSetting { setting: names.join(" --set "), why }
    })
}

fn with_overrides(config: &Config, settings: &[&Setting]) -> Result<Config, String> {
    let mut table = toml::Table::try_from(config).map_err(|error| error.to_string())?;
    for setting in settings {
        setting.apply_to(&mut table)?;
    }
    let laid = table.try_into();
    laid.map_err(|error: toml::de::Error| error.message().to_owned())
}

/// Replaces keys and tables of the robot and the filter by those of a profile.
pub fn apply_profile(config: &Config, profile: &toml::Table) -> Result<Config> {
    const TABLES: [&str; 2] = ["robot", "filter"];
    if let Some(key) = profile.keys().find(|key| !TABLES.contains(&key.as_str())) {
        bail!("unknown table `{key}`, expected one of `{}`", TABLES.join("`, `"));
    }
    let mut table = toml::Table::try_from(config)?;
    merge(&mut table, profile);
    table.try_into().map_err(|error: toml::de::Error| anyhow!("{}", error.message()))
}

fn merge(into: &mut toml::Table, from: &toml::Table) {
    for (key, value) in from {
        match (into.get_mut(key), value) {
            (Some(toml::Value::Table(into)), toml::Value::Table(from)) => merge(into, from),
            _ => {
                into.insert(key.clone(), value.clone());
            }
        }
    }
}

/// The setting without which the others are valid; else the one whose key the error names; else all.
fn offending_settings<'a>(config: &Config, settings: &[&'a Setting], why: &str) -> Vec<&'a Setting> {
    let others = |guilty: usize| -> Vec<&Setting> {
        let others = settings.iter().enumerate().filter(|(at, _)| *at != guilty);
        others.map(|(_, setting)| *setting).collect()
    };
    let innocent_without = |at: &usize| with_overrides(config, &others(*at)).is_ok();
    if let Some(setting) = (0..settings.len()).find(innocent_without).and_then(|at| settings.get(at)) {
        return vec![*setting];
    }
    let is_named = |setting: &&&Setting| {
        let key = setting.path.last();
        key.is_some_and(|key| why.starts_with(&format!("unknown field `{key}`")))
    };
    match settings.iter().find(is_named) {
        Some(setting) => vec![*setting],
        None => settings.to_vec(),
    }
}

fn located(error: &toml::de::Error, text: &str) -> String {
    let mut description = String::new();
    if let Some(span) = error.span() {
        let before = text.get(..span.start).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|character| *character != '\n').count() + 1;
        // Writing to a String cannot fail.
        let _ = write!(description, "line {line}, column {column}: ");
        if let Some(source) = text.lines().nth(line - 1) {
            let _ = write!(description, "{}\n    {}", error.message(), source.trim());
            return description;
        }
    }
    description + error.message()
}

#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    pub path: Vec<String>,
    pub value: toml::Value,
}

impl Setting {
    /// Parses `a.b=VALUE`; a value that is not TOML is a string.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or_else(|| format!("`{text}` has no `=`: write KEY=VALUE"))?;
        let path: Vec<String> = key.trim().split('.').map(str::to_owned).collect();
        if path.iter().any(String::is_empty) {
            return Err(format!("`{key}` has an empty part: write for example robot.track_width_m=0.112"));
        }
        let value = value.trim();
        let parsed = toml::from_str::<toml::Table>(&format!("v = {value}")).ok();
        let value =
            parsed.and_then(|mut table| table.remove("v")).unwrap_or_else(|| toml::Value::String(value.to_owned()));
        Ok(Self { path, value })
    }

    /// Creates missing tables.
    pub fn apply_to(&self, table: &mut toml::Table) -> Result<(), String> {
        let Some((last, parents)) = self.path.split_last() else {
            return Ok(());
        };
        let mut table = table;
        for part in parents {
            let entry = table.entry(part.clone()).or_insert_with(|| toml::Value::Table(toml::Table::new()));
            table = entry.as_table_mut().ok_or_else(|| format!("`{part}` is no table"))?;
        }
        // Whole numbers are fine where a fraction is possible: 1 means 1.0.
        let value = match (&self.value, table.get(last)) {
            (toml::Value::Integer(whole), Some(toml::Value::Float(_))) => toml::Value::Float(*whole as f64),
            _ => self.value.clone(),
        };
        table.insert(last.clone(), value);
        Ok(())
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.path.join("."), self.value)
    }
}

/// The file of `--sensor` as the key `robot.sensor`.
pub fn sensor_setting(path: &Path) -> Result<Setting> {
    let name = path.display();
    let text = read_text(path).with_context(|| format!("reading the sensor from `{name}`"))?;
    let section: SensorSection = toml::from_str(&text).with_context(|| format!("sensor `{name}`"))?;
    section.checked().with_context(|| format!("sensor `{name}`"))?;
    Ok(Setting { path: vec!["robot".to_owned(), "sensor".to_owned()], value: toml::Value::try_from(section)? })
}

/// Changes to the configuration of a recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct Overlay<'a> {
    pub robot: Option<&'a Path>,
    /// Single keys; they also override the robot.
    pub settings: &'a [Setting],
}

/// The recording's configuration with another robot, if given, and single keys on top.
pub fn config_with_overlay(header: &str, overlay: Overlay<'_>) -> Result<Config> {
    let origin = "the recording's own configuration";
    let mut config = load_text(origin, header, &[])?.config;
    if let Some(path) = overlay.robot {
        config = config.with_robot(RobotProfile::read(path)?);
    }
    Ok(apply_overrides(&config, overlay.settings)?)
}

pub fn print(loaded: &Loaded) -> Result<String> {
    let table = toml::Table::try_from(&loaded.config)?;
    let mut lines = String::new();
    print_table(&table, &mut Vec::new(), loaded, &mut lines);
    Ok(lines)
}

fn print_table(table: &toml::Table, path: &mut Vec<String>, loaded: &Loaded, lines: &mut String) {
    for (key, value) in table {
        path.push(key.clone());
        if let toml::Value::Table(inner) = value {
            print_table(inner, path, loaded, lines);
        } else {
            // Writing to a String cannot fail.
            let _ = writeln!(lines, "{} = {value}    # {}", path.join("."), origin_of(path, loaded));
        }
        path.pop();
    }
}

fn origin_of(path: &[String], loaded: &Loaded) -> &'static str {
    if loaded.settings.iter().any(|setting| setting.path == path) {
        return "flag";
    }
    let mut tables = Some(&loaded.file);
    let mut is_in_file = false;
    for part in path {
        let value = tables.and_then(|table| table.get(part));
        is_in_file = value.is_some();
        tables = value.and_then(toml::Value::as_table);
    }
    if is_in_file { "file" } else { "default" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Setting, load_text};

    fn with(settings: &[&str]) -> Result<Config, String> {
        let settings: Vec<Setting> = settings.iter().map(|text| Setting::parse(text).unwrap()).collect();
        let loaded = load_text("test", "", &settings);
        loaded.map(|loaded| loaded.config).map_err(|error| error.to_string())
    }

    const START: [&str; 5] = [
        "robot.start.x_m=0.5",
        "robot.start.y_m=0",
        "robot.start.heading_deg=0.0",
        "robot.start.position_sigma_m=0.01",
        "robot.start.heading_sigma_deg=1.0",
    ];

    #[test]
    fn a_section_without_a_default_can_be_made_of_several_settings() {
        let start = with(&START).unwrap().robot.start.unwrap();
        assert_eq!((start.x_m, start.y_m), (0.5, 0.0));
    }

    #[test]
    fn the_setting_that_is_wrong_is_named_and_no_other() {
        let error = with(&START[..1]).unwrap_err();
        assert!(error.starts_with("`--set robot.start.x_m=0.5`: missing field `y_m`"), "{error}");
        for wrong in ["robot.start.z_m=1", "robot.track=1", "robot.track_width_m=wide", "robot.name.x=1"] {
            for position in 0..=START.len() {
                let mut settings = START.to_vec();
                settings.insert(position, wrong);
                let error = with(&settings).unwrap_err();
                let named = format!("`--set {}`: ", Setting::parse(wrong).unwrap());
                assert!(error.starts_with(&named), "{error}");
            }
        }
        // Two that are wrong: the one that the reader stumbles over; and a section that is not whole, by all that are given.
        let error = with(&["robot.start.x_m=0.5", "robot.axle=1"]).unwrap_err();
        assert!(error.contains("`--set robot.axle=1`: unknown field"), "{error}");
        let error = with(&START[..2]).unwrap_err();
        assert!(error.contains("x_m=0.5 --set robot.start.y_m=0`: missing field"), "{error}");
    }

    #[derive(serde::Deserialize)]
    struct Refused {
        config: String,
        words: Vec<String>,
    }

    #[test]
    fn a_configuration_that_makes_no_sense_is_refused_with_its_place_and_key() {
        let file = include_str!("../../tests/data/refused_configurations.toml");
        let cases: std::collections::BTreeMap<String, Vec<Refused>> = toml::from_str(file).unwrap();
        assert!(cases["refused"].len() > 70);
        for Refused { config: text, words } in &cases["refused"] {
            let check = || {
                let config = load_text("station.toml", text, &[])?.config;
                config.validate()
            };
            let error = format!("{:#}", check().err().unwrap_or_else(|| panic!("{text} is accepted")));
            for word in words {
                assert!(error.contains(word), "{text}: `{word}` in {error}");
            }
        }
    }

    #[test]
    fn a_setting_reaches_its_key_and_says_that_it_was_a_flag() {
        let settings = [Setting::parse("robot.track_width_m=1").unwrap()];
        let loaded = load_text("test", "[robot]\nname = \"a\"\n", &settings).unwrap();
        assert_eq!(loaded.config.robot.track_width_m, 1.0);
        let printed = print(&loaded).unwrap();
        assert!(printed.contains("robot.track_width_m = 1.0    # flag"), "{printed}");
        assert!(printed.contains("robot.name = \"a\"    # file"), "{printed}");
        assert!(printed.contains("robot.ticks_per_turn = 360.0    # default"), "{printed}");
    }

    #[test]
    fn the_embedded_default_says_what_the_code_says() {
        let loaded = load_text("default", DEFAULT_TOML, &[]).unwrap();
        assert_eq!(loaded.config, Config::default());
    }
}
