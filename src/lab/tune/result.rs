//! What was tuned, and what it is worth.

use posebridge_lab::tuning::{ChoiceReason, QualityLoss, SearchResult, ShareChoice, TunedKey};

use super::run::RunScore;

/// What was tuned, and what it is worth.
pub(super) struct TuneResult {
    pub(super) keys: Vec<TunedKey>,
    pub(super) optimum: SearchResult,
    /// How far towards what was found, by data that the search did not see.
    pub(super) choice: ShareChoice,
    pub(super) kept: KeptValues,
    pub(super) start_factor: f64,
    /// Values of the keys in the first training run.
    pub(super) values: Vec<ParameterValues>,
    pub(super) before: Vec<RunScore>,
    /// With the numbers that the choice gives, kept or not.
    pub(super) proposed: Vec<RunScore>,
    /// With the numbers of the file, where the search started from others.
    pub(super) as_given: Option<Vec<RunScore>>,
}

/// A number on its way.
pub(super) struct ParameterValues {
    pub(super) before: f64,
    /// Where the likelihood of all training runs is largest.
    pub(super) at_maximum: f64,
    /// So far as other data agree.
    pub(super) proposed: f64,
    /// What is written.
    pub(super) after: f64,
}

/// Which numbers are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KeptValues {
    /// The tuned ones.
    Tuned,
    /// Those to start from: on data that the search did not see no other ones were better.
    StartByFolds(ChoiceReason),
    /// Those to start from: on the runs that were held out the tuned ones are worse.
    StartByHeldOut(QualityLoss),
}

impl TuneResult {
    /// The scores with what is kept.
    pub(super) fn after(&self) -> &[RunScore] {
        match self.kept {
            KeptValues::Tuned => &self.proposed,
            KeptValues::StartByFolds(_) | KeptValues::StartByHeldOut(_) => &self.before,
        }
    }
}
