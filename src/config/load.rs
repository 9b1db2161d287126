//! From files and flags to a [`Config`]; every error names the file, the line and the key.

use std::fmt::Write as _;
use std::path::Path;

use super::merge::Setting;
use super::{Config, DEFAULT_TOML};

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
        /// What the system said.
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
        // What stands there is the default: nobody has chosen it.
        return Ok(Loaded {
            file: toml::Table::new(),
            ..loaded
        });
    };
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|why| ConfigError::Unreadable {
        path: name.clone(),
        why,
    })?;
    load_text(&name, &text, settings)
}

/// The same from a text.
///
/// # Errors
/// As [`load`].
pub fn load_text(name: &str, text: &str, settings: &[Setting]) -> Result<Loaded, ConfigError> {
    let wrong = |why: String| ConfigError::Wrong {
        path: name.to_owned(),
        why,
    };
    let config: Config = toml::from_str(text).map_err(|error| wrong(located(&error, text)))?;
    let file: toml::Table = toml::from_str(text).map_err(|error| wrong(located(&error, text)))?;
    let mut config = config;
    for setting in settings {
        config = lay_over(&config, setting)?;
    }
    Ok(Loaded {
        config,
        file,
        settings: settings.to_vec(),
    })
}

/// A configuration with one key set.
///
/// # Errors
/// There is no such key, or the value makes no sense there.
pub fn lay_over(config: &Config, setting: &Setting) -> Result<Config, ConfigError> {
    let failed = |why: String| ConfigError::WrongSetting {
        setting: setting.to_string(),
        why,
    };
    let mut table = toml::Table::try_from(config).map_err(|error| failed(error.to_string()))?;
    setting.lay_over(&mut table).map_err(failed)?;
    table
        .try_into()
        .map_err(|error: toml::de::Error| failed(error.message().to_owned()))
}

/// What a TOML error says, with line and column in front.
fn located(error: &toml::de::Error, text: &str) -> String {
    let mut said = String::new();
    if let Some(span) = error.span() {
        let before = text.get(..span.start).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        let column = before
            .chars()
            .rev()
            .take_while(|character| *character != '\n')
            .count()
            + 1;
        // Writing to a String cannot fail.
        let _ = write!(said, "line {line}, column {column}: ");
        if let Some(source) = text.lines().nth(line - 1) {
            let _ = write!(said, "{}\n    {}", error.message(), source.trim());
            return said;
        }
    }
    said + error.message()
}
