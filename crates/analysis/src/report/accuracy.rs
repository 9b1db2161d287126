//! The table of one Monte-Carlo scenario: estimators against each other.

use super::cells::{NO_VALUE, degrees};
use super::table::Table;
use crate::accuracy::Score;
use crate::metrics::SourceTally;

/// One estimator of a scenario.
#[derive(Clone, Copy, Debug)]
pub struct ScoreRow<'a> {
    /// Its name.
    pub name: &'a str,
    /// What its errors add up to.
    pub score: &'a Score,
    /// The root mean square position error that no filter can be better than, in metres; `None` where there is no such bound.
    pub bound_m: Option<f64>,
}

/// Accuracy in millimetres and degrees and as a multiple of the bound, what the estimator claims, and how its observations fared.
pub fn score_table(rows: &[ScoreRow<'_>]) -> String {
    let mut table = Table::new([
        "estimator",
        "rms mm",
        "rms/bound",
        "mean mm",
        "max mm",
        "heading rms deg",
        "claimed mm",
        "ANEES",
        "its claims are",
        "NIS/dof of what it used",
    ]);
    for row in rows {
        let score = row.score;
        table.push([
            row.name.to_owned(),
            millimetres(score.position_rms_m()),
            three_digits(over_bound(row)),
            millimetres(score.position_mean_m()),
            millimetres(score.position_max_m()),
            degrees(score.heading_rms_rad()),
            millimetres(score.claimed_rms_m()),
            three_digits(score.anees()),
            score.consistency().in_words().to_owned(),
            sources(score.sources()),
        ]);
    }
    table.render() + &rows.iter().map(footnotes).collect::<String>()
}

/// The bound of a scenario, with what is to be said about it: what it leaves out, or why there is none.
pub fn bound_line(bound_m: Option<f64>, note: Option<&str>) -> String {
    let bound = match bound_m {
        Some(_) => format!("bound: {} mm rms", millimetres(bound_m)),
        None => "no bound".to_owned(),
    };
    let note = note.map(|note| format!(", {note}")).unwrap_or_default();
    format!("{bound}{note}\n")
}

fn over_bound(row: &ScoreRow<'_>) -> Option<f64> {
    let bound_m = row.bound_m.filter(|bound_m| *bound_m > 0.0)?;
    Some(row.score.position_rms_m()? / bound_m)
}

/// The sensors whose observations were predicted, each with its mean and the verdict on it.
fn sources(tallies: &[SourceTally]) -> String {
    let judged: Vec<String> = tallies
        .iter()
        .filter_map(|tally| {
            let mean = tally.mean_nis_per_dof()?;
            let gated = match tally.gated_share() {
                Some(share) if share > 0.0 => format!(", {:.1} % gated", share * 100.0),
                Some(_) | None => String::new(),
            };
            let name = tally.sensor.name();
            Some(format!("{name} {mean:.2} {}{gated}", tally.consistency().in_words()))
        })
        .collect();
    if judged.is_empty() { NO_VALUE.to_owned() } else { judged.join("; ") }
}

fn footnotes(row: &ScoreRow<'_>) -> String {
    let score = row.score;
    let lines = [
        (score.steps_without_estimate(), ", no estimate"),
        (score.steps_not_finite(), ", not finite"),
        (score.refused_covariances(), " of its claim and its ANEES, covariance not positive definite"),
    ]
    .into_iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, what)| format!("{}: steps left out{what}: {count}\n", row.name));
    lines.collect::<Vec<_>>().concat()
}

/// Three significant digits where there are fewer before the point: these errors span five decades.
pub(crate) fn millimetres(metres: Option<f64>) -> String {
    three_digits(metres.map(|metres| metres * 1e3))
}

/// Three significant digits; all that stand before the point, and powers of ten where that would flood a column.
pub(crate) fn three_digits(value: Option<f64>) -> String {
    let Some(value) = value else {
        return NO_VALUE.to_owned();
    };
    match value.abs() {
        size if size >= 1e5 || !size.is_finite() => format!("{value:.1e}"),
        size if size >= 99.95 => format!("{value:.0}"),
        size if size >= 9.995 => format!("{value:.1}"),
        size if size >= 0.9995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits_over_five_decades() {
        let cells = [0.00133, 0.0137, 0.2244, 1.8121, 425.462].map(|metres| millimetres(Some(metres)));
        assert_eq!(cells, ["1.33", "13.7", "224", "1812", "4.3e5"]);
        assert_eq!(three_digits(Some(0.0104)), "0.010");
        assert_eq!(three_digits(None), "-");
    }

    #[test]
    fn a_bound_is_told_with_what_it_leaves_out_and_a_missing_one_with_the_reason() {
        let line = bound_line(Some(0.000_971), Some("without the kicks"));
        assert_eq!(line, "bound: 0.971 mm rms, without the kicks\n");
        assert_eq!(bound_line(Some(0.000_971), None), "bound: 0.971 mm rms\n");
        assert_eq!(bound_line(None, Some("why")), "no bound, why\n");
    }
}
