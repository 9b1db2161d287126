//! Identifies gain, delay, lags and order of a sensor from the samples of one step.
//!
//! # Method
//! ```text
//! find the step (onset.rs); fit 1, 2 and 3 exponentials to it (fit.rs) with a prior that says next to nothing
//! order    least  m ln(e'e / N) + k ln m        m = N / c independent residuals, k parameters            (7)
//! delta    from neighbours: white noise has no covariance with the next sample, a wrong model has
//!          delta^2 = mean(e_k e_(k+1)) / mean((D r_k)^2)        c = 1 + 2 sum over i of rho_i            (8)
//!          T = c / 2 times the distance of samples: what correlations of e^(-t / T) add up to
//! ```
//! A second fit with delta and T gives the sigmas: a fit that treats the residuals of a wrong model as white noise underestimates them.
//!
//! # Sources
//! Schwarz (1978), (7); docs/lab/thermometer.md section 3.

use super::fit::{ResponseFit, ResponseNoise, fit_response};
use super::onset::{StepSegment, find_step};
use super::prior::{DynamicsPrior, GaussianPrior, MAX_ORDER, ResponsePrior};
use super::step_response::{Lag, StepResponse};
use super::{TimedSample, sorted_finite};
use crate::statistics::ResidualCorrelation;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepOptions {
    /// Noise of a sample, standard deviation in the sensor's unit; for a sensor that rounds, at least its resolution over the root of
    /// 12.
    pub sigma: f64,
    /// Number of exponentials, 1 to [`MAX_ORDER`]; selected by equation (7) if `None`.
    pub order: Option<usize>,
    /// Time of the quantity's step, by the sensor's clock; without it the delay is not observable.
    pub onset_s: Option<f64>,
    /// Step of the quantity, in its own unit; without it the gain is not observable.
    pub input_step: Option<f64>,
    pub end: Option<f64>,
}

