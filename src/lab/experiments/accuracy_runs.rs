//! All runs of all scenarios, on all cores.
//!
//! Each job draws one drive and runs every estimator over it. Jobs end in any order; their scores are added up in the order of
//! the runs, so that the result does not depend on the number of cores, to the last bit.

use posebridge_estimator::smoother::OfflineError;
use posebridge_lab::accuracy::{BoundSum, FilterScore};
use posebridge_link::HostTimer;
use posebridge_sim::montecarlo::Scenario;
use posebridge_telemetry::TimeDelta;

use super::bounds::BoundKind;
use super::{Estimator, EstimatorResult};
use crate::lab::drives::known_drive;
use crate::lab::parallel::run_all;

/// A scenario with its name and how often it is driven.
pub(super) struct PlannedScenario {
    pub(super) name: String,
    pub(super) scenario: Scenario,
    pub(super) runs: u32,
}

/// A scenario that has been driven.
pub(super) struct ScenarioScores {
    pub(super) planned: PlannedScenario,
    /// One per estimator.
    pub(super) results: Vec<EstimatorScores>,
    /// What no filter can be better than, where there is such a bound.
    pub(super) bound: Option<BoundSum>,
    pub(super) bound_kind: BoundKind,
    /// What the bound has cost, on one core.
    pub(super) bound_duration: TimeDelta,
}

/// One estimator over all runs.
#[derive(Clone, Default)]
pub(super) struct EstimatorScores {
    pub(super) score: FilterScore,
    /// The runs for which it gives no result, and why.
    pub(super) refusals: Vec<(u32, OfflineError)>,
}

/// What one job gives back.
struct DriveScores {
    results: Vec<EstimatorResult>,
    bound: Option<BoundSum>,
    bound_duration: TimeDelta,
}

/// One run of one scenario, both by their index.
#[derive(Clone, Copy)]
struct DriveJob {
    scenario: usize,
    run: u32,
}

/// Runs every estimator over every run; `ended` is called once for each run.
pub(super) fn score_all(
    planned: Vec<PlannedScenario>,
    estimators: &[Estimator],
    timer: &HostTimer,
    ended: impl FnMut(),
) -> Vec<ScenarioScores> {
    let jobs: Vec<DriveJob> = planned
        .iter()
        .enumerate()
        .flat_map(|(scenario, planned)| (0..planned.runs).map(move |run| DriveJob { scenario, run }))
        .collect();
    let run = |job: &DriveJob| {
        let planned = planned.get(job.scenario)?;
        Some(score_drive(planned, job.run, estimators, timer))
    };
    let by_job = run_all(&jobs, run, ended);
    sum_scores(planned, estimators.len(), &jobs, by_job)
}

/// Draws one drive and runs everything over it.
fn score_drive(planned: &PlannedScenario, run: u32, estimators: &[Estimator], timer: &HostTimer) -> DriveScores {
    let drive = planned.scenario.drive(run);
    let known = known_drive(&drive);
    let before = timer.now();
    let bound = BoundKind::for_scenario(&planned.scenario).compute(&drive, &known);
    let bound_took = timer.now() - before;
    DriveScores {
        results: estimators.iter().map(|estimator| estimator.score(&drive, &known)).collect(),
        bound,
        bound_duration: bound_took,
    }
}

fn sum_scores(
    planned: Vec<PlannedScenario>,
    estimators: usize,
    jobs: &[DriveJob],
    by_job: Vec<Option<DriveScores>>,
) -> Vec<ScenarioScores> {
    let mut all: Vec<ScenarioScores> = planned
        .into_iter()
        .map(|planned| ScenarioScores {
            bound_kind: BoundKind::for_scenario(&planned.scenario),
            planned,
            results: vec![EstimatorScores::default(); estimators],
            bound: None,
            bound_duration: TimeDelta::ZERO,
        })
        .collect();
    for (job, driven) in jobs.iter().zip(by_job) {
        if let (Some(scored), Some(driven)) = (all.get_mut(job.scenario), driven) {
            scored.add(job.run, driven);
        }
    }
    all
}

impl ScenarioScores {
    fn add(&mut self, run: u32, driven: DriveScores) {
        for (sum, verdict) in self.results.iter_mut().zip(driven.results) {
            sum.score.merge(&verdict.score);
            sum.refusals.extend(verdict.refusal.map(|refusal| (run, refusal)));
        }
        if let Some(bound) = driven.bound {
            self.bound.get_or_insert_with(BoundSum::default).merge(&bound);
        }
        self.bound_duration += driven.bound_duration;
    }

    /// Root mean square of the bound over steps and runs, in metres.
    pub(super) fn bound_rms_m(&self) -> Option<f64> {
        self.bound.as_ref().and_then(BoundSum::rms_m)
    }
}
