//! Prior of the next sensor of a kind from several identified ones.
//!
//! # Model
//! Each run i gives ln tau_ij and shares with variances of their own, v_ij. The next run of the same kind is drawn from the same
//! population. Its mean and spread are learned from n runs and a prior spread that weighs as much as three runs:
//! ```text
//! m_j = mean of ln tau_ij      s_j^2 = (3 s_0^2 + sum over i of (ln tau_ij - m_j)^2) / (n + 2)                         (9)
//! ln tau_j of the next run     Student's t, nu = n + 2, mean m_j, q_j^2 = s_j^2 (1 + 1/n) + mean of v_ij / n          (10)
//! ```
//! (10) is the predictive distribution of a Gaussian population whose variance has an inverse gamma prior of three degrees of freedom.
//! Its heavy tails let the data overrule the prior; its peak dominates otherwise. The error of the model, (4) of [`super::fit`], is
//! learned in the same way:
//! ```text
//! delta^2 = (3 s_0^2 + sum of delta_i^2) / (n + 3)     T = mean of T_i, or of the run's mean lag where no error was found      (13)
//! ```
//! No sensor is exactly a sum of a few exponentials: without s_0 a short noisy run, which cannot reveal its model error, would be
//! assigned none.
//!
//! Runs that differ by no more than their own sigmas may also have equal dynamics; then both hypotheses are kept, and the samples of
//! the next run decide (prediction.rs). With two runs or more, each is predicted from the others: the order with the smallest error is
//! selected, and if the bounds contain the truth too rarely, the sigmas of the next prediction are increased accordingly.
//!
//! Steps up and down are identified separately. A direction without a run gets the prior of the other, with an additional common scale
//! of all lags: heat transfer into a body and out of it differ.
//! ```text
//! ln tau_j = ln s + ln tau_j of (10)          ln s of variance s_c^2, the same for all j                               (14)
//! ```
//! One common scale is estimated faster than several lags separately.
//!
//! # Sources
//! Gelman and others, Bayesian Data Analysis, third edition, sections 3.2 and 3.3; docs/lab/thermometer.md section 4.

use nalgebra::{DMatrix, DVector};
use posebridge_estimator::numerics::chi_square::chi_square_quantile;
use posebridge_estimator::numerics::statistics;
use posebridge_telemetry::UncertainValue;

use super::TimedSample;
use super::prediction::{EndPrediction, PredictionScore, predict_series, score_predictions};
use super::prior::{DynamicsPrior, ExpectedDynamics, MAX_ORDER, StepDirection, row};
use super::step::{CandidateModel, IdentifiedStep};

