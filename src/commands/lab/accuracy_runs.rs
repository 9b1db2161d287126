//! All runs of all scenarios, on all cores.
//!
//! Each job draws one drive and runs every estimator over it. Jobs end in any order; their scores are added up in the order of
//! the runs, so that the result does not depend on the number of cores, to the last bit.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use posebridge_analysis::TimedPose;
use posebridge_analysis::accuracy::{Arrival, KnownDrive, Score};
use posebridge_sim::montecarlo::{Drive, Scenario};

use super::Estimator;

/// A scenario with its name and how often it is driven.
pub(super) struct Planned {
    pub(super) name: String,
    pub(super) scenario: Scenario,
    pub(super) runs: u32,
}

/// One score per estimator.
pub(super) struct Scored {
    pub(super) planned: Planned,
    pub(super) scores: Vec<Score>,
}

/// One run of one scenario, both by their index.
#[derive(Clone, Copy)]
struct Job {
    scenario: usize,
    run: u32,
}

/// Scores that wait to be added up; a worker that is far ahead waits rather than pile them up.
const SCORES_UNDER_WAY: usize = 64;

/// Runs every estimator over every run; `ended` is called once for each run.
pub(super) fn score_all(
    planned: Vec<Planned>,
    estimators: &[Estimator],
    mut ended: impl FnMut(),
) -> Vec<Scored> {
    let jobs: Vec<Job> = planned
        .iter()
        .enumerate()
        .flat_map(|(scenario, planned)| (0..planned.runs).map(move |run| Job { scenario, run }))
        .collect();
    let mut by_job: Vec<Option<Vec<Score>>> = jobs.iter().map(|_| None).collect();
    let next = AtomicUsize::new(0);
    let workers = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    thread::scope(|scope| {
        let (sender, receiver) = sync_channel(SCORES_UNDER_WAY);
        for _ in 0..workers.min(jobs.len()) {
            let sender = sender.clone();
            let (jobs, planned, next) = (&jobs, &planned, &next);
            scope.spawn(move || work(jobs, planned, estimators, next, &sender));
        }
        drop(sender);
        for (index, scores) in receiver {
            if let Some(slot) = by_job.get_mut(index) {
                *slot = Some(scores);
            }
            ended();
        }
    });
    added_up(planned, estimators.len(), &jobs, by_job)
}

/// Takes jobs until there is none, or until nobody listens.
fn work(
    jobs: &[Job],
    planned: &[Planned],
    estimators: &[Estimator],
    next: &AtomicUsize,
    sender: &SyncSender<(usize, Vec<Score>)>,
) {
    loop {
        let index = next.fetch_add(1, Ordering::Relaxed);
        let Some(job) = jobs.get(index) else { return };
        let Some(planned) = planned.get(job.scenario) else {
            return;
        };
        let drive = planned.scenario.drive(job.run);
        let known = known_drive(&drive);
        let scores = estimators
            .iter()
            .map(|estimator| estimator.score(&drive, &known))
            .collect();
        if sender.send((index, scores)).is_err() {
            return;
        }
    }
}

fn added_up(
    planned: Vec<Planned>,
    estimators: usize,
    jobs: &[Job],
    by_job: Vec<Option<Vec<Score>>>,
) -> Vec<Scored> {
    let mut all: Vec<Scored> = planned
        .into_iter()
        .map(|planned| Scored {
            planned,
            scores: vec![Score::default(); estimators],
        })
        .collect();
    for (job, scores) in jobs.iter().zip(by_job) {
        let (Some(scored), Some(scores)) = (all.get_mut(job.scenario), scores) else {
            continue;
        };
        for (sum, score) in scored.scores.iter_mut().zip(&scores) {
            sum.absorb(score);
        }
    }
    all
}

/// The drive as the scoring wants it.
fn known_drive(drive: &Drive) -> KnownDrive {
    let truth = drive
        .truth
        .iter()
        .enumerate()
        .map(|(step, pose)| TimedPose {
            stamp: drive.stamp(step),
            pose: *pose,
        });
    let arrivals = drive.arrivals.iter().map(|arrival| Arrival {
        step: arrival.step,
        observation: arrival.observation,
    });
    KnownDrive {
        truth: truth.collect(),
        arrivals: arrivals.collect(),
        scored_from: drive.scored_from,
    }
}
