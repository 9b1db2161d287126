//! Jobs on all cores, with results in the order of the jobs: what comes out does not depend on how many cores there are.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread;

/// Results that wait to be taken; a worker that is far ahead waits rather than pile them up.
const RESULTS_UNDER_WAY: usize = 64;

/// Runs every job; `ended` is called once for each, in the order in which they end.
///
/// # Panics
/// A job has panicked.
pub fn run_all<Job: Sync, Done: Send>(
    jobs: &[Job],
    run: impl Fn(&Job) -> Done + Sync,
    mut ended: impl FnMut(),
) -> Vec<Done> {
    let next = AtomicUsize::new(0);
    let workers = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut done: Vec<(usize, Done)> = Vec::with_capacity(jobs.len());
    thread::scope(|scope| {
        let (sender, receiver) = sync_channel(RESULTS_UNDER_WAY);
        for _ in 0..workers.min(jobs.len()) {
            let sender = sender.clone();
            let (next, run) = (&next, &run);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = jobs.get(index) else { return };
                    if sender.send((index, run(job))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for result in receiver {
            done.push(result);
            ended();
        }
    });
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, done)| done).collect()
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
}
