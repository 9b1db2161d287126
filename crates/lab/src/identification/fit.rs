//! Fits the parameters of a step response by weighted least squares with a prior.
//!
//! With a narrow prior it is block least squares for known dynamics, with a wide one it identifies a sensor.
//!
//! # Model
//! ```text
//! p = [y_0, D, t_0, ln tau_1 .. ln tau_n, s_1 .. s_(n-1)]        s_n = 1 - the others
//! minimise   sum over k of nu_k^2 / (2 S_k)  +  (t_0 - m_t)^2 / (2 q_t^2)  +  rho(d)  +  (y_0 + D - u)^2 / (2 q_u^2)    (3)
//! y_k - y(t_k; p) = n_k + D r(t_k - t_0) g_k                                                                            (4)
//!     n white, sigma        g(t_0) = 0, dg = -g/T dt + white: within delta of 0, where an error holds for T
//!     nu_k, S_k: what a Kalman filter of the one state g makes of the errors (4), with their variances
//! rho(d) = d' S^-1 d / 2     d = [ln tau, s] - m                                                                       (5)
//! P = (sum of J' J / S + weights of the prior)^-1            var u = P_00 + 2 P_01 + P_11                               (6)
//! ```
//! (4) models the error of the response model: a share delta of the remaining transient, not at once, with a correlation time T. Many
//! samples within T therefore carry no more information about the end than a few, while faster effects are fully observed, and so is
//! the settled value. The filter is the private `WhiteningFilter`; it whitens the columns of J like the errors.
//! The last term of (3) exists where the end of the step is known.
//!
//! # Assumptions
//! The sensor rested before the step. Errors are Gaussian around the best fit (Laplace's approximation).
//!
//! # Sources
//! Gauss and Newton with the damping of Levenberg (1944) and Marquardt (1963).

use nalgebra::{DMatrix, DVector};

use super::TimedSample;
use super::prior::{MAX_ORDER, ResponsePrior, response_of, row};
use super::step_response::StepResponse;

#[derive(Clone, Debug, PartialEq)]
pub struct ResponseFit {
    pub response: StepResponse,
    /// P of equation (6), in the order of p.
    pub covariance: DMatrix<f64>,
    /// The minimum of (3) plus half the sum of ln (S / sigma^2): the negative log-likelihood of the samples.
    pub cost: f64,
}

impl ResponseFit {
    /// Infinite for a lag that does not exist.
    pub fn ln_lag_sigma(&self, j: usize) -> f64 {
        if j >= self.response.lags.len() {
            return f64::INFINITY;
        }
        sigma_along(&self.covariance, &[(row::LAGS + j, 1.0)])
    }

    /// The last share has the sigma of the sum of the others.
    pub fn share_sigma(&self, j: usize) -> f64 {
        sigma_along(&self.covariance, &share_slopes(j, self.response.lags.len()))
    }
}

/// Derivatives of s_j by the free shares; the last share is the rest to one.
pub(super) fn share_slopes(j: usize, order: usize) -> Vec<(usize, f64)> {
    let first = row::LAGS + order;
    if j + 1 < order {
        return vec![(first + j, 1.0)];
    }
    (0..order.saturating_sub(1)).map(|free| (first + free, -1.0)).collect()
}

/// The sigma of a function with these slopes by the rows of p.
pub(super) fn sigma_along(covariance: &DMatrix<f64>, slopes: &[(usize, f64)]) -> f64 {
    let pairs = slopes.iter().flat_map(|(i, by_i)| slopes.iter().map(move |(j, by_j)| (*i, *j, by_i * by_j)));
    let variance: f64 = pairs.filter_map(|(i, j, weight)| Some(weight * covariance.get((i, j))?)).sum();
    variance.max(0.0).sqrt()
}

