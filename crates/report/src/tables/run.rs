//! The table at the end of a run: the brick alone against the station.

use super::cells::{NO_VALUE, degrees, millimetres};
use super::replay::footnotes;
use super::text_table::TextTable;
use crate::metrics::ErrorSummary;

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct RunRow<'a> {
    /// Who believed it, for example "brick's own odometry" or "estimate".
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

fn ratio(reference: Option<f64>, value: Option<f64>) -> String {
    match (reference, value) {
        (Some(reference), Some(value)) if (reference / value).is_finite() => {
            format!("{:.1}x", reference / value)
        }
        (Some(_) | None, _) => NO_VALUE.to_owned(),
    }
}
