//! Selects the step length from the start values towards the maximum of the likelihood by cross-validation.
//!
//! A maximum of the likelihood overfits the runs that it was found on: their geometry, floor and driving style. Its gain there is
//! larger than elsewhere, and a filter that trusts its wheels too much pays more for it than one that trusts them too little. So the
//! search is repeated without a part of the data, and that part is scored.
//!
//! # Model
//! ```text
//! x(s)   = s x^                                         s = 0 the start, s = 1 the maximum                         (1)
//! g_f(s) = L_f(s x^_-f) - L_f(0)                        fold f, and the maximum x^_-f of all the others            (2)
//! G(s)   = sum_f g_f(s)      se = sqrt(F / (F - 1) sum_f (g_f(s*) - G(s*) / F)^2)       s* = argmax G              (3)
//! s^     = the smallest s with G(s) >= G(s*) - se                                                                  (4)
//! ```
//! Where positions are known that the filter did not get, s^ is then reduced until the position error is no larger than at the start.
//!
//! # Source
//! (2), (3): M. Stone, Cross-validatory choice and assessment of statistical predictions, J. R. Statist. Soc. B 36(2), 1974.
//! (4), the rule of one standard error: L. Breiman et al., Classification and Regression Trees, 1984, section 3.4.3.

use posebridge_telemetry::{BrickClock, Observation, TimeDelta, Timestamp};

use crate::statistics::RunningMean;

/// Eighths: the whole step is a few standard deviations long, and no data resolve more.
pub const SHARES: [f64; 9] = [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0];
/// Fewer runs are split into blocks of time, until there is this number of parts.
const MIN_BLOCKS: usize = 6;
/// More parts share folds: each fold costs a search.
const MAX_FOLDS: usize = 8;

pub fn blocks_per_run(runs: usize) -> usize {
    MIN_BLOCKS.div_ceil(runs.max(1))
}

