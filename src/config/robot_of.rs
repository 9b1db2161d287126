//! A robot from any file that describes one.

use std::path::Path;

use anyhow::{Context, Result, bail};

use super::robot::{RobotFile, RobotStart};

/// The `[robot]` table of a TOML file: a robot profile, a station's configuration or a recording's descriptor.
///
/// # Errors
/// The file cannot be read, or its table makes no sense.
pub fn robot_of(path: &Path) -> Result<RobotFile> {
    let name = path.display();
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("reading the robot from `{name}`"))?;
    let table: toml::Table = toml::from_str(&text).with_context(|| format!("robot `{name}`"))?;
    let Some(robot) = table.get("robot") else {
        bail!("`{name}` has no [robot] table")
    };
    let mut robot: RobotFile = robot
        .clone()
        .try_into()
        .with_context(|| format!("[robot] of `{name}`"))?;
    // A descriptor keeps the start beside the robot, because it belongs to the recording.
    if let (None, Some(start)) = (
        robot.start,
        table.get("start").and_then(toml::Value::as_table),
    ) {
        robot.start = start_of(start);
    }
    Ok(robot)
}

/// The `[start]` of a descriptor, where it names a pose; one that is taken from the data is left to the first fixes.
fn start_of(start: &toml::Table) -> Option<RobotStart> {
    let number = |key: &str| {
        let value = start.get(key)?;
        value
            .as_float()
            .or(value.as_integer().map(|whole| whole as f64))
    };
    let degrees = |stem: &str| {
        number(&format!("{stem}_deg"))
            .or_else(|| number(&format!("{stem}_rad")).map(f64::to_degrees))
    };
    Some(RobotStart {
        x_m: number("x_m")?,
        y_m: number("y_m")?,
        heading_deg: degrees("heading")?,
        position_sigma_m: number("position_sigma_m")?,
        heading_sigma_deg: degrees("heading_sigma")?,
    })
}
