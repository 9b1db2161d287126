//! Monte-Carlo accuracy: estimators over many drives whose truth is known, and what their errors add up to.
//!
//! Gets a [`ReferenceDrive`] and an estimator from the caller; gives a [`FilterScore`], which adds up over runs. It draws nothing, and
//! it knows no scenario: who makes the drives does not mark them.
//!
//! # Model
//! ```text
//! e_k    estimate - truth at the end of step k, of the estimate that was there then    3 x 1
//! RMSE   sqrt(mean(dx^2 + dy^2))  over all steps and runs       heading the same, each the short way
//! ANEES  mean(e' P^-1 e) / 3      over all steps and runs
//! claim  sqrt(mean(P_xx + P_yy))  what the RMSE would be if P were right
//! NIS    mean of nu' S^-1 nu over its degrees of freedom, of the updates that were accepted, by sensor
//! bound  sqrt(mean(B_k))          B_k the least mean squared position error after step k
//! ```
//! Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
//! section 5.4.

mod bound;
mod score;
mod smoother_score;
mod table;

use posebridge_estimator::Filter;
use posebridge_telemetry::Observation;

pub use bound::{BoundSum, WheelRotation};
pub use score::FilterScore;
pub use smoother_score::{SmootherFn, SmootherScore, score_smoother};
pub use table::{ScoreRow, bound_text};

use posebridge_report::track::TimedPose;

/// A drive whose truth is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferenceDrive {
    /// The truth at the start and at the end of each step, in the order of time.
    pub truth: Vec<TimedPose>,
    /// The sensors' observations, in the order of arrival.
    pub arrivals: Vec<ObservationArrival>,
    /// The error counts from this entry of `truth` on.
    pub scored_from: usize,
}

/// An observation and when it arrives; its own stamp may be earlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservationArrival {
    /// The entry of [`ReferenceDrive::truth`] before whose scoring it arrives.
    pub step: usize,
    /// The observation.
    pub observation: Observation,
}

/// Gives a drive to an estimator as it arrives, and scores the estimate that is there at the end of each step.
pub fn score(drive: &ReferenceDrive, filter: &mut dyn Filter) -> FilterScore {
    let mut score = FilterScore::default();
    let mut arrivals = drive.arrivals.iter().peekable();
    for (step, truth) in drive.truth.iter().enumerate() {
        while let Some(arrival) = arrivals.next_if(|arrival| arrival.step <= step) {
            score.add_record(&filter.observe(&arrival.observation));
        }
        if step >= drive.scored_from {
            score.add_step(truth.pose, filter.estimate_at(truth.time).as_ref());
        }
    }
    score.end_run();
    score
}