pub fn fold_count(parts: usize) -> usize {
    parts.min(MAX_FOLDS)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeBlocks {
    first: Timestamp<BrickClock>,
    length: TimeDelta,
    count: usize,
}

impl TimeBlocks {
    /// From the earliest to the latest timestamp; at least one block.
    pub fn from_observations(observations: &[Observation], count: usize) -> Self {
        let stamps = || observations.iter().map(|observation| observation.stamp);
        let first = stamps().min().unwrap_or(Timestamp::ZERO);
        Self { first, length: stamps().max().unwrap_or(Timestamp::ZERO) - first, count: count.max(1) }
    }

    pub const fn count(&self) -> usize {
        self.count
    }

    /// The block of an instant; earlier and later instants belong to the first and the last block.
    pub fn index(&self, stamp: Timestamp<BrickClock>) -> usize {
        let length_s = self.length.as_secs_f64();
        let into_s = (stamp - self.first).as_secs_f64().clamp(0.0, length_s);
        if length_s > 0.0 {
            // Not negative and at most `count`: the cast loses the fraction only.
            ((into_s / length_s * self.count as f64) as usize).min(self.count - 1)
        } else {
            0
        }
    }
}

/// Scores of one fold at each of [`SHARES`] of the step that was found without it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FoldScore {
    pub log_likelihood: [f64; SHARES.len()],
    /// Squared position errors of the online filter, m².
    pub squares: [RunningMean; SHARES.len()],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShareChoice {
    pub index: usize,
    /// G(s) of equation (3).
    pub gains: [f64; SHARES.len()],
    pub standard_error: f64,
    /// Over all folds; `None` without known positions.
    pub position_rms_m: [Option<f64>; SHARES.len()],
    pub reason: ChoiceReason,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChoiceReason {
    /// Equation (4).
    Likelihood,
    /// Beyond it the errors of withheld positions are larger than at the start.
    Position,
    /// Fewer than two usable folds: the whole step.
    NoFolds,
}

impl ShareChoice {
    pub fn share(&self) -> f64 {
        SHARES.get(self.index).copied().unwrap_or(1.0)
    }
}

/// Selects by equation (4) and by the position errors.
pub fn choose(folds: &[FoldScore]) -> ShareChoice {
    let gains: [f64; SHARES.len()] = std::array::from_fn(|s| folds.iter().map(|fold| gain(fold, s)).sum());
    let position_rms_m: [Option<f64>; SHARES.len()] = std::array::from_fn(|s| {
        let mut all = RunningMean::default();
        for fold in folds {
            all.merge(&fold.squares[s]);
        }
        all.root()
    });
    let all_of_it = ShareChoice {
        index: SHARES.len() - 1,
        gains,
        standard_error: 0.0,
        position_rms_m,
        reason: ChoiceReason::NoFolds,
    };
    if folds.len() < 2 {
        return all_of_it;
    }
    let best = best_index(&gains);
    let mean = gains[best] / folds.len() as f64;
    let squares: f64 = folds.iter().map(|fold| (gain(fold, best) - mean).powi(2)).sum();
    let count = folds.len() as f64;
    let standard_error = (count / (count - 1.0) * squares).sqrt();
    let enough = gains[best] - standard_error;
    let by_likelihood = gains.iter().position(|gain| *gain >= enough).unwrap_or(0);
    let is_no_worse = |s: &usize| match (position_rms_m[*s], position_rms_m[0]) {
        (Some(here), Some(start)) => here <= start,
        _ => true,
    };
    let index = (0..=by_likelihood).rev().find(is_no_worse).unwrap_or(0);
    ShareChoice {
        index,
        standard_error,
        reason: if index == by_likelihood { ChoiceReason::Likelihood } else { ChoiceReason::Position },
        ..all_of_it
    }
}

fn gain(fold: &FoldScore, share: usize) -> f64 {
    fold.log_likelihood[share] - fold.log_likelihood[0]
}

fn best_index(gains: &[f64; SHARES.len()]) -> usize {
    let mut best = 0;
    for (index, gain) in gains.iter().enumerate() {
        if *gain > gains[best] {
            best = index;
        }
    }
    best
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitQuality {
    /// Mean log-likelihood of an innovation component; `None` without one.
    pub ln_p_each: Option<f64>,
    /// Of the online filter; `None` without known positions.
    pub position_rms_m: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QualityLoss {
    Likelihood,
    Position,
    Both,
}

impl FitQuality {
    /// The criterion by which these parameters are worse than those at the start; NaN counts as worse.
    pub fn loss_against(&self, start: &Self) -> Option<QualityLoss> {
        let less_likely = matches!(
            (self.ln_p_each, start.ln_p_each),
            (Some(here), Some(start)) if here.is_nan() || here < start
        );
        let further_off = matches!(
            (self.position_rms_m, start.position_rms_m),
            (Some(here), Some(start)) if here.is_nan() || here > start
        );
        match (less_likely, further_off) {
            (true, true) => Some(QualityLoss::Both),
            (true, false) => Some(QualityLoss::Likelihood),
            (false, true) => Some(QualityLoss::Position),
            (false, false) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::wheels;

    fn at(second: i64) -> Observation {
        wheels(1_000 * second, 0.0, 0.0)
    }

    /// A fold that gains by a parabola with its top at `top`, and misses positions by `error_m`.
    fn fold(height: f64, top: f64, error_m: impl Fn(f64) -> f64) -> FoldScore {
        let of = |s: f64| height * (1.0 - (s / top - 1.0).powi(2));
        FoldScore {
            log_likelihood: SHARES.map(|s| -500.0 + of(s)),
            squares: SHARES.map(|s| {
                let mut squares = RunningMean::default();
                squares.add(error_m(s).powi(2));
                squares
            }),
        }
    }

    #[test]
    fn a_run_is_cut_into_equal_lengths_of_time_and_nothing_falls_off_its_ends() {
        let blocks = TimeBlocks::from_observations(&[at(70), at(10), at(20)], 6);
        let of = |second: i64| blocks.index(Timestamp::from_millis(1_000 * second));
        assert_eq!([10, 19, 20, 65, 70].map(of), [0, 0, 1, 5, 5]);
        assert_eq!([-5, 500].map(of), [0, 5]);
        assert_eq!(TimeBlocks::from_observations(&[at(3)], 4).index(Timestamp::from_millis(3_000)), 0);
        assert_eq!(TimeBlocks::from_observations(&[], 0).count(), 1);
    }

    #[test]
    fn few_runs_make_enough_parts_and_many_runs_share_folds() {
        for (runs, folds) in [(1, 6), (2, 6), (3, 6), (4, 8), (6, 6), (24, 8)] {
            assert_eq!(fold_count(runs * blocks_per_run(runs)), folds, "{runs}");
        }
    }

    #[test]
    fn folds_that_agree_go_nearly_all_the_way_and_folds_that_differ_less_far() {
        let same = choose(&[fold(10.0, 1.0, |_| 0.01); 6]);
        assert_eq!((same.share(), same.standard_error), (1.0, 0.0));
        // Gains 4 to 16: se = sqrt(6 / 5 x 106) = 11.3 of 60, which the parabola leaves at 1 - s = 0.43.
        let heights = [4.0, 6.0, 9.0, 11.0, 14.0, 16.0];
        let differing = choose(&heights.map(|height| fold(height, 1.0, |_| 0.01)));
        assert!((differing.standard_error - 127.2_f64.sqrt()).abs() < 1e-9);
        assert_eq!((differing.share(), differing.reason), (0.625, ChoiceReason::Likelihood));
    }

    #[test]
    fn a_gain_that_is_not_beyond_chance_moves_nothing() {
        let heights = [20.0, -15.0, 10.0, -12.0, 3.0, 2.0];
        let choice = choose(&heights.map(|height| fold(height, 1.0, |_| 0.01)));
        assert_eq!((choice.share(), choice.reason), (0.0, ChoiceReason::Likelihood));
    }

    #[test]
    fn positions_that_are_missed_by_more_hold_it_back() {
        let off = |s: f64| 0.01 + if s > 0.4 { 0.005 } else { -0.001 * s };
        let choice = choose(&[fold(10.0, 1.0, off); 6]);
        assert_eq!((choice.share(), choice.reason), (0.375, ChoiceReason::Position));
        let never = choose(&[fold(10.0, 1.0, |s| if s > 0.0 { f64::NAN } else { 0.01 }); 6]);
        assert_eq!((never.share(), never.reason), (0.0, ChoiceReason::Position));
    }

    #[test]
    fn without_folds_the_likelihood_alone_is_left() {
        let choice = choose(&[fold(10.0, 1.0, |_| 0.01)]);
        assert_eq!((choice.share(), choice.reason), (1.0, ChoiceReason::NoFolds));
        assert_eq!(choose(&[]).position_rms_m, [None; SHARES.len()]);
    }

    #[test]
    fn numbers_that_lose_on_what_was_held_out_are_told_in_what() {
        let worth = |ln_p_each, rms_m| FitQuality { ln_p_each: Some(ln_p_each), position_rms_m: Some(rms_m) };
        let start = worth(2.0, 0.010);
        assert_eq!(start.loss_against(&start), None);
        assert_eq!(worth(2.1, 0.009).loss_against(&start), None);
        assert_eq!(worth(1.9, 0.009).loss_against(&start), Some(QualityLoss::Likelihood));
        assert_eq!(worth(2.1, 0.011).loss_against(&start), Some(QualityLoss::Position));
        assert_eq!(worth(1.9, f64::NAN).loss_against(&start), Some(QualityLoss::Both));
        let blind = FitQuality { position_rms_m: None, ..worth(2.1, 0.0) };
        assert_eq!(blind.loss_against(&start), None);
    }
}
