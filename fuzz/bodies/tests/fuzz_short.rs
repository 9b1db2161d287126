//! Every fuzz target on any compiler: over the committed corpus, and over seeded mutations of it.
//!
//! The count of runs is fixed and the seed stands here, so that a failure comes back on the next run and on another
//! machine. `fuzz/run` is the longer way, which follows coverage.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the checkout is broken")]

#[path = "support/mutations.rs"]
mod mutations;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::num::NonZeroUsize;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use mutations::mutated;
use posebridge_fuzz_bodies::{TARGETS, Target, target};
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// Seed of all mutations.
const SEED: u64 = 20_260_731;
/// Most files of the whole corpus, and most bytes: it is read by people and cloned by everybody.
const MAX_FILES: usize = 225;
const MAX_BYTES: usize = 200_000;

#[test]
fn every_target_keeps_its_promises_on_its_corpus() {
    for target in TARGETS {
        let corpus = corpus(target.name);
        for (path, bytes) in &corpus {
            assert_kept(target, bytes, &path.display().to_string());
        }
        println!("{}: {} corpus entries", target.name, corpus.len());
    }
}

#[test]
fn every_target_keeps_its_promises_on_mutations_of_its_corpus() {
    // `cargo test` has nothing else to run beside this.
    let next = AtomicUsize::new(0);
    let take_targets = || {
        while let Some(target) = TARGETS.get(next.fetch_add(1, Ordering::Relaxed)) {
            mutate_corpus(target);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, NonZeroUsize::get) {
            scope.spawn(take_targets);
        }
    });
}

fn mutate_corpus(target: &Target) {
    let corpus: Vec<_> = corpus(target.name).into_iter().map(|(_, bytes)| bytes).collect();
    let mut random = Pcg64::seed_from_u64(SEED);
    for run in 0..target.short_runs {
        let bytes = mutated(&corpus, &mut random);
        assert_kept(target, &bytes, &format!("mutation {run}"));
    }
}

#[test]
fn the_corpus_has_a_folder_for_every_target_and_no_other_and_stays_small() {
    let folders: BTreeSet<_> = fs::read_dir(corpus_folder())
        .expect("the corpus can be listed")
        .map(|entry| entry.expect("the corpus can be listed").file_name())
        .collect();
    let names: BTreeSet<_> = TARGETS.iter().map(|target| target.name.into()).collect();
    assert_eq!(folders, names);

    let entries: Vec<_> = TARGETS.iter().flat_map(|target| corpus(target.name)).collect();
    let bytes: usize = entries.iter().map(|(_, bytes)| bytes.len()).sum();
    assert!(entries.len() <= MAX_FILES, "{} files", entries.len());
    assert!(bytes <= MAX_BYTES, "{bytes} bytes");
}

#[test]
fn a_target_is_found_by_its_name_and_by_no_other() {
    for row in TARGETS {
        assert_eq!(target(row.name).map(|found| found.name), Some(row.name));
    }
    assert!(target("").is_none());
}

/// Runs one input; says which it was when a promise is broken.
fn assert_kept(target: &Target, bytes: &[u8], origin: &str) {
    let check = target.check;
    if catch_unwind(|| check(bytes)).is_err() {
        let name = target.name;
        let hex = bytes.iter().fold(String::new(), |mut hex, byte| {
            // Writing to a String cannot fail.
            let _ = write!(hex, "{byte:02x}");
            hex
        });
        panic!("{name}, {origin}: the panic above came from this input (hex): {hex}");
    }
}

/// The committed entries of one target, by name.
fn corpus(name: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let mut paths: Vec<_> = fs::read_dir(corpus_folder().join(name))
        .expect("every target has a folder in fuzz/corpus")
        .map(|entry| entry.expect("the corpus can be listed").path())
        .collect();
    paths.sort();
    assert!(!paths.is_empty(), "{name} has no seeds");
    paths
        .into_iter()
        .map(|path| {
            let bytes = fs::read(&path).expect("a corpus entry can be read");
            (path, bytes)
        })
        .collect()
}

fn corpus_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus")
}
