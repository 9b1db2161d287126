//! All runs of all scenarios, on all cores.
//!
//! Each job draws one drive and runs every estimator over it. Jobs end in any order; their scores are added up in the order of
//! the runs, so that the result does not depend on the number of cores, to the last bit.

use posebridge_analysis::accuracy::{BoundSum, Score};
use posebridge_estimator::offline::OfflineError;
use posebridge_link::HostTimer;
use posebridge_sim::montecarlo::Scenario;
use posebridge_telemetry::Span;

use super::bounds::Bounded;
use super::{Estimator, Verdict};
use crate::drawn::known_drive;
use crate::parallel::run_all;

/// A scenario with its name and how often it is driven.
pub(super) struct Planned {
    pub(super) name: String,
    pub(super) scenario: Scenario,
    pub(super) runs: u32,
}

/// A scenario that has been driven.
pub(super) struct Scored {
    pub(super) planned: Planned,
    /// One per estimator.
    pub(super) results: Vec<Scores>,
    /// What no filter can be better than, where there is such a bound.
    pub(super) bound: Option<BoundSum>,
    pub(super) bounded: Bounded,
    /// What the bound has cost, on one core.
    pub(super) bound_took: Span,
}

/// One estimator over all runs.
#[derive(Clone, Default)]
pub(super) struct Scores {
    pub(super) score: Score,
    /// The runs of which it says nothing, and why.
    pub(super) refusals: Vec<(u32, OfflineError)>,
}

/// What one job gives back.
struct Driven {
    verdicts: Vec<Verdict>,
    bound: Option<BoundSum>,
    bound_took: Span,
}

/// One run of one scenario, both by their index.
#[derive(Clone, Copy)]
struct Job {
    scenario: usize,
    run: u32,
}

/// Runs every estimator over every run; `ended` is called once for each run.
pub(super) fn score_all(
    planned: Vec<Planned>,
    estimators: &[Estimator],
    timer: &HostTimer,
    ended: impl FnMut(),
) -> Vec<Scored> {
    let jobs: Vec<Job> = planned
        .iter()
        .enumerate()
        .flat_map(|(scenario, planned)| (0..planned.runs).map(move |run| Job { scenario, run }))
        .collect();
    let run = |job: &Job| {
        let planned = planned.get(job.scenario)?;
        Some(drive(planned, job.run, estimators, timer))
    };
    let by_job = run_all(&jobs, run, ended);
    added_up(planned, estimators.len(), &jobs, by_job)
}

/// Draws one drive and runs everything over it.
fn drive(planned: &Planned, run: u32, estimators: &[Estimator], timer: &HostTimer) -> Driven {
    let drive = planned.scenario.drive(run);
    let known = known_drive(&drive);
    let before = timer.now();
    let bound = Bounded::of(&planned.scenario).of_drive(&drive, &known);
    let bound_took = timer.now() - before;
    Driven { verdicts: estimators.iter().map(|estimator| estimator.score(&drive, &known)).collect(), bound, bound_took }
}

fn added_up(planned: Vec<Planned>, estimators: usize, jobs: &[Job], by_job: Vec<Option<Driven>>) -> Vec<Scored> {
    let mut all: Vec<Scored> = planned
        .into_iter()
        .map(|planned| Scored {
            bounded: Bounded::of(&planned.scenario),
            planned,
            results: vec![Scores::default(); estimators],
            bound: None,
            bound_took: Span::ZERO,
        })
        .collect();
    for (job, driven) in jobs.iter().zip(by_job) {
        if let (Some(scored), Some(driven)) = (all.get_mut(job.scenario), driven) {
            scored.add(job.run, driven);
        }
    }
    all
}

impl Scored {
    fn add(&mut self, run: u32, driven: Driven) {
        for (sum, verdict) in self.results.iter_mut().zip(driven.verdicts) {
            sum.score.absorb(&verdict.score);
            sum.refusals.extend(verdict.refusal.map(|refusal| (run, refusal)));
        }
        if let Some(bound) = driven.bound {
            self.bound.get_or_insert_with(BoundSum::default).absorb(&bound);
        }
        self.bound_took += driven.bound_took;
    }

    /// Root mean square of the bound over steps and runs, in metres.
    pub(super) fn bound_rms_m(&self) -> Option<f64> {
        self.bound.as_ref().and_then(BoundSum::rms_m)
    }
}