/// s_0 of ln tau: time constants of one kind differ by 5 % until the runs show otherwise.
const LN_LAG_SPREAD: f64 = 0.05;
/// s_c: another water film around the sensor scales all lags by about 20 %.
const OTHER_DIRECTION_LN_SCALE: f64 = 0.2;
/// s_0 of the shares.
const SHARE_SPREAD: f64 = 0.02;
/// s_0 of delta: no sensor is exactly a sum of exponentials, even if its runs do not show it. Two lags leave 1.5, 2.0 and 3.9 % of the
/// remaining transient of three DS18B20 in ice water (root mean squares of both over the step); the worst of a kind counts.
const MODEL_SHARE: f64 = 0.04;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RunSimilarity {
    /// Sensors of one kind, or one sensor in different surroundings: equations (9) and (10).
    #[default]
    SameKind,
    /// Equal dynamics for a step in the same direction: differences are identification errors.
    SameDynamics,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SensorKind {
    order: usize,
    similarity: RunSimilarity,
    sigma_factor: f64,
    up: Vec<CandidateModel>,
    down: Vec<CandidateModel>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KindError {
    #[error("no identified run")]
    NoRun,
    #[error("there is no order that all {runs} runs could be described by")]
    NoCommonOrder { runs: usize },
}

impl SensorKind {
    /// Learns from identified runs. The order is the one by which the runs predict each other best; for a single run, its own.
    pub fn from_runs(runs: &[IdentifiedStep], likeness: RunSimilarity) -> Result<Self, KindError> {
        let first = runs.first().ok_or(KindError::NoRun)?;
        let kinds: Vec<Self> = (1..=MAX_ORDER)
            .filter(|order| *order == 1 || is_resolved_in_all(runs, *order))
            .filter_map(|order| Self::with_order(runs, order, likeness))
            .collect();
        let none = KindError::NoCommonOrder { runs: runs.len() };
        if runs.len() == 1 {
            let own = kinds.into_iter().find(|kind| kind.order == first.order());
            return own.ok_or(none);
        }
        let tried = kinds.into_iter().map(|kind| {
            let score = kind.cross_validate(runs);
            (score, kind)
        });
        let best = tried.min_by(|(a, _), (b, _)| a.mean_error.total_cmp(&b.mean_error));
        let (score, mut kind) = best.ok_or(none)?;
        kind.sigma_factor = score.bound_factor.max(1.0);
        Ok(kind)
    }

    /// Uses the candidates of one order; `None` if a run has none.
    pub fn with_order(runs: &[IdentifiedStep], order: usize, likeness: RunSimilarity) -> Option<Self> {
        let mut kind = Self { order, similarity: likeness, sigma_factor: 1.0, up: vec![], down: vec![] };
        for run in runs {
            let candidate = run.of_order(order)?.clone();
            match StepDirection::from_step(candidate.fit.response.step) {
                StepDirection::Up => kind.up.push(candidate),
                StepDirection::Down => kind.down.push(candidate),
            }
        }
        (!runs.is_empty()).then_some(kind)
    }

    pub const fn order(&self) -> usize {
        self.order
    }

    /// Predicts each run from the others. A run that cannot be predicted counts with the maximum error.
    fn cross_validate(&self, runs: &[IdentifiedStep]) -> PredictionScore {
        let each = (0..runs.len()).map(|held_out| {
            let others: Vec<IdentifiedStep> =
                runs.iter().enumerate().filter(|(index, _)| *index != held_out).map(|(_, run)| run.clone()).collect();
            let kind = Self::with_order(&others, self.order, self.similarity)?;
            let run = runs.get(held_out)?;
            score_predictions(&predict(&run.samples, run.sigma, &kind), run)
        });
        let each: Vec<PredictionScore> = each.map(Option::unwrap_or_default).collect();
        PredictionScore {
            mean_error: statistics::mean(each.iter().map(|score| score.mean_error)).unwrap_or_default(),
            bound_factor: statistics::mean(each.iter().map(|score| score.bound_factor)).unwrap_or_default(),
        }
    }

    pub fn expectation(&self, direction: StepDirection) -> Option<ExpectedDynamics> {
        let (own, other) = match direction {
            StepDirection::Up => (&self.up, &self.down),
            StepDirection::Down => (&self.down, &self.up),
        };
        let is_own = !own.is_empty();
        let (runs, ln_scale) = if is_own { (own, 0.0) } else { (other, OTHER_DIRECTION_LN_SCALE) };
        let values = RunParameters::from_runs(runs, self.order);
        let same = (is_own && values.are_consistent()).then(|| values.same()).flatten();
        let is_known = is_own && self.similarity == RunSimilarity::SameDynamics;
        let dynamics = if is_known { values.same()? } else { values.of_kind(ln_scale, self.order)? };
        let (model_share, held_s) = model_error(runs, self.similarity);
        Some(ExpectedDynamics {
            same: same.filter(|_| !is_known),
            dynamics,
            model_share,
            error_duration_s: held_s,
            sigma_factor: self.sigma_factor,
        })
    }
}

/// Predicts a run of this kind as [`predict_with_expectation`](super::prediction::predict_with_expectation) does.
pub fn predict(samples: &[TimedSample], sigma: f64, kind: &SensorKind) -> Vec<EndPrediction> {
    predict_series(samples, sigma, |direction| kind.expectation(direction))
}

struct RunParameters {
    each: Vec<(DVector<f64>, DMatrix<f64>)>,
    mean: DVector<f64>,
}

impl RunParameters {
    fn from_runs(runs: &[CandidateModel], order: usize) -> Self {
        let rows = 2 * order - 1;
        let own = |run: &CandidateModel| {
            let covariance = &run.fit.covariance;
            covariance.view((row::LAGS, row::LAGS), (rows, rows)).into_owned()
        };
        let each: Vec<_> = runs.iter().map(|run| (parameter_rows(run, rows), own(run))).collect();
        let sum: DVector<f64> = each.iter().map(|(value, _)| value).sum();
        Self { mean: sum / runs.len() as f64, each }
    }

    /// Covariance of the mean from the identification errors of the runs.
    fn identification_covariance(&self) -> DMatrix<f64> {
        let sum: DMatrix<f64> = self.each.iter().map(|(_, own)| own).sum();
        sum / (self.each.len() as f64).powi(2)
    }

    /// Whether the differences between runs are within their sigmas, at a level of 5 %.
    fn are_consistent(&self) -> bool {
        let squares: Option<f64> = self
            .each
            .iter()
            .map(|(value, own)| {
                let off = value - &self.mean;
                Some(off.dot(&own.clone().cholesky()?.solve(&off)))
            })
            .sum();
        let freedom = (self.each.len() - 1) * self.mean.len();
        freedom == 0 || squares.is_some_and(|squares| squares <= chi_square_quantile(freedom as u64, 0.95))
    }

    fn same(&self) -> Option<DynamicsPrior> {
        DynamicsPrior::new(self.mean.clone(), self.identification_covariance(), f64::INFINITY)
    }

    /// Equations (9) and (10), with a common scale of all lags by (14).
    fn of_kind(&self, ln_scale: f64, order: usize) -> Option<DynamicsPrior> {
        let count = self.each.len() as f64;
        let freedom = PRIOR_FREEDOM + count - 1.0;
        let variances = (0..self.mean.len()).map(|i| {
            let spread = if i < order { LN_LAG_SPREAD } else { SHARE_SPREAD };
            let off = self.each.iter().map(|(value, _)| (value[i] - self.mean[i]).powi(2));
            let scatter: f64 = off.sum();
            (PRIOR_FREEDOM * spread * spread + scatter) / freedom * (1.0 + 1.0 / count)
        });
        let between = DVector::from_iterator(self.mean.len(), variances);
        let mut covariance = self.identification_covariance() + DMatrix::from_diagonal(&between);
        covariance.view_mut((0, 0), (order, order)).add_scalar_mut(ln_scale * ln_scale);
        DynamicsPrior::new(self.mean.clone(), covariance, freedom)
    }
}

fn parameter_rows(run: &CandidateModel, rows: usize) -> DVector<f64> {
    let lags = &run.fit.response.lags;
    let ln_lags = lags.iter().map(|lag| lag.time_constant_s.ln());
    let shares = lags.iter().map(|lag| lag.share);
    DVector::from_iterator(rows, ln_lags.chain(shares).take(rows))
}

/// delta and T of the next run: from the runs, and within a kind also from the prior.
fn model_error(runs: &[CandidateModel], likeness: RunSimilarity) -> (f64, f64) {
    let count = runs.len() as f64;
    let squares: f64 = runs.iter().map(|run| run.model_share.powi(2)).sum();
    if likeness == RunSimilarity::SameDynamics {
        let held_s = runs.iter().map(|run| run.error_duration_s).sum::<f64>() / count;
        return ((squares / count).sqrt(), held_s);
    }
    let prior_squares = PRIOR_FREEDOM * MODEL_SHARE * MODEL_SHARE;
    let held_s = runs.iter().map(|run| {
        let lags = run.fit.response.lags.iter();
        let mean_lag_s: f64 = lags.map(|lag| lag.share * lag.time_constant_s).sum();
        if run.error_duration_s > 0.0 { run.error_duration_s } else { mean_lag_s.max(0.0) }
    });
    (((prior_squares + squares) / (PRIOR_FREEDOM + count)).sqrt(), held_s.sum::<f64>() / count)
}

/// Degrees of freedom of the prior spread, equivalent to this number of runs.
const PRIOR_FREEDOM: f64 = 3.0;

/// An order whose share may be zero in a run has undetermined lags.
fn is_resolved_in_all(runs: &[IdentifiedStep], order: usize) -> bool {
    let mut candidates = runs.iter().map(|run| run.of_order(order));
    candidates.all(|candidate| candidate.is_some_and(IdentifiedStep::is_resolved))
}

// Steps up against steps down: heat goes into a body through another film than out of it.
//
// ```text
// m = sum of x_i / s_i^2 / sum of 1 / s_i^2        s = 1 / sqrt(sum of 1 / s_i^2), times the larger one of 1 and the scatter
// scatter^2 = sum of ((x_i - m) / s_i)^2 / (n - 1)        z = (m_up - m_down) / sqrt(s_up^2 + s_down^2)                  (17)
// ```
//
// # Sources
// The weighted mean with Birge's ratio (1932), as for physical constants; docs/lab/calibration.md, section 7.

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionComparison {
    pub up: UncertainValue,
    pub down: UncertainValue,
    /// z of equation (17).
    pub z: f64,
}

impl DirectionComparison {
    /// Whether they differ, at a level of 1 %.
    pub fn differ(&self) -> bool {
        self.z.abs() > TWO_SIDED_SIGMAS
    }
}

/// 99.5 % quantile of the normal distribution.
const TWO_SIDED_SIGMAS: f64 = 2.575_829;

/// Compares one parameter of several steps; `None` unless there are steps in both directions, each with a positive sigma.
pub fn compare_directions(steps: &[(StepDirection, UncertainValue)]) -> Option<DirectionComparison> {
    let of = |direction: StepDirection| {
        let own = steps.iter().filter(|(which, _)| *which == direction);
        mean(&own.map(|(_, known)| *known).collect::<Vec<_>>())
    };
    let (up, down) = (of(StepDirection::Up)?, of(StepDirection::Down)?);
    Some(DirectionComparison { z: (up.value - down.value) / up.sigma.hypot(down.sigma), up, down })
}

fn mean(all: &[UncertainValue]) -> Option<UncertainValue> {
    let weights: f64 = all.iter().map(|known| known.sigma.powi(-2)).sum();
    let sum: f64 = all.iter().map(|known| known.value * known.sigma.powi(-2)).sum();
    let value = sum / weights;
    let off = all.iter().map(|known| ((known.value - value) / known.sigma).powi(2));
    let scatter = off.sum::<f64>() / (all.len().max(2) - 1) as f64;
    let sigma = weights.sqrt().recip() * scatter.max(1.0).sqrt();
    (value.is_finite() && sigma > 0.0 && sigma.is_finite()).then_some(UncertainValue { value, sigma })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(value: f64, sigma: f64) -> UncertainValue {
        UncertainValue { value, sigma }
    }

    #[test]
    fn ways_that_differ_are_told_apart_and_others_are_not() {
        let found = compare_directions(&[
            (StepDirection::Up, known(2.0, 0.1)),
            (StepDirection::Down, known(2.5, 0.1)),
            (StepDirection::Up, known(2.1, 0.1)),
        ])
        .unwrap();
        assert!((found.up.value - 2.05).abs() < 1e-12);
        assert!((found.up.sigma - 0.1 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((found.z + 0.45 / 0.015_f64.sqrt()).abs() < 1e-9);
        assert!(found.differ());
        let alike = compare_directions(&[(StepDirection::Up, known(2.0, 0.1)), (StepDirection::Down, known(2.2, 0.1))]);
        assert!(!alike.unwrap().differ());
    }

    #[test]
    fn runs_that_scatter_make_their_mean_as_uncertain() {
        let up = [(StepDirection::Up, known(1.0, 0.1)), (StepDirection::Up, known(3.0, 0.1))];
        let found = compare_directions(&[&up[..], &[(StepDirection::Down, known(2.5, 0.1))]].concat()).unwrap();
        assert!((found.up.value - 2.0).abs() < 1e-12);
        // Off by ten sigma each: 0.1 / sqrt(2) times sqrt(200).
        assert!((found.up.sigma - 1.0).abs() < 1e-9, "{found:?}");
        assert!(!found.differ());
    }

    #[test]
    fn one_way_alone_or_a_sigma_of_zero_is_no_comparison() {
        assert_eq!(compare_directions(&[(StepDirection::Up, known(1.0, 0.1))]), None);
        assert_eq!(compare_directions(&[]), None);
        let exact = [(StepDirection::Up, known(1.0, 0.0)), (StepDirection::Down, known(1.0, 0.1))];
        assert_eq!(compare_directions(&exact), None);
    }
}
