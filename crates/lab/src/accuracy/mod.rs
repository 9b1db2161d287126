//! Monte-Carlo accuracy: runs estimators over many drives with known truth and accumulates their errors.
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

mod disturbances;
mod drive;
mod verdict;

use std::cell::RefCell;

use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::smoother::{
    ArrivedObservation, GroundTruthRun, OfflineError, SmoothedTrajectory, cramer_rao_bound,
};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_report::metrics::consistency::nees;
use posebridge_report::metrics::{
    ErrorSummary, FilterVerdict, PoseError, SourceTally, add_to_tallies, merge_tally, source_verdicts,
};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::tables::NO_VALUE;
use posebridge_report::track::{SmoothedPath, TimedPose};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Arena, Estimate, FusionRecord, Observation, ObservationKind, Pose, Radians};

pub use self::disturbances::DisturbanceScore;
use self::disturbances::DisturbanceScorer;
pub use self::drive::{ObservationArrival, ReferenceDrive};
pub use self::verdict::{Requirement, Verdict};
use crate::statistics::RunningMean;

/// Passes a drive to a filter in the order of arrival; calls `on_record` for each observation, and `on_step` at the end of each scored
/// step with its truth and the estimate that is there then. Where the robot is put somewhere else all steps are scored.
pub fn run_drive(
    drive: &ReferenceDrive,
    filter: &mut dyn Filter,
    mut on_record: impl FnMut(&ObservationArrival, &FusionRecord),
    mut on_step: impl FnMut(usize, &TimedPose, Option<&Estimate>),
) {
    let first = if drive.landings.is_empty() { drive.scored_from } else { 0 };
    let mut arrivals = drive.arrivals.iter().peekable();
    for (step, truth) in drive.truth.iter().enumerate() {
        while let Some(arrival) = arrivals.next_if(|arrival| arrival.step <= step) {
            on_record(arrival, &filter.observe(&arrival.observation));
        }
        if step >= first {
            on_step(step, truth, filter.estimate_at(truth.time).as_ref());
        }
    }
}

pub fn score(drive: &ReferenceDrive, filter: &mut dyn Filter) -> FilterScore {
    let mut score = FilterScore::default();
    let mut sources = Vec::new();
    let disturbances = RefCell::new(DisturbanceScorer::new(drive));
    let on_record = |arrival: &ObservationArrival, record: &FusionRecord| {
        add_to_tallies(&mut sources, record);
        disturbances.borrow_mut().add_record(arrival, record);
    };
    run_drive(drive, filter, on_record, |step, truth, estimate| {
        disturbances.borrow_mut().add_step(step, truth, estimate);
        if step >= drive.scored_from {
            score.add_step(truth.pose, estimate);
        }
    });
    score.sources = sources;
    score.disturbances = disturbances.into_inner().end();
    score.end_run();
    score
}

fn source_text(tally: &SourceTally) -> Option<String> {
    let mean = tally.mean_nis_per_dof()?;
    let gated = match tally.gated_share() {
        Some(share) if share > 0.0 => format!(", {:.1} % gated", share * 100.0),
        Some(_) | None => String::new(),
    };
    Some(format!("{} {mean:.2} {}{gated}", tally.sensor.name(), tally.verdict().finding))
}

/// The bound of a scenario with a note: what it leaves out, or why there is none.
pub fn bound_text(bound_m: Option<f64>, note: Option<&str>) -> String {
    let bound = match bound_m {
        Some(bound_m) => format!("bound: {} rms", Format::three_digits(Unit::Millimetres).text(bound_m)),
        None => "no bound".to_owned(),
    };
    let note = note.map(|note| format!(", {note}")).unwrap_or_default();
    format!("{bound}{note}")
}

