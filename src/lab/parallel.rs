//! Runs jobs on all cores; results are in the order of the jobs, independent of the number of cores.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::Result;

use crate::console::progress_bar;

/// Completed jobs that wait for `ended`; a worker that is far ahead blocks.
const ENDS_WAITING: usize = 64;

/// Runs every job; `ended` is called for each completed job, in the order of completion.
///
/// # Panics
/// A job has panicked.
pub fn run_all<Job: Sync, Done: Send>(
    jobs: &[Job],
    run: impl Fn(&Job) -> Done + Sync,
    mut ended: impl FnMut(),
) -> Vec<Done> {
    let results: Vec<Mutex<Option<Done>>> = jobs.iter().map(|_| Mutex::new(None)).collect();
    let run_job = |index: usize| {
        let done = run(&jobs[index]);
        *results[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(done);
    };
    run_numbers(jobs.len(), &run_job, &mut ended);
    results.into_iter().filter_map(|result| result.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// Calls `run` with every number below `count`, on all cores. It knows no type of job or result, so that it is compiled once.
fn run_numbers(count: usize, run: &(dyn Fn(usize) + Sync), ended: &mut dyn FnMut()) {
    let next = AtomicUsize::new(0);
    let workers = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    thread::scope(|scope| {
        let (sender, receiver) = sync_channel(ENDS_WAITING);
        for _ in 0..workers.min(count) {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= count {
                        return;
                    }
                    run(number);
                    if sender.send(()).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for () in receiver {
            ended();
        }
    });
}

/// With a progress bar that counts in `units`.
pub fn run_with_bar<Job: Sync, Done: Send>(
    jobs: &[Job],
    units: &str,
    run: impl Fn(&Job) -> Done + Sync,
) -> Result<Vec<Done>> {
    let bar = progress_bar(jobs.len() as u64, units)?;
    let done = run_all(jobs, run, || bar.inc(1));
    bar.finish_and_clear();
    Ok(done)
}

/// Runs each case `runs(case)` times with a progress bar; the results of each case are in the order of its runs.
pub fn run_cases<Case: Sync, Done: Send>(
    cases: &[Case],
    runs: impl Fn(&Case) -> u32,
    units: &str,
    run: impl Fn(&Case, u32) -> Done + Sync,
) -> Result<Vec<Vec<Done>>> {
    let jobs: Vec<(&Case, u32)> =
        cases.iter().flat_map(|case| (0..runs(case)).map(move |number| (case, number))).collect();
    let mut done = run_with_bar(&jobs, units, |(case, number)| run(case, *number))?.into_iter();
    Ok(cases.iter().map(|case| done.by_ref().take(runs(case) as usize).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_stand_in_the_order_of_the_jobs_and_every_end_is_told() {
        let jobs: Vec<u64> = (0..1_000).collect();
        let mut ended = 0;
        // Early jobs take longest.
        let run = |job: &u64| (0..(1_000 - job) * 20).fold(*job, |sum, _| sum);
        assert_eq!(run_all(&jobs, run, || ended += 1), jobs);
        assert_eq!(ended, jobs.len());
        assert_eq!(run_all(&[], run, || ended += 1), Vec::<u64>::new());
    }

    #[test]
    fn every_case_has_the_results_of_its_own_runs() {
        let runs = run_cases(&[2, 0, 3], |case| *case, "runs", |case, number| 10 * case + number).unwrap();
        assert_eq!(runs, [vec![20, 21], vec![], vec![30, 31, 32]]);
    }
}
