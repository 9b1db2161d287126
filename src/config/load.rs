//! From files and flags to a [`Config`]; every error names the file, the line and the key.

use std::fmt::Write as _;
use std::path::Path;

use super::default_toml::DEFAULT_TOML;
use super::robot_blocks::split_robot_list;
use super::setting::Setting;
use super::station::Config;

/// A configuration and the text that it came from.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The configuration.
    pub config: Config,
    /// The file's own table, for telling where a value comes from.
    pub file: toml::Table,
    /// Flags that were laid over it.
    pub settings: Vec<Setting>,
}

/// Why a configuration could not be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration `{path}`: {why}")]
    Unreadable {
        /// The file.
        path: String,
        /// The error of the system.
        why: std::io::Error,
    },
    /// The text makes no sense.
    #[error("configuration `{path}`: {why}")]
    Wrong {
        /// The file.
        path: String,
        /// Line, column and what is wrong.
        why: String,
    },
    /// A flag makes no sense.
    #[error("`--set {setting}`: {why}")]
    WrongSetting {
        /// The flag's value.
        setting: String,
        /// What is wrong.
        why: String,
    },
}

/// Loads a file, or the embedded default where there is none, and lays settings over it.
///
/// # Errors
/// The file cannot be read, or a value or a setting makes no sense.
pub fn load(path: Option<&Path>, settings: &[Setting]) -> Result<Loaded, ConfigError> {
    let Some(path) = path else {
        let loaded = load_text("config/default.toml (embedded)", DEFAULT_TOML, settings)?;
        // What stands there is the default: it is a default.
        return Ok(Loaded { file: toml::Table::new(), ..loaded });
    };
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|why| ConfigError::Unreadable { path: name.clone(), why })?;
    load_text(&name, &text, settings)
}

/// The same from a text.
///
/// # Errors
/// As [`load`].
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

/// A configuration with some keys set. They are checked together: a section that has no default may be made of several.
///
/// # Errors
/// There is no such key, or a value makes no sense there. The error names the setting that is to blame, or all if that is not known.
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

/// The one without which the others make sense; else the one whose key the error names; else all.
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

/// What a TOML error says, with line and column in front.
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

#[cfg(test)]
mod tests {
    use super::*;

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
            for place in 0..=START.len() {
                let mut settings = START.to_vec();
                settings.insert(place, wrong);
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
}