/// Minimises (3) from a guess; `None` where samples or prior are invalid.
///
/// Samples must be in time order. The guess has as many lags as the prior.
pub fn fit_response(
    samples: &[TimedSample],
    noise: &ResponseNoise,
    prior: &ResponsePrior,
    guess: &StepResponse,
) -> Option<ResponseFit> {
    let order = prior.dynamics.order();
    if guess.lags.len() != order || noise.sigma.is_nan() || noise.sigma <= 0.0 {
        return None;
    }
    let mut at = parameters_of(guess);
    let mut found = None;
    // What is left of the transient, and with it S, follows from the response before.
    for _ in 0..REWEIGHTINGS {
        let whitened = whitening_steps(samples, &response_from(&at, order), noise);
        let problem = FitProblem { samples, whitened: &whitened, noise, prior };
        let (better, normal, cost) = problem.minimize(at)?;
        at = better;
        found = Some((normal, cost + 0.5 * ln_spread(&whitened)));
    }
    let (normal, cost) = found?;
    Some(ResponseFit { response: response_from(&at, order), covariance: normal.cholesky()?.inverse(), cost })
}

const REWEIGHTINGS: usize = 2;
/// Iterations of one descent; far more than a normal one takes.
const MAX_ITERATIONS: usize = 60;
/// A descent ends when a step gains less than this share of the cost.
const CONVERGED_GAIN: f64 = 1e-9;
/// Initial and largest damping: beyond it no step helps.
const FIRST_DAMPING: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e12;
/// Prior of D in units of the noise, wide enough for none, as in [`posebridge_estimator::filters::dynamic`].
const NO_PRIOR_SIGMAS: f64 = 1e5;
/// ln tau stays within e^-30 to e^30 seconds.
const LN_LAG_LIMIT: f64 = 30.0;

struct FitProblem<'a> {
    samples: &'a [TimedSample],
    whitened: &'a [WhiteningStep],
    noise: &'a ResponseNoise,
    prior: &'a ResponsePrior,
}

impl FitProblem<'_> {
    /// Levenberg-Marquardt descent; returns the minimum, the normal matrix and the cost.
    fn minimize(&self, mut at: DVector<f64>) -> Option<(DVector<f64>, DMatrix<f64>, f64)> {
        let (mut normal, mut slope, mut cost) = self.normal_equations(&at);
        let mut damping = FIRST_DAMPING;
        for _ in 0..MAX_ITERATIONS {
            if !cost.is_finite() {
                return None;
            }
            let mut damped = normal.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] *= 1.0 + damping;
            }
            let step = damped.cholesky()?.solve(&slope);
            let there = &at + step;
            let next = self.normal_equations(&there);
            if next.2 < cost && self.is_feasible(&there) {
                let gain = cost - next.2;
                (normal, slope, cost) = next;
                at = there;
                damping = (damping * 0.2).max(1e-12);
                if gain <= CONVERGED_GAIN * (1.0 + cost) {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > MAX_DAMPING {
                    break;
                }
            }
        }
        Some((at, normal, cost))
    }

    fn is_feasible(&self, at: &DVector<f64>) -> bool {
        let order = self.prior.dynamics.order();
        let ln_lags = at.rows(row::LAGS, order);
        ln_lags.iter().all(|ln_lag| ln_lag.abs() < LN_LAG_LIMIT)
    }

    /// Sum of J'J/S, of J'nu/S, and the cost (3).
    fn normal_equations(&self, at: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>, f64) {
        let count = self.prior.parameters();
        let mut sums = NormalSums::default();
        let constants = ResponseParameters::from_vector(at, self.prior.dynamics.order());
        let mut columns = WhiteningFilter::new();
        for (sample, white) in self.samples.iter().zip(self.whitened) {
            let (value, by) = constants.value_and_slopes(sample.at_s);
            let (error, by) = columns.innovations(white, sample.value - value, by);
            sums.add(count, &by, error, white.weight);
        }
        if let Some(end) = self.prior.end {
            let mut by = [0.0; MAX_PARAMETERS];
            by[row::START] = 1.0;
            by[row::STEP] = 1.0;
            let error = end.mean - at[row::START] - at[row::STEP];
            sums.add(count, &by, error, end.weight());
        }
        let (mut normal, mut slope, mut cost) = sums.to_matrices(count);
        let onset = self.prior.onset;
        normal[(row::ONSET, row::ONSET)] += onset.weight();
        slope[row::ONSET] += onset.weight() * (onset.mean - at[row::ONSET]);
        cost += onset.cost(at[row::ONSET]);
        let (rho, pull) = self.prior.dynamics.cost_at(at);
        cost += rho;
        for i in 0..pull.len() {
            slope[row::LAGS + i] -= pull[i];
            for j in 0..pull.len() {
                normal[(row::LAGS + i, row::LAGS + j)] += self.prior.dynamics.inverse()[(i, j)];
            }
        }
        let next_to_nothing = (NO_PRIOR_SIGMAS * self.noise.sigma).powi(-2);
        normal[(row::START, row::START)] += next_to_nothing;
        normal[(row::STEP, row::STEP)] += next_to_nothing;
        (normal, slope, cost)
    }
}

