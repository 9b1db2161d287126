//! The table at the end of a run: the brick alone against the station.

use super::cells::{NO_VALUE, degrees, millimetres, two_digits};
use super::replay::footnotes;
use super::text_table::TextTable;
use crate::metrics::ErrorSummary;

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct RunRow<'a> {
    /// The source, for example "brick's own odometry" or "estimate".
    pub name: &'a str,
    /// How far off it was.
    pub errors: &'a ErrorSummary,
}

/// The accuracy of each row in millimetres and degrees; the last column says how many times smaller the row's rms
/// position error is than that of the first row.
pub fn run_table(rows: &[RunRow<'_>]) -> String {
    let mut table = TextTable::new(["position error", "rms mm", "max mm", "end mm", "heading rms deg", "better by"]);
    let reference_m = rows.first().and_then(|row| row.errors.position_rms_m);
    for row in rows {
        let errors = row.errors;
        table.push([
            row.name.to_owned(),
            millimetres(errors.position_rms_m),
            millimetres(errors.position_max_m),
            millimetres(errors.position_end_m),
            degrees(errors.heading_rms_rad),
            ratio(reference_m, errors.position_rms_m),
        ]);
    }
    table.render() + &footnotes(rows.iter().map(|row| (row.name, row.errors)))
}

/// One of several robots of a run.
#[derive(Clone, Debug, Default)]
pub struct RobotRow {
    /// Its name or id.
    pub label: String,
    /// How many observations came.
    pub observations: u64,
    /// How many estimates were made.
    pub estimates: u64,
    /// Errors of its own odometry and of the estimates, where the truth is known.
    pub errors: Option<RobotErrors>,
}

/// Errors of one robot.
#[derive(Clone, Debug, Default)]
pub struct RobotErrors {
    /// Of the brick's own odometry.
    pub odometry: ErrorSummary,
    /// Of the estimates.
    pub estimate: ErrorSummary,
}

/// The table of a run with several robots.
pub fn robots_table(rows: &[RobotRow]) -> String {
    let mut table = TextTable::new([
        "robot",
        "observations",
        "estimates",
        "odometry rms mm",
        "estimate rms mm",
        "max mm",
        "heading rms deg",
        "ANEES",
    ]);
    for row in rows {
        let mut cells = vec![row.label.clone(), row.observations.to_string(), row.estimates.to_string()];
        if let Some(RobotErrors { odometry, estimate }) = &row.errors {
            cells.extend([
                millimetres(odometry.position_rms_m),
                millimetres(estimate.position_rms_m),
                millimetres(estimate.position_max_m),
                degrees(estimate.heading_rms_rad),
                two_digits(estimate.anees),
            ]);
        }
        table.push(cells);
    }
    table.render()
}

fn ratio(reference: Option<f64>, value: Option<f64>) -> String {
    match (reference, value) {
        (Some(reference), Some(value)) if (reference / value).is_finite() => {
            format!("{:.1}x", reference / value)
        }
        (Some(_) | None, _) => NO_VALUE.to_owned(),
    }
}
