//! The table of one Monte-Carlo scenario: estimators against each other.

use posebridge_report::metrics::SourceTally;
use posebridge_report::tables::TextTable;
use posebridge_report::tables::cells::{NO_VALUE, degrees, millimetres_three_digits, three_digits};

use super::FilterScore;

/// One estimator of a scenario.
#[derive(Clone, Copy, Debug)]
pub struct ScoreRow<'a> {
    /// Its name.
    pub name: &'a str,
    /// What its errors add up to.
    pub score: &'a FilterScore,
    /// The root mean square position error that no filter can be better than, in metres; `None` where there is no such bound.
    pub bound_m: Option<f64>,
}

/// Accuracy in millimetres and degrees and as a multiple of the bound, what the estimator claims, and how its observations fared.
pub fn score_table(rows: &[ScoreRow<'_>]) -> String {
    let mut table = TextTable::new([
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
            millimetres_three_digits(score.position_rms_m()),
            three_digits(ratio_to_bound(row)),
            millimetres_three_digits(score.position_mean_m()),
            millimetres_three_digits(score.position_max_m()),
            degrees(score.heading_rms_rad()),
            millimetres_three_digits(score.claimed_rms_m()),
            three_digits(score.anees()),
            score.consistency().as_text().to_owned(),
            format_sources(score.sources()),
        ]);
    }
    table.render() + &rows.iter().map(footnotes).collect::<String>()
}

/// The bound of a scenario, with what is to be said about it: what it leaves out, or why there is none.
pub fn bound_text(bound_m: Option<f64>, note: Option<&str>) -> String {
    let bound = match bound_m {
        Some(_) => format!("bound: {} mm rms", millimetres_three_digits(bound_m)),
        None => "no bound".to_owned(),
    };
    let note = note.map(|note| format!(", {note}")).unwrap_or_default();
    format!("{bound}{note}\n")
}

fn ratio_to_bound(row: &ScoreRow<'_>) -> Option<f64> {
    let bound_m = row.bound_m.filter(|bound_m| *bound_m > 0.0)?;
    Some(row.score.position_rms_m()? / bound_m)
}

/// The sensors whose observations were predicted, each with its mean and the verdict on it.
fn format_sources(tallies: &[SourceTally]) -> String {
    let judged: Vec<String> = tallies
        .iter()
        .filter_map(|tally| {
            let mean = tally.mean_nis_per_dof()?;
            let gated = match tally.gated_share() {
                Some(share) if share > 0.0 => format!(", {:.1} % gated", share * 100.0),
                Some(_) | None => String::new(),
            };
            let name = tally.sensor.name();
            Some(format!("{name} {mean:.2} {}{gated}", tally.consistency().as_text()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_told_with_what_it_leaves_out_and_a_missing_one_with_the_reason() {
        let line = bound_text(Some(0.000_971), Some("without the kicks"));
        assert_eq!(line, "bound: 0.971 mm rms, without the kicks\n");
        assert_eq!(bound_text(Some(0.000_971), None), "bound: 0.971 mm rms\n");
        assert_eq!(bound_text(None, Some("why")), "no bound, why\n");
    }
}
