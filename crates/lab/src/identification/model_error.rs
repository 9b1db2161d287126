//! What a model of a sensor is worth: noise of the samples, and errors of the model that hold for a while.
//!
//! No sensor is quite a sum of a few exponentials. What such a model leaves is not white: it holds from sample to sample, so that a
//! hundred samples within a second say hardly more about the end than ten. To count the errors as larger white noise is the other mistake:
//! it hides what changes quickly, the fast lag and the onset, which errors that hold cannot imitate.
//!
//! # Model
//! Equation (4) of [`super::fit`], a Kalman filter of one state g for given l_k = D r(t_k - t_0):
//! ```text
//! e_k = n_k + l_k g_k         n white, sigma
//! g(t_0) = 0                  f_k = e^(-(t_k - t_(k-1)) / T)     g_k = f_k g_(k-1) + w_k      var w_k = delta^2 (1 - f_k^2)
//! covariance of two errors    delta^2 l_i l_j (e^(-|t_i - t_j| / T) - e^(-(t_i + t_j - 2 t_0) / T))
//! ```
//! g begins at nothing, because a model that knows where the sensor was is right at the onset.
//!
//! # Sources
//! Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, section 3.4: generalised least squares by passing errors
//! and the columns of J through the same filter.

use super::TimedSample;
use super::step_response::StepResponse;

/// How far samples may lie from the model, equation (4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseNoise {
    /// sigma, white noise of a sample in the sensor's unit; positive.
    pub sigma: f64,
    /// delta, by which share of what is left of the transient the model errs.
    pub model_share: f64,
    /// T, for how long such an error holds, in seconds; not negative.
    pub error_duration_s: f64,
}

impl ResponseNoise {
    /// White noise and a model without fault.
    pub const fn white(sigma: f64) -> Self {
        Self { sigma, model_share: 0.0, error_duration_s: 0.0 }
    }
}

/// The filter at one sample; its variances do not depend on what is filtered.
pub(super) struct WhiteningStep {
    /// l_k.
    remaining: f64,
    /// f_k.
    retention: f64,
    /// The gain of the filter.
    gain: f64,
    /// 1 / S_k.
    pub(super) weight: f64,
    /// ln (S_k / sigma^2).
    ln_spread: f64,
}

/// The filter at each sample, for what is left of this response; samples in the order of time.
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

/// The logarithm of the determinant of the errors' covariance, over that of white noise.
pub(super) fn ln_spread(whitened: &[WhiteningStep]) -> f64 {
    whitened.iter().map(|white| white.ln_spread).sum()
}

/// The filter's estimate of g, by the errors and by each of N columns of J.
pub(super) struct WhiteningFilter<const N: usize> {
    error_state: f64,
    jacobian_state: [f64; N],
}

impl<const N: usize> WhiteningFilter<N> {
    pub(super) const fn new() -> Self {
        Self { error_state: 0.0, jacobian_state: [0.0; N] }
    }

    /// What is new in a sample's error and in its slopes.
    pub(super) fn innovations(&mut self, white: &WhiteningStep, error: f64, mut by: [f64; N]) -> (f64, [f64; N]) {
        let next = |believed: &mut f64, shown: f64| {
            *believed *= white.retention;
            let new = shown - white.remaining * *believed;
            *believed += white.gain * new;
            new
        };
        for (believed, slope) in self.jacobian_state.iter_mut().zip(&mut by) {
            *slope = next(believed, *slope);
        }
        (next(&mut self.error_state, error), by)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::super::step_response::Lag;
    use super::*;

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
