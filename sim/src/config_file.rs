//! Configuration files in strict TOML: scenarios, wall scenes, link profiles. The caller reads them from disk.

use serde::de::DeserializeOwned;

/// Why a configuration file was rejected. `what` names the kind of file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigFileError {
    /// Invalid TOML, an unknown or missing key, or a value out of range; the message shows the line and the key.
    #[error("{what} is not usable: {error}")]
    Toml { what: &'static str, error: toml::de::Error },
    #[error("{what} is not usable: {reason}")]
    Impossible { what: &'static str, reason: String },
    #[error("no {what} is called \"{name}\"; there are {known}")]
    UnknownName {
        what: &'static str,
        name: String,
        /// All names, joined by commas.
        known: String,
    },
}

pub(crate) fn from_toml<T: DeserializeOwned>(what: &'static str, text: &str) -> Result<T, ConfigFileError> {
    toml::from_str(text).map_err(|error| ConfigFileError::Toml { what, error })
}

/// The text of the bundled file `name`. `known` formats the list of names for the error.
pub(crate) fn bundled_text(
    what: &'static str,
    bundle: &[(&str, &'static str)],
    name: &str,
    known: impl FnOnce(String) -> String,
) -> Result<&'static str, ConfigFileError> {
    let found = bundle.iter().find(|(bundled, _)| *bundled == name);
    found.map(|(_, text)| *text).ok_or_else(|| {
        let names: Vec<&str> = bundle.iter().map(|(bundled, _)| *bundled).collect();
        ConfigFileError::UnknownName { what, name: name.to_owned(), known: known(names.join(", ")) }
    })
}

/// Counted from 1.
pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
}
