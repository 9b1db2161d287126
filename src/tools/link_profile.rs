//! Loads link profiles by bundled name or from a file.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_sim::impairment::LinkProfile;

/// A bundled profile by its name (`none` has no impairments), or one from a TOML file.
pub fn load(name_or_file: &str) -> Result<LinkProfile> {
    let is_file = Path::new(name_or_file).extension().is_some_and(|extension| extension == "toml");
    if !is_file {
        return Ok(LinkProfile::bundled(name_or_file)?);
    }
    let text =
        std::fs::read_to_string(name_or_file).with_context(|| format!("reading the link profile `{name_or_file}`"))?;
    LinkProfile::from_toml(&text).with_context(|| format!("`{name_or_file}`"))
}
