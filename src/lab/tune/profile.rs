//! The tuned robot as a profile: `[robot]` with its noise, and the tunables that were tuned.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_lab::tuning::{NOISE_KEYS, TunedKey};

use super::report;
use super::result::TuneResult;
use super::runs::TuneDataset;

/// Writes it.
///
/// # Errors
/// The file cannot be written.
pub(super) fn write(path: &Path, material: &TuneDataset, tuned: &TuneResult) -> Result<()> {
    let text = text(material, tuned)?;
    std::fs::write(path, text).with_context(|| format!("writing the profile to `{}`", path.display()))
}

fn text(material: &TuneDataset, tuned: &TuneResult) -> Result<String> {
    let mut robot = toml::Table::try_from(&material.robot)?;
    // Where it started belongs to the run.
    robot.remove("start");
    let mut noise = toml::Table::new();
    if let Some(first) = material.training().next() {
        for row in NOISE_KEYS {
            noise.insert(row.key.to_owned(), (row.read)(&first.config.noise).into());
        }
    }
    let mut filter = toml::Table::new();
    for (key, values) in tuned.keys.iter().zip(&tuned.values) {
        match key {
            TunedKey::Noise(row) => noise.insert(row.key.to_owned(), values.after.into()),
            TunedKey::Param(row) => filter.insert(row.key.to_owned(), values.after.into()),
        };
    }
    robot.insert("noise".to_owned(), noise.into());
    let mut origin = toml::Table::new();
    origin.insert("source".to_owned(), material.source.clone().into());
    let keys: Vec<toml::Value> = tuned.keys.iter().map(|key| key.name().into()).collect();
    origin.insert("keys".to_owned(), keys.into());
    origin.insert("kept".to_owned(), report::kept(tuned).into());
    let mut page = toml::Table::new();
    page.insert("tuned".to_owned(), origin.into());
    page.insert("robot".to_owned(), robot.into());
    if !filter.is_empty() {
        page.insert("filter".to_owned(), filter.into());
    }
    Ok(format!(
        "# A robot with tuned noise; give it with `posebridge run --robot FILE` or `posebridge replay --robot FILE`.\n\n{}",
        toml::to_string(&page)?
    ))
}
