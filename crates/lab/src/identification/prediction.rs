//! Prediction of a sensor's final value at each sample, with uncertain dynamics.
//!
//! # Model
//! Equations (3) to (6) of [`super::fit`], over all samples so far. The bound is u plus and minus 1.96 of its sigma, which contains the
//! noise, the uncertainty of the lags, and the error of the model.
//!
//! At rest, before a step is detected, the prediction is the reading. Long after the step the error of the model vanishes, so that the
//! prediction converges to the reading without a switch.

use posebridge_estimator::numerics::statistics::quantile;

use super::fit::{ResponseFit, ResponseNoise, fit_response};
use super::onset::{DetectedOnset, OnsetDetector};
use super::prior::{DynamicsPrior, ExpectedDynamics, GaussianPrior, ResponsePrior, StepDirection};
use super::step::IdentifiedStep;
use super::step_response::StepResponse;
use super::{TimedSample, sorted_finite};

/// Probability with which the bound contains the final value.
pub const BOUND_RATE: f64 = 0.95;
/// Two-sided quantile of the normal distribution for [`BOUND_RATE`].
pub const BOUND_SIGMAS: f64 = 1.959_964;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndPrediction {
    /// Time of the latest sample, by the sensor's clock.
    pub at_s: f64,
    pub value: f64,
    /// One standard deviation, with the uncertainty of the dynamics.
    pub sigma: f64,
    pub is_settling: bool,
}

impl EndPrediction {
    /// The interval that contains the final value with probability [`BOUND_RATE`].
    pub fn bound(&self) -> (f64, f64) {
        let half = BOUND_SIGMAS * self.sigma;
        (self.value - half, self.value + half)
    }
}

/// Predicts at each sample, with the same prior for both step directions. `sigma` is the noise of a sample, in the sensor's unit.
///
/// There is a prediction for each of the first samples after the detection, and then one per 2 % of the elapsed samples. Samples that
/// are not finite or not later than the previous one are ignored. Empty if `sigma` is not positive and finite.
pub fn predict_with_expectation(
    samples: &[TimedSample],
    sigma: f64,
    expectation: &ExpectedDynamics,
) -> Vec<EndPrediction> {
    predict_series(samples, sigma, |_| Some(expectation.clone()))
}

/// The prediction after the last sample; equals the last of [`predict_with_expectation`], at the cost of one fit.
pub fn predict_once(samples: &[TimedSample], sigma: f64, expectation: &ExpectedDynamics) -> Option<EndPrediction> {
    let samples = sorted_finite(samples);
    let detector = OnsetDetector::new(sigma);
    let found = (1..=samples.len()).find_map(|k| detector.detect(samples.get(..k)?).map(|d| (k, d)));
    let (_, detected) = found?;
    let mut running = PredictorBank::new(&samples, sigma, &detected, expectation)?;
    running.prediction(&samples)
}

/// Number of predictions at every sample before they become sparser.
const DENSE_SAMPLES: usize = 60;
/// Then one prediction per this fraction of the samples since the onset.
const SPARSE_SHARE: usize = 50;

/// Predicts at each sample; `expect` is called once the direction of the step is known.
pub(super) fn predict_series(
    samples: &[TimedSample],
    sigma: f64,
    expect: impl Fn(StepDirection) -> Option<ExpectedDynamics>,
) -> Vec<EndPrediction> {
    let samples = sorted_finite(samples);
    if !(sigma > 0.0 && sigma.is_finite()) {
        return Vec::new();
    }
    let detector = OnsetDetector::new(sigma);
    let mut running: Option<PredictorBank> = None;
    let mut detected_at = 0;
    let mut next = 0;
    let mut predictions = Vec::new();
    for k in 1..=samples.len() {
        let so_far = samples.get(..k).unwrap_or_default();
        if running.is_none() {
            running = detector.detect(so_far).and_then(|detected| {
                detected_at = k;
                let direction = StepDirection::from_step(detected.direction);
                PredictorBank::new(so_far, sigma, &detected, &expect(direction)?)
            });
        }
        match &mut running {
            None => predictions.extend(predict_at_rest(so_far, sigma)),
            Some(running) => {
                let since = k - detected_at;
                if since >= next || k == samples.len() {
                    predictions.extend(running.prediction(so_far));
                    next = since + 1 + since.saturating_sub(DENSE_SAMPLES) / SPARSE_SHARE;
                }
            }
        }
    }
    predictions
}

fn predict_at_rest(so_far: &[TimedSample], sigma: f64) -> Option<EndPrediction> {
    let latest = so_far.last()?;
    Some(EndPrediction { at_s: latest.at_s, value: latest.value, sigma, is_settling: false })
}

/// A step in progress: a bank of models, one for each of several values of the slowest lag.
struct PredictorBank {
    noise: ResponseNoise,
    sigma_factor: f64,
    members: Vec<BankMember>,
}

struct BankMember {
    prior: ResponsePrior,
    /// Negative logarithm of its prior weight and of its prior volume.
    cost: f64,
    guess: StepResponse,
}

impl PredictorBank {
    fn new(
        so_far: &[TimedSample],
        sigma: f64,
        detected: &DetectedOnset,
        expectation: &ExpectedDynamics,
    ) -> Option<Self> {
        let latest = so_far.last()?;
        let members = bank_members(expectation).into_iter().map(|(dynamics, slowest, cost)| {
            let prior = ResponsePrior {
                onset: GaussianPrior { mean: detected.onset_s, sigma: detected.onset_sigma_s },
                dynamics,
                slowest,
                end: None,
            };
            let unit = prior.expected(0.0, 1.0);
            let settled_share = 1.0 - unit.remaining(latest.at_s - detected.onset_s);
            let step = (latest.value - detected.start) / settled_share.max(MIN_ELAPSED_SHARE);
            BankMember { cost, guess: prior.expected(detected.start, step), prior }
        });
        Some(Self {
            noise: ResponseNoise {
                sigma,
                model_share: expectation.model_share,
                error_duration_s: expectation.error_duration_s,
            },
            sigma_factor: expectation.sigma_factor,
            members: members.collect(),
        })
    }

