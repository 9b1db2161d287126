//! The search over the training runs, and the cross-validation, on all cores.

use std::collections::BTreeMap;

use posebridge_estimator::{FilterConfig, FilterEntry};
use posebridge_lab::statistics::RunningMean;
use posebridge_lab::tuning::{
    FoldScore, RunFit, SHARES, SearchOptions, SearchResult, ShareChoice, TimeBlocks, TunedKey, blocks_per_run, choose,
    fold_count, ln_prior, maximise,
};

use super::runs::TuneRun;
use crate::lab::parallel::run_all;

/// Typical total rounds of the searches with and without folds: they share points.
const USUAL_ROUNDS: u64 = 30;

pub(super) struct TuneSearch<'a> {
    pub(super) filter: &'static FilterEntry,
    pub(super) keys: &'a [TunedKey],
    /// Logarithm of the factor on the tuned parameters before the search.
    pub(super) start: f64,
    training: Vec<(&'a TuneRun, TimeBlocks)>,
    blocks: usize,
    /// ln L of each part, run by run and block by block, at the evaluated points.
    cache: BTreeMap<Vec<i64>, Vec<f64>>,
}

struct BlockScores {
    log_likelihoods: Vec<f64>,
    squares: Vec<RunningMean>,
}

impl<'a> TuneSearch<'a> {
    pub(super) fn new(
        filter: &'static FilterEntry,
        keys: &'a [TunedKey],
        start: f64,
        training: &[&'a TuneRun],
    ) -> Self {
        let blocks = blocks_per_run(training.len());
        let cut = |run: &&'a TuneRun| (*run, TimeBlocks::from_observations(&run.observations, blocks));
        Self { filter, keys, start, training: training.iter().map(cut).collect(), blocks, cache: BTreeMap::new() }
    }

    /// Approximate number of filter runs until the parameters are selected, for the progress bar.
    pub(super) fn expected_passes(&self) -> u64 {
        let polled = 2 * self.keys.len() as u64 + 3;
        let searched = USUAL_ROUNDS * polled * self.training.len() as u64;
        let scored = self.folds() * SHARES.len() * self.training.len().div_ceil(self.folds()).max(1);
        searched + scored as u64
    }

    pub(super) fn folds(&self) -> usize {
        fold_count(self.training.len() * self.blocks)
    }

    pub(super) fn config(&self, run: &TuneRun, at: &[f64]) -> FilterConfig {
        let mut config = run.config.clone();
        for (key, x) in self.keys.iter().zip(at) {
            key.scale(&mut config, (self.start + x).exp());
        }
        config
    }

    fn fold(&self, run: usize, block: usize) -> usize {
        (run * self.blocks + block) % self.folds()
    }

    /// The maximum over all parts except those of one fold.
    pub(super) fn maximum(&mut self, search: &SearchOptions, without: Option<usize>, ended: &dyn Fn()) -> SearchResult {
        let keys = self.keys.len();
        maximise(keys, search, |points| {
            self.evaluate(points, ended);
            points.iter().map(|point| self.sum(point, without) + ln_prior(point)).collect()
        })
    }

    /// Runs the filter at all points that are not cached: the searches without a fold share points.
    fn evaluate(&mut self, points: &[Vec<f64>], ended: &dyn Fn()) {
        let mut new: Vec<&Vec<f64>> = Vec::new();
        for point in points {
            let is_known = self.cache.contains_key(&cache_key(point));
            if !is_known && new.iter().all(|other| cache_key(other) != cache_key(point)) {
                new.push(point);
            }
        }
        let training = &self.training;
        let jobs: Vec<(&Vec<f64>, &(&TuneRun, TimeBlocks))> =
            new.iter().flat_map(|point| training.iter().map(move |run| (*point, run))).collect();
        let fit = |(point, (run, blocks)): &(&Vec<f64>, &(&TuneRun, TimeBlocks))| -> Vec<f64> {
            let config = self.config(run, point);
            let fits = run.fit_in_blocks(self.filter, config, blocks);
            fits.iter().map(RunFit::log_likelihood).collect()
        };
        let values = run_all(&jobs, fit, ended);
        for (point, parts) in new.into_iter().zip(values.chunks(training.len().max(1))) {
            self.cache.insert(cache_key(point), parts.concat());
        }
    }

    /// ln L at a cached point, without a fold.
    fn sum(&self, point: &[f64], without: Option<usize>) -> f64 {
        let Some(parts) = self.cache.get(&cache_key(point)) else {
            return f64::NEG_INFINITY;
        };
        let indexed = parts.iter().enumerate();
        indexed.filter(|(part, _)| Some(part % self.folds()) != without).map(|(_, value)| value).sum()
    }

    /// Cross-validation: scores each fold with the maximum found without it.
    pub(super) fn validate(&mut self, search: &SearchOptions, ended: &dyn Fn()) -> ShareChoice {
        let scores: Vec<FoldScore> = (0..self.folds())
            .map(|fold| {
                let found = self.maximum(search, Some(fold), ended);
                self.score(fold, &found.at, ended)
            })
            .collect();
        choose(&scores)
    }

    fn score(&self, fold: usize, to: &[f64], ended: &dyn Fn()) -> FoldScore {
        let runs: Vec<usize> = (0..self.training.len())
            .filter(|run| (0..self.blocks).any(|block| self.fold(*run, block) == fold))
            .collect();
        let jobs: Vec<(usize, usize)> =
            (0..SHARES.len()).flat_map(|share| runs.iter().map(move |run| (share, *run))).collect();
        let parts = run_all(&jobs, |(share, run)| self.parts(*run, *share, to), ended);
        let mut score = FoldScore::default();
        for ((share, run), parts) in jobs.iter().zip(&parts) {
            let values = parts.log_likelihoods.iter().zip(&parts.squares);
            for (block, (log_likelihood, squares)) in values.enumerate() {
                if self.fold(*run, block) == fold {
                    score.log_likelihood[*share] += log_likelihood;
                    score.squares[*share].merge(squares);
                }
            }
        }
        score
    }

    fn parts(&self, run: usize, share: usize, to: &[f64]) -> BlockScores {
        let (Some((run, blocks)), Some(share)) = (self.training.get(run), SHARES.get(share)) else {
            return BlockScores { log_likelihoods: Vec::new(), squares: Vec::new() };
        };
        let at: Vec<f64> = to.iter().map(|x| share * x).collect();
        let config = self.config(run, &at);
        let fits = run.fit_in_blocks(self.filter, config.clone(), blocks);
        BlockScores {
            log_likelihoods: fits.iter().map(RunFit::log_likelihood).collect(),
            squares: run.squares_in_blocks(self.filter, &config, blocks),
        }
    }
}

/// A point as a cache key: rounded far below the steps of a search, so that rounding errors of a sum do not matter.
fn cache_key(point: &[f64]) -> Vec<i64> {
    // Bounded by the search: the cast loses nothing but the fraction.
    point.iter().map(|x| (x * 1e9).round() as i64).collect()
}
