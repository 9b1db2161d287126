//! The experiment on drives of a real robot: the same rows, over its sensor data.

use anyhow::{Result, ensure};
use posebridge_estimator::find_filter;
use posebridge_lab::end_errors::FilteredDrive;
use posebridge_telemetry::ObservationKind;

use super::rounds::{FilterRow, ROWS, RoundsResult, SensorSet, evaluate};
use crate::console::{print_line, progress_bar};
use crate::lab::experiments::recorded::{RobotDrive, RobotDrives};
use crate::lab::parallel::run_all;

/// The instructions for a person with a live robot.
pub(super) const TASK: &str =
    "leave the robot standing for two seconds, then drive the closed square, and let it stand again";

/// Every row over every drive, on all cores. Rows for sensors that a recording does not hold are left out.
///
/// # Errors
/// A recording holds no accelerations.
pub(super) fn rounds_of(drives: &RobotDrives) -> Result<RoundsResult> {
    for one in &drives.drives {
        ensure!(
            one.drive.contains(is_acceleration),
            "`{}` holds no accelerations of the wheels, and the indirect filter is about them: let the robot send INERTIAL with \
             both, or compare its wheels and gyro by `posebridge lab nxt-square --recording`",
            one.name
        );
    }
    let is_turn = |observed: &ObservationKind| matches!(observed, ObservationKind::TurnRate(_));
    let has_gyro = drives.drives.iter().all(|one| one.drive.contains(is_turn));
    if !has_gyro {
        print_line("no gyro in every recording: the rows with a gyro are left out");
    }
    let rows: Vec<FilterRow> =
        ROWS.into_iter().filter(|row| has_gyro || row.sensors != SensorSet::AccelerometersAndGyro).collect();
    let bar = progress_bar(drives.drives.len() as u64, "drives")?;
    let rounds = run_all(&drives.drives, |one| round(one, &rows), || bar.inc(1));
    bar.finish_and_clear();
    let fix_positions = drives.drives.first().map(|one| one.drive.fix_positions_m());
    Ok(evaluate(&rows, &rounds, fix_positions.unwrap_or_default()))
}

fn is_acceleration(observed: &ObservationKind) -> bool {
    matches!(observed, ObservationKind::WheelAccelerations { .. })
}

/// One drive by every row; the fixes are for its end alone.
fn round(one: &RobotDrive, rows: &[FilterRow]) -> Vec<FilteredDrive> {
    let courses = rows.iter().filter_map(|row| {
        let mut filter = (find_filter(row.filter)?.build)(&one.config);
        let hears = |observed: &ObservationKind| row.sensors.accepts(observed);
        Some(one.drive.run_filter(filter.as_mut(), hears))
    });
    courses.collect()
}
