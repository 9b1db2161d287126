//! The tables of a replay: estimators against each other, and what each sensor contributed.

use super::cells::{degrees, millimetres, two_digits};
use super::text_table::TextTable;
use crate::metrics::{ErrorSummary, SourceTally};

/// One estimator of a comparison.
#[derive(Clone, Copy, Debug)]
pub struct EstimatorRow<'a> {
    /// The estimator, as the configuration names it, or the run.
    pub name: &'a str,
    /// Its accuracy over one run, or the mean over several.
    pub errors: &'a ErrorSummary,
    /// Over how many independent runs; decides how far from 1 an honest ANEES may be.
    pub runs: u64,
}

/// Accuracy in millimetres and degrees, and the verdict on each estimator's own claims.
pub fn estimator_table(rows: &[EstimatorRow<'_>]) -> String {
    accuracy_table("estimator", rows)
}

/// The same of one estimator, a row for each run.
pub fn runs_table(rows: &[EstimatorRow<'_>]) -> String {
    accuracy_table("run", rows)
}

fn accuracy_table(what: &str, rows: &[EstimatorRow<'_>]) -> String {
    let mut table =
        TextTable::new([what, "samples", "rms mm", "max mm", "end mm", "heading rms deg", "ANEES", "its claims are"]);
    for row in rows {
        let errors = row.errors;
        table.push([
            row.name.to_owned(),
            errors.samples.to_string(),
            millimetres(errors.position_rms_m),
            millimetres(errors.position_max_m),
            millimetres(errors.position_end_m),
            degrees(errors.heading_rms_rad),
            two_digits(errors.anees),
            errors.consistency(row.runs).as_text().to_owned(),
        ]);
    }
    table.render() + &footnotes(rows.iter().map(|row| (row.name, row.errors)))
}

/// What became of the observations of each sensor, and whether the filter trusts it too much or too little.
pub fn source_table(tallies: &[SourceTally]) -> String {
    let mut table = TextTable::new([
        "source",
        "used",
        "slip",
        "gated",
        "too old",
        "malformed",
        "re-based",
        "reset to",
        "unused",
        "NIS/dof",
        "the filter is",
    ]);
    for tally in tallies {
        table.push([
            format!("{} ({})", tally.sensor.name(), tally.sensor),
            tally.used.to_string(),
            tally.slip.to_string(),
            tally.gated.to_string(),
            tally.too_old.to_string(),
            tally.malformed.to_string(),
            tally.rebased.to_string(),
            tally.reset_to.to_string(),
            tally.unused.to_string(),
            two_digits(tally.mean_nis_per_dof()),
            tally.consistency().as_text().to_owned(),
        ]);
    }
    table.render()
}

/// A line for each row that left something out; nothing when all was scored.
pub(super) fn footnotes<'a>(rows: impl Iterator<Item = (&'a str, &'a ErrorSummary)>) -> String {
    rows.flat_map(|(name, errors)| {
        [(errors.dropped, "not finite"), (errors.refused_covariances, "covariance not positive definite")]
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(move |(count, what)| format!("{name}: samples left out, {what}: {count}\n"))
    })
    .collect()
}