/// Of a response of the highest order.
pub(super) const MAX_PARAMETERS: usize = row::LAGS + 2 * MAX_ORDER - 1;

/// The upper triangle of the normal equations, without a matrix for each sample.
#[derive(Default)]
struct NormalSums {
    normal: [[f64; MAX_PARAMETERS]; MAX_PARAMETERS],
    slope: [f64; MAX_PARAMETERS],
    cost: f64,
}

impl NormalSums {
    fn add(&mut self, count: usize, by: &[f64; MAX_PARAMETERS], error: f64, weight: f64) {
        for i in 0..count {
            let weighted = weight * by[i];
            self.slope[i] += weighted * error;
            let entries = self.normal[i].iter_mut().zip(by).take(count).skip(i);
            for (entry, other) in entries {
                *entry += weighted * other;
            }
        }
        self.cost += 0.5 * weight * error * error;
    }

    fn to_matrices(&self, count: usize) -> (DMatrix<f64>, DVector<f64>, f64) {
        let of = |i: usize, j: usize| self.normal[i.min(j)][i.max(j)];
        (DMatrix::from_fn(count, count, of), DVector::from_fn(count, |i, _| self.slope[i]), self.cost)
    }
}

struct ResponseParameters {
    order: usize,
    start: f64,
    step: f64,
    onset_s: f64,
    rates: [f64; MAX_ORDER],
    shares: [f64; MAX_ORDER],
}

impl ResponseParameters {
    fn from_vector(at: &DVector<f64>, order: usize) -> Self {
        let mut rates = [0.0; MAX_ORDER];
        let mut shares = [0.0; MAX_ORDER];
        let mut rest = 1.0;
        for j in 0..order {
            rates[j] = (-at[row::LAGS + j]).exp();
            shares[j] = if j + 1 < order { at[row::LAGS + order + j] } else { rest };
            rest -= shares[j];
        }
        Self { order, start: at[row::START], step: at[row::STEP], onset_s: at[row::ONSET], rates, shares }
    }

    /// y(t) and its derivatives by the parameters.
    fn value_and_slopes(&self, at_s: f64) -> (f64, [f64; MAX_PARAMETERS]) {
        let mut by = [0.0; MAX_PARAMETERS];
        by[row::START] = 1.0;
        let since_s = at_s - self.onset_s;
        if since_s <= 0.0 {
            return (self.start, by);
        }
        let mut e = [0.0; MAX_ORDER];
        for j in 0..self.order {
            let elapsed = since_s * self.rates[j];
            e[j] = (-elapsed).exp();
            by[row::STEP] += self.shares[j] * (1.0 - e[j]);
            by[row::ONSET] -= self.step * self.shares[j] * self.rates[j] * e[j];
            by[row::LAGS + j] = -self.step * self.shares[j] * elapsed * e[j];
        }
        let last = e[self.order - 1];
        for j in 0..self.order - 1 {
            by[row::LAGS + self.order + j] = self.step * (last - e[j]);
        }
        (self.start + self.step * by[row::STEP], by)
    }
}

/// y(t) of a response and its derivatives by the parameters; `None` for an invalid order.
pub(super) fn value_and_slopes(response: &StepResponse, at_s: f64) -> Option<(f64, [f64; MAX_PARAMETERS])> {
    let order = response.lags.len();
    let is_possible = (1..=MAX_ORDER).contains(&order);
    is_possible.then(|| ResponseParameters::from_vector(&parameters_of(response), order).value_and_slopes(at_s))
}

