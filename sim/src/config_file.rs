//! Files of settings in strict TOML: scenarios, wall scenes, link profiles. Reading them from a disk is the caller's business.

use serde::de::DeserializeOwned;

/// Why a file of settings cannot be used. `what` names the kind of file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigFileError {
    /// The text is not TOML, a key is unknown or missing, or a value does not fit; the message shows the line and the key.
    #[error("{what} is not usable: {error}")]
    Toml { what: &'static str, error: toml::de::Error },
    /// The values do not go together.
    #[error("{what} is not usable: {reason}")]
    Impossible { what: &'static str, reason: String },
    /// No bundled file is called like this.
    #[error("no {what} is called \"{name}\"; there are {known}")]
    UnknownName {
        what: &'static str,
        name: String,
        /// The names that exist, joined by commas.
        known: String,
    },
}

pub(crate) fn from_toml<T: DeserializeOwned>(what: &'static str, text: &str) -> Result<T, ConfigFileError> {
    toml::from_str(text).map_err(|error| ConfigFileError::Toml { what, error })
}

/// The text of the bundled file `name`. `known` words what there is, given the names in the bundle.
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

/// The line that holds the byte at `offset`, counted from 1.
pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
}
