//! The files of a run's folder: their names, and the header of a recording.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_link::HostTimer;
use posebridge_recording::container::{FORMAT, RecordingHeader};

use crate::config::Config;

/// Most names that are tried before giving up.
const MAX_NAMES: u32 = 10_000;

/// The name of a run's first recording in its folder; those that follow have a number before the dot.
pub const RECORDING: &str = "recording.mcap";

/// This name in the folder if there is no such file and 1 is the first number; else with the first number before its dot that is free.
/// Gives the number as well.
pub(super) fn unused_path(folder: &Path, name: &str, first: u32) -> Result<(PathBuf, u32)> {
    let (stem, ending) = name.split_once('.').unwrap_or((name, ""));
    let numbers = first..first.saturating_add(MAX_NAMES);
    let mut numbered = numbers.map(|number| match number {
        ..=1 => (folder.join(name), number),
        _ => (folder.join(format!("{stem}-{number}.{ending}")), number),
    });
    numbered
        .find(|(path, _)| !path.exists())
        .with_context(|| format!("no free name for {name} in {}", folder.display()))
}

/// The header of a recording of this configuration.
///
/// # Errors
/// The configuration cannot be written as text.
pub fn header(config: &Config, timer: &HostTimer) -> Result<RecordingHeader> {
    Ok(RecordingHeader {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros: timer.utc_start(),
        config_toml: toml::to_string(config).context("writing the configuration into the recording")?,
        links: config.links.iter().map(|link| link.url.clone()).collect(),
    })
}

/// What was done with which file: its name first, because the end of a long text is cut on its way to a ground station.
pub(super) fn done_message(what: &str, path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().display();
    let folder = path.parent().unwrap_or(path).display();
    format!("{what} {name} in {folder}")
}
