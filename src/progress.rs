//! The bar that long work shows on the terminal, and nowhere else.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar of so many `units` (runs, laps); it is drawn on stderr if that is a terminal.
///
/// # Errors
/// The name of the units cannot stand in a template.
pub fn bar(count: u64, units: &str) -> anyhow::Result<ProgressBar> {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {units}, {{eta}} left");
    Ok(ProgressBar::new(count).with_style(ProgressStyle::with_template(&template)?))
}