fn parameters_of(response: &StepResponse) -> DVector<f64> {
    let ln_lags = response.lags.iter().map(|lag| lag.time_constant_s.ln());
    let free = response.lags.len().saturating_sub(1);
    let shares = response.lags.iter().take(free).map(|lag| lag.share);
    let first = [response.start, response.step, response.onset_s];
    let all: Vec<f64> = first.into_iter().chain(ln_lags).chain(shares).collect();
    DVector::from_vec(all)
}

fn response_from(at: &DVector<f64>, order: usize) -> StepResponse {
    let first = [at[row::START], at[row::STEP], at[row::ONSET]];
    let rest = at.iter().copied().skip(row::LAGS);
    response_of(&first, rest.clone().take(order), rest.skip(order))
}

// What a model of a sensor is worth: noise of the samples, and errors of the model that hold for a while.
//
// No sensor is quite a sum of a few exponentials. What such a model leaves is not white: it holds from sample to sample, so that a
// hundred samples within a second say hardly more about the end than ten. To count the errors as larger white noise is the other mistake:
// it hides what changes quickly, the fast lag and the onset, which errors that hold cannot imitate.
//
// # Model
// Equation (4) of [`super::fit`], a Kalman filter of one state g for given l_k = D r(t_k - t_0):
// ```text
// e_k = n_k + l_k g_k         n white, sigma
// g(t_0) = 0                  f_k = e^(-(t_k - t_(k-1)) / T)     g_k = f_k g_(k-1) + w_k      var w_k = delta^2 (1 - f_k^2)
// covariance of two errors    delta^2 l_i l_j (e^(-|t_i - t_j| / T) - e^(-(t_i + t_j - 2 t_0) / T))
// ```
// g begins at nothing, because a model that knows where the sensor was is right at the onset.
//
// # Sources
// Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, section 3.4: generalised least squares by passing errors
// and the columns of J through the same filter.

/// Deviations of samples from the model, equation (4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseNoise {
    /// White noise of a sample in the sensor's unit; positive.
    pub sigma: f64,
    /// delta: relative error of the model in the remaining transient.
    pub model_share: f64,
    /// T: correlation time of the model error; not negative.
    pub error_duration_s: f64,
}

impl ResponseNoise {
    pub const fn white(sigma: f64) -> Self {
        Self { sigma, model_share: 0.0, error_duration_s: 0.0 }
    }
}

/// The filter at one sample; its variances do not depend on the filtered data.
pub(super) struct WhiteningStep {
    /// l_k.
    remaining: f64,
    /// f_k.
    retention: f64,
    gain: f64,
    /// 1 / S_k.
    pub(super) weight: f64,
    /// ln (S_k / sigma^2).
    ln_spread: f64,
}

/// The filter at each sample for this response; samples in time order.
pub(super) fn whitening_steps(
    samples: &[TimedSample],
    response: &StepResponse,
    noise: &ResponseNoise,
) -> Vec<WhiteningStep> {
    let white = noise.sigma * noise.sigma;
    let mut variance = 0.0;
    let mut last_s = response.onset_s;
    let of = |sample: &TimedSample| {
        let since_s = sample.at_s - response.onset_s;
        // Before the onset there is no transient that a model could get wrong.
        if since_s <= 0.0 || noise.model_share <= 0.0 {
            return WhiteningStep { remaining: 0.0, retention: 0.0, gain: 0.0, weight: 1.0 / white, ln_spread: 0.0 };
        }
        let left = response.step * response.remaining(since_s);
        let kept = (-(sample.at_s - last_s) / noise.error_duration_s).exp();
        last_s = sample.at_s;
        variance = kept * kept * variance + noise.model_share.powi(2) * (1.0 - kept * kept);
        let spread = white + left * left * variance;
        let gain = variance * left / spread;
        variance *= white / spread;
        WhiteningStep { remaining: left, retention: kept, gain, weight: 1.0 / spread, ln_spread: (spread / white).ln() }
    };
    samples.iter().map(of).collect()
}

