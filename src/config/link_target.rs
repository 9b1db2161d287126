//! What a link's URL opens: a real link, or a simulated brick behind a pseudo-terminal.

use std::fmt;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_link::{LinkUrl, UrlError};
use posebridge_sim::Scenario;

/// The scheme that starts a simulated brick of our own.
const SIM_SCHEME: &str = "sim://";

/// What a link opens.
#[derive(Clone, Debug)]
pub enum LinkTarget {
    /// A link of `posebridge-link`.
    Url(LinkUrl),
    /// A brick that this program simulates: the scenario's name or file.
    Sim(String),
}

impl LinkTarget {
    /// Understands `sim://NAME`, `sim://FILE.toml` and the URLs of every transport.
    ///
    /// # Errors
    /// The scheme is unknown or an option makes no sense.
    pub fn parse(text: &str) -> Result<Self, UrlError> {
        if let Some(scenario) = text.strip_prefix(SIM_SCHEME) {
            return Ok(Self::Sim(scenario.to_owned()));
        }
        match LinkUrl::parse(text) {
            Ok(url) => Ok(Self::Url(url)),
            Err(UrlError::UnknownScheme { scheme, known }) => {
                let known = format!("sim, {known}");
                Err(UrlError::UnknownScheme { scheme, known })
            }
            Err(error) => Err(error),
        }
    }
}

impl fmt::Display for LinkTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Url(url) => write!(f, "{url}"),
            Self::Sim(scenario) => write!(f, "{SIM_SCHEME}{scenario}"),
        }
    }
}

/// A bundled scenario by its name, or one from a TOML file.
///
/// # Errors
/// There is no such name or file, or the file makes no sense; the message names both and the key.
pub fn load_scenario(name_or_file: &str) -> Result<Scenario> {
    if Path::new(name_or_file).extension().is_none_or(|extension| extension != "toml") {
        return Ok(Scenario::bundled(name_or_file)?);
    }
    let text = std::fs::read_to_string(name_or_file).with_context(|| format!("reading scenario `{name_or_file}`"))?;
    // A way-points file lies beside its scenario unless its path says otherwise.
    let folder = Path::new(name_or_file).parent().unwrap_or(Path::new(""));
    let mut read = |path: &Path| std::fs::read_to_string(folder.join(path));
    Scenario::from_toml_with(&text, &mut read).with_context(|| format!("scenario `{name_or_file}`"))
}
