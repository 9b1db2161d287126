//! Whether figures are within the limits that a scenario sets.

use posebridge_report::metrics::VerdictTone;
use posebridge_report::quantity::Format;

/// A figure and its limits.
#[derive(Clone, Copy, Debug)]
pub struct Requirement {
    pub name: &'static str,
    /// `None` meets no limit.
    pub measured: Option<f64>,
    pub least: Option<f64>,
    pub most: Option<f64>,
    pub format: Format,
}

impl Requirement {
    /// What is wrong; `None` within the limits.
    fn failure(&self) -> Option<String> {
        let Self { name, measured, least, most, format } = *self;
        let Some(value) = measured else { return Some(format!("{name} is unknown")) };
        let shown = format.text(value);
        let below = least.filter(|least| value.is_nan() || value < *least);
        let above = most.filter(|most| value.is_nan() || value > *most);
        match (below, above) {
            (Some(least), _) => Some(format!("{name} {shown}, at least {}", format.text(least))),
            (None, Some(most)) => Some(format!("{name} {shown}, at most {}", format.text(most))),
            (None, None) => None,
        }
    }
}

/// The verdict on all requirements of a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Of the requirements that are not met.
    pub failures: Vec<String>,
}

impl Verdict {
    /// Requirements without a limit count as met.
    pub fn new(requirements: &[Requirement]) -> Self {
        let limited = requirements.iter().filter(|one| one.least.is_some() || one.most.is_some());
        Self { failures: limited.filter_map(Requirement::failure).collect() }
    }

    pub const fn tone(&self) -> VerdictTone {
        if self.failures.is_empty() { VerdictTone::Good } else { VerdictTone::Bad }
    }

    pub const fn as_text(&self) -> &'static str {
        if self.failures.is_empty() { "pass" } else { "fail" }
    }
}

#[cfg(test)]
mod tests {
    use posebridge_report::quantity::Unit;

    use super::*;

    #[test]
    fn a_figure_must_be_there_and_within_both_limits() {
        let format = Format::new(Unit::None, 2);
        let anees = |measured| Requirement { name: "ANEES", measured, least: Some(0.8), most: Some(1.3), format };
        let failures = |measured| Verdict::new(&[anees(measured)]).failures;
        assert_eq!(failures(Some(1.3)), [""; 0]);
        assert_eq!(failures(Some(0.7)), ["ANEES 0.70, at least 0.80"]);
        assert_eq!(failures(Some(f64::INFINITY)).len(), 1);
        assert_eq!(failures(Some(f64::NAN)).len(), 1);
        assert_eq!(failures(None), ["ANEES is unknown"]);
        let free = Requirement { least: None, most: None, ..anees(None) };
        assert_eq!(Verdict::new(&[free]).as_text(), "pass");
    }
}
