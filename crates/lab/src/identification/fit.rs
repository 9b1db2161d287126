//! The parameters of a step response by weighted least squares, with what is known beforehand as a prior.
//!
//! The same fit identifies a sensor (much data, hardly a prior) and predicts its final value while it is on its way (little data, and a
//! prior from other runs). With a narrow prior it is block least squares for known dynamics, with a wide one the adaptive case.
//!
//! # Model
//! ```text
//! p = [y_0, D, t_0, ln tau_1 .. ln tau_n, s_1 .. s_(n-1)]        s_n = 1 - the others
//! minimise   sum over k of nu_k^2 / (2 S_k)  +  (t_0 - m_t)^2 / (2 q_t^2)  +  rho(d)  +  (y_0 + D - u)^2 / (2 q_u^2)    (3)
//! y_k - y(t_k; p) = n_k + D r(t_k - t_0) g_k                                                                            (4)
//!     n white, sigma        g(t_0) = 0, dg = -g/T dt + white: within delta of 0, where an error holds for T
//!     nu_k, S_k: what a Kalman filter of the one state g makes of the errors (4), with their variances
//! rho(d) = a/2 ln(1 + d' S^-1 d / a)     d = [ln tau, s] - m     a = nu + rows of d       d' S^-1 d / 2 for nu = infinity   (5)
//! P = (sum of J' J / S + weights of the prior)^-1            var u = P_00 + 2 P_01 + P_11                               (6)
//! ```
//! (4) says what a model is worth: it errs by a share delta of what is left of the transient, not at once, and in errors that hold for
//! a time T. Many samples within T therefore say no more about the end than a few, while what is faster than T is seen in full, and so
//! is what the sensor shows once it has settled. [`super::model_error`] has the filter; the columns of J go through it as the errors do.
//! (5) is Student's t, scaled so that its peak is as sharp as the Gaussian's: what is far from what was expected is unlikely, but not
//! impossible. The last term of (3) is there where the end of the step is known.
//!
//! # Assumptions
//! The sensor rested before the step. Errors are Gaussian around the best fit (Laplace's approximation).
//!
//! # Sources
//! Gauss and Newton with the damping of Levenberg (1944) and Marquardt (1963); Lange, Little and Taylor (1989) for (5) by reweighting.

use nalgebra::{DMatrix, DVector};

pub use super::model_error::ResponseNoise;

use super::TimedSample;
use super::model_error::{WhiteningFilter, WhiteningStep, ln_spread, whitening_steps};
use super::prior::{MAX_ORDER, ResponsePrior, response_of, row};
use super::step_response::StepResponse;

/// A response with what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct ResponseFit {
    /// The best one.
    pub response: StepResponse,
    /// P of equation (6), in the order of p.
    pub covariance: DMatrix<f64>,
    /// The value of (3) there, and half the sum of ln (S / sigma^2): minus the logarithm of how likely the samples are.
    pub cost: f64,
}

impl ResponseFit {
    /// Standard deviation of what the sensor shows in the end, equation (6).
    pub fn final_sigma(&self) -> f64 {
        let p = &self.covariance;
        let variance = p[(0, 0)] + 2.0 * p[(0, 1)] + p[(1, 1)];
        variance.max(0.0).sqrt()
    }

    /// Half the logarithm of the determinant of P; `None` if P is not positive definite.
    pub fn half_ln_determinant(&self) -> Option<f64> {
        let factor = self.covariance.clone().cholesky()?;
        Some(factor.l().diagonal().map(f64::ln).sum())
    }

    /// Standard deviation of ln tau_j; infinite for a lag that is not there.
    pub fn ln_lag_sigma(&self, j: usize) -> f64 {
        self.sigma_of(row::LAGS + j, self.response.lags.len(), j)
    }

