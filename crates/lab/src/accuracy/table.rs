//! What the table of a Monte-Carlo scenario says of an estimator besides its errors.

use posebridge_report::metrics::SourceTally;
use posebridge_report::report::{Format, Unit};
use posebridge_report::tables::NO_VALUE;

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

impl ScoreRow<'_> {
    /// Its error as a multiple of the bound; `None` where there is none.
    pub fn ratio_to_bound(&self) -> Option<f64> {
        let bound_m = self.bound_m.filter(|bound_m| *bound_m > 0.0)?;
        Some(self.score.position_rms_m()? / bound_m)
    }

    /// The sensors whose observations were predicted, each with its mean and the verdict on it.
    pub fn sources(&self) -> String {
        let judged: Vec<String> = self.score.sources().iter().filter_map(source_text).collect();
        if judged.is_empty() { NO_VALUE.to_owned() } else { judged.join("; ") }
    }

    /// What its errors leave out.
    pub fn footnotes(&self) -> Vec<String> {
        let score = self.score;
        let left_out = [
            (score.steps_without_estimate(), ", no estimate"),
            (score.steps_not_finite(), ", not finite"),
            (score.refused_covariances(), " of its claim and its ANEES, covariance not positive definite"),
        ];
        let some = left_out.into_iter().filter(|(count, _)| *count > 0);
        some.map(|(count, what)| format!("{}: steps left out{what}: {count}", self.name)).collect()
    }
}

fn source_text(tally: &SourceTally) -> Option<String> {
    let mean = tally.mean_nis_per_dof()?;
    let gated = match tally.gated_share() {
        Some(share) if share > 0.0 => format!(", {:.1} % gated", share * 100.0),
        Some(_) | None => String::new(),
    };
    Some(format!("{} {mean:.2} {}{gated}", tally.sensor.name(), tally.consistency().as_text()))
}

/// The bound of a scenario, with what is to be said about it: what it leaves out, or why there is none.
pub fn bound_text(bound_m: Option<f64>, note: Option<&str>) -> String {
    let bound = match bound_m {
        Some(bound_m) => format!("bound: {} rms", Format::three_digits(Unit::Millimetres).text(bound_m)),
        None => "no bound".to_owned(),
    };
    let note = note.map(|note| format!(", {note}")).unwrap_or_default();
    format!("{bound}{note}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_told_with_what_it_leaves_out_and_a_missing_one_with_the_reason() {
        let line = bound_text(Some(0.000_971), Some("without the kicks"));
        assert_eq!(line, "bound: 0.971 mm rms, without the kicks");
        assert_eq!(bound_text(Some(0.000_971), None), "bound: 0.971 mm rms");
        assert_eq!(bound_text(None, Some("why")), "no bound, why");
    }
}