    /// Fits each member to all samples so far, and weighs them by their likelihoods.
    fn prediction(&mut self, so_far: &[TimedSample]) -> Option<EndPrediction> {
        let latest = so_far.last()?;
        let fits: Vec<(f64, ResponseFit)> = self
            .members
            .iter_mut()
            .filter_map(|member| {
                let found = fit_response(so_far, &self.noise, &member.prior, &member.guess)?;
                member.guess = found.response.clone();
                // Laplace: the probability of the samples is that at the best fit times the volume around it.
                Some((member.cost + found.cost - found.half_ln_determinant()?, found))
            })
            .collect();
        let least = fits.iter().map(|(cost, _)| *cost).fold(f64::INFINITY, f64::min);
        let weights: Vec<f64> = fits.iter().map(|(cost, _)| (least - cost).exp()).collect();
        let sum: f64 = weights.iter().sum();
        let members = || weights.iter().zip(fits.iter().map(|(_, found)| found));
        let value = members().map(|(weight, found)| weight * found.response.final_value()).sum::<f64>() / sum;
        let variance = members()
            .map(|(weight, found)| {
                let off = found.response.final_value() - value;
                weight * (off * off + found.final_sigma().powi(2))
            })
            .sum::<f64>()
            / sum;
        let sigma = self.sigma_factor * variance.sqrt();
        (value.is_finite() && sigma.is_finite()).then_some(EndPrediction {
            at_s: latest.at_s,
            value,
            sigma,
            is_settling: true,
        })
    }
}

/// Dynamics, an additional prior of the slowest lag, and the negative logarithm of the prior weight.
type MemberSpec = (DynamicsPrior, Option<GaussianPrior>, f64);

/// The models of the bank: the dynamics of earlier runs, and others of their kind, with equal prior weights.
fn bank_members(expectation: &ExpectedDynamics) -> Vec<MemberSpec> {
    let same = expectation.same.iter();
    let same = same.map(|same| (same.clone(), None, same.half_ln_determinant()));
    same.chain(quadrature_nodes(&expectation.dynamics)).collect()
}

/// Values of the slowest lag that represent a kind: Gaussians as wide as their spacing, which together are flat.
fn quadrature_nodes(dynamics: &DynamicsPrior) -> Vec<MemberSpec> {
    let (slowest, ln_determinant) = (dynamics.slowest(), dynamics.half_ln_determinant());
    if slowest.sigma < ONE_NODE_BELOW {
        return vec![(dynamics.clone(), None, ln_determinant)];
    }
    let sigma = NODE_DISTANCE * slowest.sigma;
    // A Gaussian's density times the distance of two.
    let cost = ln_determinant + 0.5 * std::f64::consts::TAU.ln();
    let node = |k| GaussianPrior { mean: slowest.mean + sigma * f64::from(k), sigma };
    (-NODES..=NODES).map(|k| (dynamics.clone(), Some(node(k)), cost)).collect()
}

/// Nodes on each side of the expected lag, and their spacing in prior sigmas.
const NODES: i32 = 4;
const NODE_DISTANCE: f64 = 0.7;
/// A lag known better than to a thousandth needs no bank.
const ONE_NODE_BELOW: f64 = 1e-3;

/// Minimum elapsed share of the step in a first guess.
const MIN_ELAPSED_SHARE: f64 = 0.02;

/// Accuracy of the predictions of a run, from the onset until the sensor is within 2 % of the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictionScore {
    /// Mean over time of the absolute error as a share of the step, each limited to one.
    pub mean_error: f64,
    /// Number of sigmas that contain [`BOUND_RATE`] of the errors, relative to [`BOUND_SIGMAS`]; 1 for consistent bounds.
    pub bound_factor: f64,
}

impl Default for PredictionScore {
    fn default() -> Self {
        Self { mean_error: 1.0, bound_factor: 0.0 }
    }
}

/// Scores predictions by the final value of the run; `None` if there is none before settling.
pub fn score_predictions(predictions: &[EndPrediction], run: &IdentifiedStep) -> Option<PredictionScore> {
    let response = run.response();
    let step = (run.end - response.start).abs();
    let is_outside = |sample: &&TimedSample| (sample.value - run.end).abs() > SETTLED_SHARE * step;
    let until_s = run.samples.iter().rfind(is_outside)?.at_s;
    let in_time = predictions.windows(2).filter(|pair| pair[1].at_s > response.onset_s && pair[1].at_s <= until_s);
    let (mut all_s, mut miss_s) = (0.0, 0.0);
    let mut in_sigmas = Vec::new();
    for pair in in_time {
        let (off, lasts_s) = ((pair[1].value - run.end).abs(), pair[1].at_s - pair[0].at_s);
        all_s += lasts_s;
        miss_s += lasts_s * (off / step).min(1.0);
        if pair[1].is_settling {
            in_sigmas.push(off / pair[1].sigma);
        }
    }
    let score = PredictionScore {
        mean_error: miss_s / all_s,
        bound_factor: quantile(&in_sigmas, BOUND_RATE).unwrap_or(0.0) / BOUND_SIGMAS,
    };
    score.mean_error.is_finite().then_some(score)
}

/// Share of the step within which a sensor counts as settled.
const SETTLED_SHARE: f64 = 0.02;