/// Log-determinant of the errors' covariance, relative to white noise.
pub(super) fn ln_spread(whitened: &[WhiteningStep]) -> f64 {
    whitened.iter().map(|white| white.ln_spread).sum()
}

/// The filter's estimates of g, from the errors and from each of N columns of J.
pub(super) struct WhiteningFilter<const N: usize> {
    error_state: f64,
    jacobian_state: [f64; N],
}

impl<const N: usize> WhiteningFilter<N> {
    pub(super) const fn new() -> Self {
        Self { error_state: 0.0, jacobian_state: [0.0; N] }
    }

    /// Innovations of a sample's error and of its slopes.
    pub(super) fn innovations(&mut self, white: &WhiteningStep, error: f64, mut by: [f64; N]) -> (f64, [f64; N]) {
        let next = |estimate: &mut f64, shown: f64| {
            *estimate *= white.retention;
            let new = shown - white.remaining * *estimate;
            *estimate += white.gain * new;
            new
        };
        for (estimate, slope) in self.jacobian_state.iter_mut().zip(&mut by) {
            *slope = next(estimate, *slope);
        }
        (next(&mut self.error_state, error), by)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identification::step_response::Lag;

    const NOISE: ResponseNoise = ResponseNoise { sigma: 0.3, model_share: 0.1, error_duration_s: 2.0 };

    fn response() -> StepResponse {
        StepResponse { start: 20.0, step: -16.0, onset_s: 1.2, lags: vec![Lag { time_constant_s: 3.0, share: 1.0 }] }
    }

    fn samples() -> Vec<TimedSample> {
        let at = |k: i32| TimedSample {
            at_s: 0.4 * f64::from(k) + 0.03 * f64::from(k % 3),
            value: 20.0 + f64::from(k * k % 7),
        };
        (0..30).map(at).collect()
    }

    /// The covariance of the errors as the module's text has it, written out in full.
    fn covariance() -> DMatrix<f64> {
        let (samples, response) = (samples(), response());
        let left_and_age = |k: usize| {
            let age_s = (samples[k].at_s - response.onset_s).max(0.0);
            (-16.0 * (-age_s / 3.0).exp(), age_s)
        };
        DMatrix::from_fn(samples.len(), samples.len(), |i, j| {
            let ((l, a), (m, b)) = (left_and_age(i), left_and_age(j));
            let held = (-(a - b).abs() / 2.0).exp() - (-(a + b) / 2.0).exp();
            let white = if i == j { 0.09 } else { 0.0 };
            white + 0.01 * l * m * held
        })
    }

    #[test]
    fn innovations_weigh_as_the_inverse_of_the_whole_covariance() {
        let (samples, whole) = (samples(), covariance().cholesky().unwrap());
        let errors = DVector::from_iterator(30, samples.iter().map(|s| s.value - 22.0));
        let slopes = DVector::from_fn(30, |k, _| (0.3 * k as f64).sin());
        let filtered = whitening_steps(&samples, &response(), &NOISE);
        let mut columns = WhiteningFilter::<1>::new();
        let (mut squares, mut products) = (0.0, 0.0);
        for (k, white) in filtered.iter().enumerate() {
            let (new, [by]) = columns.innovations(white, errors[k], [slopes[k]]);
            squares += white.weight * new * new;
            products += white.weight * new * by;
        }
        let solved = whole.solve(&errors);
        assert!((squares / errors.dot(&solved) - 1.0).abs() < 1e-9);
        assert!((products - slopes.dot(&solved)).abs() < 1e-9 * squares);
        let ln_determinant = whole.ln_determinant() - 30.0 * 0.09_f64.ln();
        assert!((ln_spread(&filtered) - ln_determinant).abs() < 1e-9);
    }

    #[test]
    fn without_fault_of_the_model_the_noise_is_white() {
        let white = ResponseNoise::white(0.5);
        for one in whitening_steps(&samples(), &response(), &white) {
            assert_eq!((one.weight, one.ln_spread, one.gain), (4.0, 0.0, 0.0));
        }
    }
}