    /// Standard deviation of s_j; infinite for a lag that is not there. The last share has that of the sum of the others.
    pub fn share_sigma(&self, j: usize) -> f64 {
        let order = self.response.lags.len();
        let first = row::LAGS + order;
        if j + 1 < order {
            return self.sigma_of(first + j, order, j);
        }
        let free = order.saturating_sub(1);
        let of_sum: f64 = (0..free)
            .flat_map(|a| (0..free).map(move |b| (a, b)))
            .map(|(a, b)| self.covariance[(first + a, first + b)])
            .sum();
        of_sum.max(0.0).sqrt()
    }

    fn sigma_of(&self, index: usize, order: usize, j: usize) -> f64 {
        if j >= order {
            return f64::INFINITY;
        }
        self.covariance[(index, index)].max(0.0).sqrt()
    }
}

/// Finds the response of least (3) from a guess; `None` where the samples or the prior are no usable numbers.
///
/// The samples are in the order of time. The guess has as many lags as the prior.
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

/// How often S is computed anew.
const REWEIGHTINGS: usize = 2;
/// Steps of one descent; far more than a descent that goes well takes.
const MAX_ITERATIONS: usize = 60;
/// A descent ends when a step gains less than this share of the cost.
const CONVERGED_GAIN: f64 = 1e-9;
/// Damping at the start, and the largest: beyond it no step helps.
const FIRST_DAMPING: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e12;
/// D has no prior; this many times the noise stands for none, as in [`posebridge_estimator::filters::dynamic`].
const NO_PRIOR_SIGMAS: f64 = 1e5;
/// ln tau stays within e^-30 to e^30 seconds.
const LN_LAG_LIMIT: f64 = 30.0;

struct FitProblem<'a> {
    samples: &'a [TimedSample],
    /// The filter of (4) at each sample.
    whitened: &'a [WhiteningStep],
    noise: &'a ResponseNoise,
    prior: &'a ResponsePrior,
}

impl FitProblem<'_> {
    /// Levenberg's and Marquardt's descent; gives the place, the normal matrix and the cost.
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
        let order = self.prior.dynamics.order();
        let alone = [(row::ONSET, Some(self.prior.onset)), (row::LAGS + order - 1, self.prior.slowest)];
        for (i, belief) in alone {
            if let Some(belief) = belief {
                normal[(i, i)] += belief.weight();
                slope[i] += belief.weight() * (belief.mean - at[i]);
                cost += belief.cost(at[i]);
            }
        }
        let (rho, pull, weight) = self.prior.dynamics.cost_at(at);
        cost += rho;
        for i in 0..pull.len() {
            slope[row::LAGS + i] -= pull[i];
            for j in 0..pull.len() {
                normal[(row::LAGS + i, row::LAGS + j)] += weight * self.prior.dynamics.inverse()[(i, j)];
            }
        }
        let next_to_nothing = (NO_PRIOR_SIGMAS * self.noise.sigma).powi(-2);
        normal[(row::START, row::START)] += next_to_nothing;
        normal[(row::STEP, row::STEP)] += next_to_nothing;
        (normal, slope, cost)
    }
}

/// Parameters of a response of the highest order.
pub(super) const MAX_PARAMETERS: usize = row::LAGS + 2 * MAX_ORDER - 1;

/// The upper triangle of the normal equations, in place of a matrix for each sample.
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

/// What does not change from sample to sample.
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
            let gone = since_s * self.rates[j];
            e[j] = (-gone).exp();
            by[row::STEP] += self.shares[j] * (1.0 - e[j]);
            by[row::ONSET] -= self.step * self.shares[j] * self.rates[j] * e[j];
            by[row::LAGS + j] = -self.step * self.shares[j] * gone * e[j];
        }
        let last = e[self.order - 1];
        for j in 0..self.order - 1 {
            by[row::LAGS + self.order + j] = self.step * (last - e[j]);
        }
        (self.start + self.step * by[row::STEP], by)
    }
}

/// y(t) of a response and its derivatives by the parameters; `None` for an order that no response may have.
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
