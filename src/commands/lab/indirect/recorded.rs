//! The experiment on drives of a real robot: the same rows, over what its sensors said.

use anyhow::{Result, ensure};
use posebridge_analysis::ends::Course;
use posebridge_estimator::filter_named;
use posebridge_telemetry::Observed;

use super::rounds::{Found, ROWS, Row, Sensors, found_of};
use crate::commands::lab::recorded::{RobotDrive, RobotDrives};
use crate::parallel::run_all;
use crate::progress;
use crate::stderr::say;

/// What a person with a live robot is told to do.
pub(super) const TASK: &str =
    "leave the robot standing for two seconds, then drive the closed square, and let it stand again";

/// Every row over every drive, on all cores. Rows for sensors that a recording does not hold are left out.
///
/// # Errors
/// A recording holds no accelerations.
pub(super) fn rounds_of(drives: &RobotDrives) -> Result<Found> {
    for one in &drives.drives {
        ensure!(
            one.drive.holds(is_acceleration),
            "`{}` holds no accelerations of the wheels, and the indirect filter is about them: let the robot send INERTIAL with \
             both, or compare its wheels and gyro by `posebridge lab nxt-square --recording`",
            one.name
        );
    }
    let is_turn = |observed: &Observed| matches!(observed, Observed::TurnRate(_));
    let has_gyro = drives.drives.iter().all(|one| one.drive.holds(is_turn));
    if !has_gyro {
        say("no gyro in every recording: the rows with a gyro are left out");
    }
    let rows: Vec<Row> =
        ROWS.into_iter().filter(|row| has_gyro || row.sensors != Sensors::AccelerometersAndGyro).collect();
    let bar = progress::bar(drives.drives.len() as u64, "drives")?;
    let rounds = run_all(&drives.drives, |one| round(one, &rows), || bar.inc(1));
    bar.finish_and_clear();
    let seen = drives.drives.first().map(|one| one.drive.seen_m());
    Ok(found_of(&rows, &rounds, seen.unwrap_or_default()))
}

fn is_acceleration(observed: &Observed) -> bool {
    matches!(observed, Observed::WheelAccelerations { .. })
}

/// One drive by every row; the fixes are for its end alone.
fn round(one: &RobotDrive, rows: &[Row]) -> Vec<Course> {
    let courses = rows.iter().filter_map(|row| {
        let mut filter = (filter_named(row.filter)?.build)(&one.config);
        let hears = |observed: &Observed| row.sensors.hears(observed);
        Some(one.drive.course(filter.as_mut(), hears))
    });
    courses.collect()
}