impl StepOptions {
    pub const fn with_sigma(sigma: f64) -> Self {
        Self { sigma, order: None, onset_s: None, input_step: None, end: None }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdentifiedLag {
    /// tau.
    pub time_constant_s: f64,
    pub time_constant_sigma_s: f64,
    pub share: f64,
    pub share_sigma: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct CandidateModel {
    pub fit: ResponseFit,
    /// Of the residuals, in the sensor's unit.
    pub residual_rms: f64,
    /// delta of equation (8).
    pub model_share: f64,
    /// T of equation (8): correlation time of the model error; 0 if no such error was found.
    pub error_duration_s: f64,
    /// The criterion (7); the smallest is best.
    pub criterion: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct IdentifiedStep {
    pub samples: Vec<TimedSample>,
    /// From the step of the quantity to the onset of the sensor, if the former was given.
    pub delay_s: Option<f64>,
    /// Final value: as given, else the mean of the last tenth of the samples.
    pub end: f64,
    /// Noise of a sample in the fit, in the sensor's unit.
    pub sigma: f64,
    pub candidates: Vec<CandidateModel>,
    chosen: usize,
}

impl IdentifiedStep {
    pub fn chosen(&self) -> &CandidateModel {
        &self.candidates[self.chosen]
    }

    /// `None` if it was not tried or did not converge.
    pub fn of_order(&self, order: usize) -> Option<&CandidateModel> {
        let mut all = self.candidates.iter();
        all.find(|candidate| candidate.fit.response.lags.len() == order)
    }

    pub fn order(&self) -> usize {
        self.response().lags.len()
    }

    pub fn response(&self) -> &StepResponse {
        &self.chosen().fit.response
    }

    /// Whether each share differs from zero, one-sided at a level of 5 %.
    pub fn is_resolved(candidate: &CandidateModel) -> bool {
        let fit = &candidate.fit;
        let mut lags = fit.response.lags.iter().enumerate();
        lags.all(|(j, lag)| lag.share.abs() > ONE_SIDED_SIGMAS * fit.share_sigma(j))
    }

    pub fn lags(&self) -> Vec<IdentifiedLag> {
        let fit = &self.chosen().fit;
        let of = |(j, lag): (usize, &Lag)| IdentifiedLag {
            time_constant_s: lag.time_constant_s,
            time_constant_sigma_s: lag.time_constant_s * fit.ln_lag_sigma(j),
            share: lag.share,
            share_sigma: fit.share_sigma(j),
        };
        fit.response.lags.iter().enumerate().map(of).collect()
    }
}

/// 95 % quantile of the normal distribution.
const ONE_SIDED_SIGMAS: f64 = 1.644_854;

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum IdentificationError {
    #[error("a noise of {sigma} is not positive and finite")]
    Sigma { sigma: f64 },
    #[error("an order of {order} is not 1 to {MAX_ORDER}")]
    Order { order: usize },
    #[error("{what} of {value} is not finite, or zero")]
    InvalidOption { what: &'static str, value: f64 },
    #[error("no step: of {samples} usable samples no part moves by more than the noise of {sigma} explains")]
    NoStep { samples: usize, sigma: f64 },
    #[error("{samples} samples after the onset are too few for an order of {order}")]
    TooFew { samples: usize, order: usize },
}

/// Identifies a sensor from a recording that contains a step.
///
/// Samples that are not finite or not later than the previous one are ignored.
pub fn identify_step(samples: &[TimedSample], options: &StepOptions) -> Result<IdentifiedStep, IdentificationError> {
    validate_options(options)?;
    let no_step = || IdentificationError::NoStep { samples: sorted_finite(samples).len(), sigma: options.sigma };
    let found = find_step(samples, options.sigma).ok_or_else(no_step)?;
    let orders = match options.order {
        None => 1..=MAX_ORDER,
        Some(order) => order..=order,
    };
    let work = StepFitter::new(&found, options);
    let mut candidates: Vec<CandidateModel> = orders.clone().filter_map(|order| work.candidate(order)).collect();
    work.score_candidates(&mut candidates);
    let best = candidates
        .iter()
        .enumerate()
        .filter(|(index, candidate)| *index == 0 || IdentifiedStep::is_resolved(candidate))
        .min_by(|(_, a), (_, b)| a.criterion.total_cmp(&b.criterion));
    let Some((chosen, best)) = best else {
        return Err(IdentificationError::TooFew { samples: work.samples_after_onset, order: *orders.start() });
    };
    let response = &best.fit.response;
    Ok(IdentifiedStep {
        delay_s: options.onset_s.map(|onset_s| response.onset_s - onset_s),
        end: options.end.unwrap_or(found.end),
        sigma: work.sigma,
        samples: found.samples,
        chosen,
        candidates,
    })
}

fn validate_options(options: &StepOptions) -> Result<(), IdentificationError> {
    let sigma = options.sigma;
    if !(sigma > 0.0 && sigma.is_finite()) {
        return Err(IdentificationError::Sigma { sigma });
    }
    if let Some(order) = options.order
        && !(1..=MAX_ORDER).contains(&order)
    {
        return Err(IdentificationError::Order { order });
    }
    let settings = [
        ("an onset", options.onset_s, true),
        ("a step of the quantity", options.input_step, false),
        ("an end", options.end, true),
    ];
    for (what, value, may_be_zero) in settings {
        if let Some(value) = value
            && !(value.is_finite() && (may_be_zero || value != 0.0))
        {
            return Err(IdentificationError::InvalidOption { what, value });
        }
    }
    Ok(())
}

/// Weak prior: shares are about equal, and lags lie within two decades of each other.
const WEAK_SHARE_SIGMA: f64 = 0.5;
const WEAK_LN_LAG_SIGMA: f64 = 1.5;
/// Weak prior: the onset is known to a few hundredths of the step's duration.
const WEAK_ONSET_SHARE: f64 = 0.03;
/// Start values of the lags as shares of the duration: close and distant ones for each order.
const FIRST_LAGS: [[&[f64]; 2]; MAX_ORDER] =
    [[&[0.12], &[0.3]], [&[0.04, 0.14], &[0.01, 0.15]], [&[0.02, 0.06, 0.16], &[0.005, 0.04, 0.15]]];
/// Lower bound of the end's uncertainty, as a share of the step.
const END_SHARE: f64 = 0.002;

struct StepFitter<'a> {
    segment: &'a StepSegment,
    sigma: f64,
    samples_after_onset: usize,
    duration_s: f64,
    interval_s: f64,
    end: Option<GaussianPrior>,
}

impl<'a> StepFitter<'a> {
    fn new(segment: &'a StepSegment, options: &StepOptions) -> Self {
        let is_moving = |sample: &&TimedSample| sample.at_s > segment.onset_s;
        let samples_after_onset = segment.samples.iter().filter(is_moving).count();
        let last_s = segment.samples.last().map_or(0.0, |sample| sample.at_s);
        let duration_s = last_s - segment.onset_s;
        let step = (segment.end - segment.start).abs();
        let known = |mean| GaussianPrior { mean, sigma: (END_SHARE * step).max(1e-12) };
        Self {
            segment,
            sigma: options.sigma,
            samples_after_onset,
            duration_s,
            interval_s: duration_s / (samples_after_onset.max(1) as f64),
            end: options.end.map(known),
        }
    }

    /// The best response of an order; `None` for fewer samples than parameters.
    fn candidate(&self, order: usize) -> Option<CandidateModel> {
        if self.samples_after_onset <= 3 + 2 * order {
            return None;
        }
        let starts = FIRST_LAGS.get(order - 1)?;
        let fits = starts.iter().filter_map(|shares| self.fit_from(shares));
        let best = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        let residuals = self.residuals(&best.response);
        let (model_share, held_s) = self.model_error(&best.response, &residuals);
        let noise = ResponseNoise { sigma: self.sigma, model_share, error_duration_s: held_s };
        let prior = self.weak_prior(starts[0])?;
        let refitted = fit_response(&self.segment.samples, &noise, &prior, &best.response).unwrap_or(best);
        let squares: f64 = residuals.iter().map(|e| e * e).sum();
        Some(CandidateModel {
            residual_rms: (squares / residuals.len() as f64).sqrt(),
            fit: refitted,
            model_share,
            error_duration_s: held_s,
            criterion: f64::INFINITY,
        })
    }

    fn fit_from(&self, shares_of_duration: &[f64]) -> Option<ResponseFit> {
        let prior = self.weak_prior(shares_of_duration)?;
        let guess = prior.expected(self.segment.start, self.segment.end - self.segment.start);
        let noise = ResponseNoise::white(self.sigma);
        let mut found = fit_response(&self.segment.samples, &noise, &prior, &guess)?;
        let mut sorted = found.response.clone();
        sorted.lags.sort_by(|a, b| a.time_constant_s.total_cmp(&b.time_constant_s));
        if sorted != found.response {
            found = fit_response(&self.segment.samples, &noise, &prior, &sorted)?;
        }
        Some(found)
    }

    fn weak_prior(&self, shares_of_duration: &[f64]) -> Option<ResponsePrior> {
        let order = shares_of_duration.len();
        let ln_lag = |share: &f64| GaussianPrior { mean: (share * self.duration_s).ln(), sigma: WEAK_LN_LAG_SIGMA };
        let ln_lags: Vec<GaussianPrior> = shares_of_duration.iter().map(ln_lag).collect();
        let share = GaussianPrior { mean: 1.0 / order as f64, sigma: WEAK_SHARE_SIGMA };
        Some(ResponsePrior {
            onset: GaussianPrior {
                mean: self.segment.onset_s,
                sigma: (WEAK_ONSET_SHARE * self.duration_s).max(2.0 * self.interval_s),
            },
            dynamics: DynamicsPrior::independent(&ln_lags, &vec![share; order - 1])?,
            end: self.end,
        })
    }

    fn residuals(&self, response: &StepResponse) -> Vec<f64> {
        let moving = self.segment.samples.iter();
        let moving = moving.filter(|sample| sample.at_s > self.segment.onset_s);
        moving.map(|sample| sample.value - response.value_at(sample.at_s)).collect()
    }

    /// delta and T in seconds, equation (8).
    fn model_error(&self, response: &StepResponse, residuals: &[f64]) -> (f64, f64) {
        let left = self.segment.samples.iter().filter_map(|sample| {
            let since_s = sample.at_s - self.segment.onset_s;
            (since_s > 0.0).then(|| (response.step * response.remaining(since_s)).powi(2))
        });
        let mean_left = left.sum::<f64>() / residuals.len().max(1) as f64;
        let held = ResidualCorrelation::from_residuals(residuals);
        if held.model_variance <= 0.0 || mean_left <= 0.0 {
            return (0.0, 0.0);
        }
        let held_s = 0.5 * held.model_samples * self.interval_s;
        ((held.model_variance / mean_left).sqrt(), held_s)
    }

    /// Computes the criterion (7) of each candidate, with the number of independent residuals of the best one.
    fn score_candidates(&self, candidates: &mut [CandidateModel]) {
        let held = candidates
            .iter()
            .map(|candidate| {
                ResidualCorrelation::from_residuals(&self.residuals(&candidate.fit.response)).samples_per_residual
            })
            .fold(f64::INFINITY, f64::min);
        let independent = self.samples_after_onset as f64 / held.max(1.0);
        for candidate in candidates {
            let parameters = 2.0 + 2.0 * candidate.fit.response.lags.len() as f64;
            // Residuals are not distinguished below a tenth of the noise.
            let rms = candidate.residual_rms.max(0.1 * self.sigma);
            candidate.criterion = 2.0 * independent * rms.ln() + parameters * independent.ln();
        }
    }
}