const POSE_DEGREES_OF_FREEDOM: f64 = 3.0;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct FilterScore {
    /// Of each run that has one, in the order of the runs.
    pub run_rms_m: Vec<f64>,
    run: ErrorSums,
    all: ErrorSums,
    pub runs: u64,
    pub position_max_m: Option<f64>,
    pub steps_without_estimate: u64,
    /// Steps whose estimate was not finite, or too large to square.
    pub steps_not_finite: u64,
    pub refused_covariances: u64,
    /// Fusion outcomes of each sensor over all runs, in the order of first arrival.
    pub sources: Vec<SourceTally>,
    pub disturbances: DisturbanceScore,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ErrorSums {
    position_m: RunningMean,
    position_m2: RunningMean,
    heading_rad2: RunningMean,
    nees: RunningMean,
    claim_m2: RunningMean,
}

impl ErrorSums {
    fn merge(&mut self, other: &Self) {
        self.position_m.merge(&other.position_m);
        self.position_m2.merge(&other.position_m2);
        self.heading_rad2.merge(&other.heading_rad2);
        self.nees.merge(&other.nees);
        self.claim_m2.merge(&other.claim_m2);
    }
}

impl FilterScore {
    /// Scores the estimate of one step against the truth. `None`, or an estimate without a valid position, counts as a step without an
    /// estimate; a non-finite one is counted separately.
    pub fn add_step(&mut self, truth: Pose<Arena>, estimate: Option<&Estimate>) {
        let Some(estimate) = estimate.filter(|estimate| estimate.validity.position) else {
            self.steps_without_estimate += 1;
            return;
        };
        let error = PoseError::of_estimate(estimate, truth);
        let position_m = error.position_m();
        let squared_m2 = position_m * position_m;
        if !(error.is_finite() && squared_m2.is_finite()) {
            self.steps_not_finite += 1;
            return;
        }
        self.run.position_m.add(position_m);
        self.run.position_m2.add(squared_m2);
        self.position_max_m = larger(self.position_max_m, Some(position_m));
        if let Some(heading_rad) = error.heading_rad.map(wrap_rad) {
            self.run.heading_rad2.add(heading_rad * heading_rad);
            self.add_claimed_error(&error, heading_rad);
        }
    }

    fn add_claimed_error(&mut self, error: &PoseError, heading_rad: f64) {
        let Some(covariance) = &error.covariance else {
            return;
        };
        match nees([error.dx_m, error.dy_m, heading_rad], covariance) {
            Ok(value) => {
                self.run.nees.add(value);
                let claim_m2 = covariance[0][0] + covariance[1][1];
                self.run.claim_m2.add(claim_m2);
            }
            Err(_) => self.refused_covariances += 1,
        }
    }

    /// Ends a run: the steps since the last call are one independent sample of the consistency test.
    pub fn end_run(&mut self) {
        self.runs += 1;
        self.run_rms_m.extend(self.run.position_m2.root());
        self.all.merge(&self.run);
        self.run = ErrorSums::default();
    }

    /// Adds other ended runs. The last digits of the result depend on the order: add them in the order of the runs.
    pub fn merge(&mut self, other: &Self) {
        self.run_rms_m.extend_from_slice(&other.run_rms_m);
        self.all.merge(&other.all);
        self.runs += other.runs;
        self.position_max_m = larger(self.position_max_m, other.position_max_m);
        self.steps_without_estimate += other.steps_without_estimate;
        self.steps_not_finite += other.steps_not_finite;
        self.refused_covariances += other.refused_covariances;
        for theirs in &other.sources {
            merge_tally(&mut self.sources, theirs);
        }
        self.disturbances.merge(&other.disturbances);
    }

    /// `None` without a bound of the root mean square position error.
    pub fn ratio_to_bound(&self, bound_m: Option<f64>) -> Option<f64> {
        let bound_m = bound_m.filter(|bound_m| *bound_m > 0.0)?;
        Some(self.position_rms_m()? / bound_m)
    }

    /// The sensors with predicted observations, each with its mean NIS and verdict.
    pub fn sources_text(&self) -> String {
        let scored: Vec<String> = self.sources.iter().filter_map(source_text).collect();
        if scored.is_empty() { NO_VALUE.to_owned() } else { scored.join("; ") }
    }

    /// What is left out of the score of an estimator of this name.
    pub fn footnotes(&self, name: &str) -> Vec<String> {
        let left_out = [
            (self.steps_without_estimate, ", no estimate"),
            (self.steps_not_finite, ", not finite"),
            (self.refused_covariances, " of its claim and its ANEES, covariance not positive definite"),
        ];
        let some = left_out.into_iter().filter(|(count, _)| *count > 0);
        some.map(|(count, what)| format!("{name}: steps left out{what}: {count}")).collect()
    }

    pub const fn steps(&self) -> u64 {
        self.all.position_m2.count
    }

    pub fn position_rms_m(&self) -> Option<f64> {
        self.all.position_m2.root()
    }

    pub fn position_mean_m(&self) -> Option<f64> {
        self.all.position_m.mean()
    }

    pub fn heading_rms_rad(&self) -> Option<f64> {
        self.all.heading_rad2.root()
    }

    /// Root mean square position error by the claimed covariance.
    pub fn claimed_rms_m(&self) -> Option<f64> {
        self.all.claim_m2.root()
    }

    pub fn anees(&self) -> Option<f64> {
        self.all.nees.mean().map(|mean| mean / POSE_DEGREES_OF_FREEDOM)
    }

    /// A run counts as one sample, and the mean over a run varies less: outside the band is inconsistent, inside does not prove
    /// consistency.
    pub fn verdict(&self) -> FilterVerdict {
        let errors = ErrorSummary {
            anees: self.anees(),
            samples: self.all.nees.count as usize,
            refused_covariances: self.refused_covariances as usize,
            ..ErrorSummary::default()
        };
        FilterVerdict::new(&errors, self.runs, source_verdicts(&self.sources))
    }
}

fn larger(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    one.into_iter().chain(other).reduce(f64::max)
}

#[derive(Clone, Debug, PartialEq)]
pub struct DriveScore {
    pub score: FilterScore,
    /// Why there is no result; only a smoother can reject a whole drive.
    pub refusal: Option<OfflineError>,
}

/// A smoother of a whole run, such as [`posebridge_estimator::smoother::smooth()`].
pub type SmootherFn = fn(&FilterConfig, &[Observation]) -> Result<SmoothedTrajectory, OfflineError>;

/// Smooths a whole drive and scores the path at the same steps as a filter.
///
/// The path at a step uses later observations. Only fixes are tallied, all under the sensor of the first one: a fix that the path
/// leaves out counts as gated.
pub fn score_smoother(drive: &ReferenceDrive, config: &FilterConfig, smoother: SmootherFn) -> DriveScore {
    let observations: Vec<Observation> = drive.arrivals.iter().map(|arrival| arrival.observation).collect();
    let (path, tally, refusal) = match smoother(config, &observations) {
        Ok(smoothed) => {
            let tally = fixes_of(&smoothed, &observations);
            (SmoothedPath::new(smoothed.poses), tally, None)
        }
        Err(refusal) => (SmoothedPath::default(), None, Some(refusal)),
    };
    let mut score = FilterScore::default();
    if let Some(tally) = tally {
        score.sources.push(tally);
    }
    for truth in drive.truth.iter().skip(drive.scored_from) {
        score.add_step(truth.pose, path.at(truth.time).as_ref());
    }
    score.end_run();
    DriveScore { score, refusal }
}

fn fixes_of(smoothed: &SmoothedTrajectory, observations: &[Observation]) -> Option<SourceTally> {
    let first = observations.iter().find(|observation| matches!(observation.measurement, ObservationKind::Fix(_)))?;
    let mut tally = SourceTally::new(first.sensor);
    tally.used = smoothed.fixes_used as u64;
    tally.gated = smoothed.fixes_rejected as u64;
    Some(tally)
}

// How small the error over drives can be at all: the posterior Cramer-Rao bound, added up over steps and runs.
//
// # Source
// [`posebridge_estimator::smoother::cramer_rao`], which says what it assumes.

/// The least squared position errors of a filter of this configuration over the scored steps of a drive, m²; its root is the lower
/// bound of the root mean square error.
///
/// `wheel_turns` are the true rotations of the left and the right wheel over each step, before rounding and without slip. `None` where
/// the bound does not apply: another number of entries, or a non-finite bound.
pub fn error_bound(config: &FilterConfig, drive: &ReferenceDrive, wheel_turns: &[[Radians; 2]]) -> Option<RunningMean> {
    let [first, second, ..] = drive.truth.as_slice() else {
        return None;
    };
    if wheel_turns.len() + 1 != drive.truth.len() {
        return None;
    }
    let poses: Vec<_> = drive.truth.iter().map(|truth| truth.pose).collect();
    let (left_m, right_m) = (config.geometry.left_wheel_radius.0, config.geometry.right_wheel_radius.0);
    let travel = |[left, right]: &[Radians; 2]| WheelTravel { left_m: left.0 * left_m, right_m: right.0 * right_m };
    let travel: Vec<WheelTravel> = wheel_turns.iter().map(travel).collect();
    let arrived = drive.arrivals.iter().map(|arrival| ArrivedObservation {
        exposure_step: arrival.measured_step,
        arrival_step: arrival.step,
        sensor: arrival.observation.sensor,
        measurement: arrival.observation.measurement,
    });
    let observations: Vec<ArrivedObservation> = arrived.collect();
    let run = GroundTruthRun {
        poses: &poses,
        travel: &travel,
        step_s: (second.time - first.time).as_secs_f64(),
        observations: &observations,
    };
    let mut bound = RunningMean::default();
    for variance_m2 in cramer_rao_bound(config, &run).into_iter().skip(drive.scored_from.saturating_sub(1)) {
        bound.add(variance_m2);
    }
    bound.mean().is_none_or(f64::is_finite).then_some(bound)
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
