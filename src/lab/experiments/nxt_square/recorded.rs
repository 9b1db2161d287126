//! The experiment on drives of a real robot.

use anyhow::{Result, ensure};
use posebridge_lab::square::{SensorTable, SquareReport, table_of};

use super::drives::errors_of;
use super::methods::{every_method, example, report};
use crate::console::progress_bar;
use crate::lab::experiments::recorded::{RobotDrive, RobotDrives};
use crate::lab::parallel::run_all;

/// The instructions for a person with a live robot.
pub(super) const TASK: &str = "leave the robot standing for two seconds, then drive the square, and let it stand again";

/// Every method over every drive; the first one is drawn.
///
/// # Errors
/// A recording holds no drive that could be scored.
pub(super) fn report_of(drives: &RobotDrives, camera_every: usize) -> Result<SquareReport> {
    let tables: Vec<(&RobotDrive, SensorTable)> =
        drives.drives.iter().map(|one| (one, table_of(&one.drive, &one.config.geometry))).collect();
    for (one, table) in &tables {
        ensure!(
            table.references(camera_every).iter().any(Option::is_some),
            "`{}`: no image is left as a reference, every one comes before or after the wheels: record with the camera from the \
             start, or drive a closed path and say `--judge start`",
            one.name
        );
    }
    let bar = progress_bar(tables.len() as u64, "drives")?;
    let methods = every_method();
    let errors = |(one, table): &(&RobotDrive, SensorTable)| errors_of(table, &one.config, &methods, camera_every);
    let runs = run_all(&tables, errors, || bar.inc(1));
    bar.finish_and_clear();
    let rows: Vec<String> = tables.iter().map(describe_drive).collect();
    let source = format!("{}; judged by {}", rows.join("; "), drives.reference_name());
    let first = tables.into_iter().next();
    let (one, table) = first.ok_or_else(|| anyhow::anyhow!("there is no recording"))?;
    let example = example(table, &one.config, camera_every);
    Ok(report(source, drives.command(), &runs, Vec::new(), example))
}

/// Name, length and what was heard besides the wheels.
fn describe_drive((one, table): &(&RobotDrive, SensorTable)) -> String {
    let count = |has: fn(&posebridge_lab::square::SensorRow) -> bool| table.rows.iter().filter(|row| has(row)).count();
    format!(
        "{}: {} rows, {} with gyro, {} with accelerometers, {} with an image",
        one.name,
        table.rows.len(),
        count(|row| row.gyro_deg_per_s.is_some()),
        count(|row| row.accelerations_m_per_s2.is_some()),
        count(|row| row.camera.is_some()),
    )
}
