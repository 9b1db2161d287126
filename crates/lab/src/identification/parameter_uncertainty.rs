//! Step parameters with sigmas that are valid whether the errors of neighbouring samples are correlated or not.
//!
//! The covariance (6) of the fit assumes independent errors of the given noise. Encoder speeds are differences of whole counts, whose
//! errors are negatively correlated, and (6) is several times too large. The errors of a filtered sensor are positively correlated, and
//! (6) is too small. Here the size and the correlation of the errors are estimated from the residuals.
//!
//! # Model
//! ```text
//! u_k, g_k   innovations of the errors and of J = dy/dp by the filter of equation (4), over their sigma: those that the fit has summed up
//! B = (sum of g_k' g_k)^-1           C_l = sum of u_k u_(k+l) / (N - p)
//! P = B [ sum over l = -L .. L of b_l C_|l| (sum over k of g_k' g_(k+l)) ] B          b_l = 1 - |l| / (L + 1)               (I9)
//! L = 0 if |C_l / C_0| < 2 sqrt(log10 N / N) for l = 1 .. 5, else N / 16
//! differences of readings   u_k = q_(k+1) - q_k      sum of g_k u_k = sum of (g_(k-1) - g_k) q_k: (I9) with q and these slopes  (I10)
//! mean lag = sum of s_j tau_j: by so much the sensor trails a ramp                                                          (I8)
//! ```
//! In (I10) a reading that does not change has a constant error: its terms are added up before they are squared. Without that a standing
//! counter would count as many errors as it was read.
//!
//! Where the model itself errs (delta of (8) is not zero) a sum over few lags misses a part of the correlation of its errors: the
//! larger one of (I9) and (6) is used then.
//!
//! # Sources
//! Newey and West (1987), (I9), for errors whose statistics do not change along the step; Politis (2003), what counts as no correlation;
//! docs/lab/calibration.md, section 7.

use nalgebra::{DMatrix, DVector};
use posebridge_telemetry::UncertainValue;

use super::fit::{ResponseNoise, WhiteningFilter, share_slopes, sigma_along, value_and_slopes, whitening_steps};
use super::prior::row;
use super::step::{IdentifiedLag, IdentifiedStep};
use super::step_response::StepResponse;
use crate::statistics::lagged_sum;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampling {
    #[default]
    Readings,
    /// The difference of two neighbouring readings of a counter: each reading's error is in two samples.
    Differences,
}

/// Largest lag in samples that is tested for correlation (Politis).
const CHECKED_LAGS: usize = 5;
/// Differences of independent errors have rho(1) = -1/2; above half of that another noise dominates.
const DIFFERENCES_BELOW: f64 = -0.25;
/// A counter stands while its speed differs by less than this share of the residuals' root mean square.
const STEADY_BELOW: f64 = 0.05;
/// Samples per lag of the window: the estimated variance is then accurate to about 30 %.
const SAMPLES_PER_LAG: usize = 16;
/// Bounds the run time for long recordings.
const MAX_LAGS: usize = 256;

#[derive(Clone, Debug, PartialEq)]
pub struct StepParameters {
    /// Sensor units per unit of the quantity, if the step of the quantity was given.
    pub gain: Option<UncertainValue>,
    /// From the step of the quantity to the onset of the sensor, if the former was given.
    pub delay_s: Option<UncertainValue>,
    /// Onset, by the sensor's clock.
    pub onset_s: UncertainValue,
    /// In the sensor's unit.
    pub step: UncertainValue,
    /// Final value, in the sensor's unit.
    pub end: UncertainValue,
    /// The fastest first.
    pub lags: Vec<IdentifiedLag>,
    /// Equation (I8).
    pub mean_lag_s: UncertainValue,
    /// Of the residuals of the response, in the sensor's unit.
    pub residual_rms: f64,
    /// Correlation of neighbouring residuals, -1 to 1.
    pub rho_1: f64,
}

impl StepParameters {
    /// Parameters of an identified step; `input_step` is the step of the quantity, if known.
    pub fn from_step(found: &IdentifiedStep, input_step: Option<f64>, sampling: Sampling) -> Self {
        let residuals = WeightedResiduals::of(found);
        let covariance = residuals.covariance(found, sampling);
        let response = found.response();
        let known =
            |value: f64, slopes: &[(usize, f64)]| UncertainValue { value, sigma: sigma_along(&covariance, slopes) };
        let per_input = |input: f64| {
            let gain = response.step / input;
            known(gain, &[(row::STEP, 1.0 / input)])
        };
        let order = response.lags.len();
        let lags = response.lags.iter().enumerate().map(|(j, lag)| {
            let tau = [(row::LAGS + j, lag.time_constant_s)];
            IdentifiedLag {
                time_constant_s: lag.time_constant_s,
                time_constant_sigma_s: sigma_along(&covariance, &tau),
                share: lag.share,
                share_sigma: sigma_along(&covariance, &share_slopes(j, order)),
            }
        });
        Self {
            gain: input_step.map(per_input),
            delay_s: found.delay_s.map(|delay| known(delay, &[(row::ONSET, 1.0)])),
            onset_s: known(response.onset_s, &[(row::ONSET, 1.0)]),
            step: known(response.step, &[(row::STEP, 1.0)]),
            end: known(response.final_value(), &[(row::START, 1.0), (row::STEP, 1.0)]),
            lags: lags.collect(),
            mean_lag_s: mean_lag(response, &covariance),
            residual_rms: residuals.rms,
            rho_1: residuals.rho_1,
        }
    }
}

fn mean_lag(response: &StepResponse, covariance: &DMatrix<f64>) -> UncertainValue {
    let lags = &response.lags;
    let order = lags.len();
    let last_s = lags.last().map_or(0.0, |lag| lag.time_constant_s);
    let of_taus = lags.iter().enumerate();
    let of_taus = of_taus.map(|(j, lag)| (row::LAGS + j, lag.share * lag.time_constant_s));
    let of_shares = lags.iter().take(order.saturating_sub(1)).enumerate();
    let of_shares = of_shares.map(|(j, lag)| (row::LAGS + order + j, lag.time_constant_s - last_s));
    let slopes: Vec<(usize, f64)> = of_taus.chain(of_shares).collect();
    UncertainValue {
        value: lags.iter().map(|lag| lag.share * lag.time_constant_s).sum(),
        sigma: sigma_along(covariance, &slopes),
    }
}

struct WeightedResiduals {
    weighted: Vec<f64>,
    slopes: Vec<DVector<f64>>,
    rms: f64,
    rho_1: f64,
}

impl WeightedResiduals {
    fn of(found: &IdentifiedStep) -> Self {
        let response = found.response();
        let rows = row::LAGS + 2 * response.lags.len() - 1;
        let chosen = found.chosen();
        let noise = ResponseNoise {
            sigma: found.sigma,
            model_share: chosen.model_share,
            error_duration_s: chosen.error_duration_s,
        };
        let mut columns = WhiteningFilter::new();
        let mut weighted = Vec::new();
        let mut slopes = Vec::new();
        let mut errors = Vec::new();
        let whitened = whitening_steps(&found.samples, response, &noise);
        for (sample, white) in found.samples.iter().zip(&whitened) {
            let Some((value, by)) = value_and_slopes(response, sample.at_s) else {
                continue;
            };
            let error = sample.value - value;
            let (new, by) = columns.innovations(white, error, by);
            let scale = white.weight.sqrt();
            errors.push(error);
            weighted.push(new * scale);
            slopes.push(DVector::from_iterator(rows, by.into_iter().take(rows).map(|slope| slope * scale)));
        }
        let squares = lagged_sum(&errors, 0);
        Self {
            rms: (squares / errors.len().max(1) as f64).sqrt(),
            rho_1: if squares > 0.0 { lagged_sum(&errors, 1) / squares } else { 0.0 },
            weighted,
            slopes,
        }
    }

    /// P of equation (I9) or (I10), or of (6) where that is larger and the model errs.
    fn covariance(&self, found: &IdentifiedStep, sampling: Sampling) -> DMatrix<f64> {
        let fit = &found.chosen().fit;
        let is_exact = found.chosen().model_share <= 0.0;
        let of_readings = sampling == Sampling::Differences && is_exact && self.rho_1 < DIFFERENCES_BELOW;
        let own = if of_readings { self.covariance_by_readings() } else { self.covariance_by_samples() };
        let own = own.unwrap_or_else(|| fit.covariance.clone());
        if is_exact {
            return own;
        }
        let rows = own.nrows();
        // The larger variance of each number, with the correlations of (I9).
        let ratios = DVector::from_fn(rows, |i, _| {
            let (ours, theirs) = (own[(i, i)], fit.covariance[(i, i)]);
            if ours > 0.0 { (theirs / ours).max(1.0).sqrt() } else { 1.0 }
        });
        DMatrix::from_fn(rows, rows, |i, j| own[(i, j)] * ratios[i] * ratios[j])
    }

    /// Equation (I9); `None` where the samples do not determine the parameters.
    fn covariance_by_samples(&self) -> Option<DMatrix<f64>> {
        let count = self.weighted.len();
        let limit = 2.0 * ((count.max(2) as f64).log10() / count as f64).sqrt();
        let scale = lagged_sum(&self.weighted, 0);
        let is_white = (1..=CHECKED_LAGS).all(|lag| lagged_sum(&self.weighted, lag).abs() < limit * scale);
        let lags = if is_white { 0 } else { correlation_window(count) };
        let bread = self.inverse_information()?;
        cross_covariance(&self.weighted, &self.slopes, lags).map(|between| &bread * between * &bread)
    }

    /// Equation (I10).
    fn covariance_by_readings(&self) -> Option<DMatrix<f64>> {
        let rows = self.slopes.first()?.len();
        let rms = (lagged_sum(&self.weighted, 0) / self.weighted.len() as f64).sqrt();
        let mut error = 0.0;
        let mut errors = vec![error];
        let mut along = DVector::zeros(rows);
        let mut slopes = Vec::new();
        for (u, g) in self.weighted.iter().zip(&self.slopes) {
            if u.abs() < STEADY_BELOW * rms {
                // The next reading errs by the same: what it adds and what it takes away is nothing.
                continue;
            }
            slopes.push(along - g);
            along = g.clone();
            error += u;
            errors.push(error);
        }
        slopes.push(along);
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        for error in &mut errors {
            *error -= mean;
        }
        let bread = self.inverse_information()?;
        let lags = correlation_window(errors.len());
        cross_covariance(&errors, &slopes, lags).map(|between| &bread * between * &bread)
    }

    fn inverse_information(&self) -> Option<DMatrix<f64>> {
        let rows = self.slopes.first()?.len();
        Some(lagged_products(&self.slopes, 0, rows).cholesky()?.inverse())
    }
}

fn correlation_window(count: usize) -> usize {
    (count / SAMPLES_PER_LAG).clamp(1, MAX_LAGS)
}

/// The sum in the middle of (I9); `None` for fewer errors than parameters.
fn cross_covariance(errors: &[f64], slopes: &[DVector<f64>], lags: usize) -> Option<DMatrix<f64>> {
    let rows = slopes.first()?.len();
    let freedom = errors.len().checked_sub(rows).filter(|free| *free > 0)? as f64;
    let mut sum = lagged_products(slopes, 0, rows) * (lagged_sum(errors, 0) / freedom);
    for lag in 1..=lags {
        let taper = 1.0 - lag as f64 / (lags + 1) as f64;
        let pairs = lagged_products(slopes, lag, rows);
        sum += (&pairs + pairs.transpose()) * (taper * lagged_sum(errors, lag) / freedom);
    }
    Some(sum)
}

/// The sum of g_k' g_(k+l).
fn lagged_products(slopes: &[DVector<f64>], lag: usize, rows: usize) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(rows, rows);
    for (here, there) in slopes.iter().zip(slopes.iter().skip(lag)) {
        sum.ger(1.0, here, there, 1.0);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::super::step::{StepOptions, identify_step};
    use super::super::{TimedSample, estimate_noise};
    use super::*;
    use crate::identification::step_response::{SimulatedSensor, step_input};
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    const RUNS: u64 = 120;

    /// The mean square of error over sigma of tau, gain and delay over many draws; each is 1 if the sigma is right.
    fn normalised(
        draw: impl Fn(u64) -> Vec<TimedSample>,
        sigma: f64,
        tau_s: f64,
        input: f64,
        sampling: Sampling,
    ) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for seed in 0..RUNS {
            let options = StepOptions {
                order: Some(1),
                onset_s: Some(ONSET_S),
                input_step: Some(input),
                ..StepOptions::with_sigma(sigma)
            };
            let found = identify_step(&draw(seed), &options).unwrap();
            let numbers = StepParameters::from_step(&found, Some(input), sampling);
            let lag = numbers.lags[0];
            let (gain, delay) = (numbers.gain.unwrap(), numbers.delay_s.unwrap());
            let errors = [
                (lag.time_constant_s - tau_s) / lag.time_constant_sigma_s,
                (gain.value - 1.0) / gain.sigma,
                delay.value / delay.sigma,
            ];
            for (sum, error) in sums.iter_mut().zip(errors) {
                *sum += error * error / RUNS as f64;
            }
        }
        println!("tau {:.2}, gain {:.2}, delay {:.2}", sums[0], sums[1], sums[2]);
        sums
    }

    /// In the middle of one of the pieces in which the simulated sensor sees the world.
    const ONSET_S: f64 = 10.0 + 0.1 / 32.0;

    /// The mean of 120 squares of standard normals is 1, known to 0.13; beyond that the sigma itself is known to some 15 %.
    const RIGHT: std::ops::Range<f64> = 0.6..1.6;

    #[test]
    fn sigmas_are_right_for_white_noise_and_where_the_noise_was_told_wrong() {
        let sensor = SimulatedSensor::first_order(4.0, 0.1, 0.1);
        let draw = |seed| sensor.run(seed, 500, step_input(20.0, 4.0, ONSET_S));
        for assumed in [0.1, 0.2] {
            let found = normalised(draw, assumed, 4.0, -16.0, Sampling::Readings);
            assert!(found.iter().all(|one| RIGHT.contains(one)), "{found:?}");
        }
    }

    #[test]
    fn sigmas_are_right_where_neighbours_err_alike() {
        // A first-order filter over three samples' time: rho of neighbours 0.7.
        let draw = |seed| {
            let clean = SimulatedSensor::first_order(4.0, 0.0, 0.1);
            let mut random = Pcg64::seed_from_u64(seed);
            let mut held = 0.1 * random.sample::<f64, _>(StandardNormal);
            let mut samples = clean.run(seed, 500, step_input(20.0, 4.0, ONSET_S));
            for sample in &mut samples {
                held = 0.7 * held + 0.1 * 0.51_f64.sqrt() * random.sample::<f64, _>(StandardNormal);
                sample.value += held;
            }
            samples
        };
        let found = normalised(draw, 0.1, 4.0, -16.0, Sampling::Readings);
        assert!(found.iter().all(|one| (0.3..2.0).contains(one)), "{found:?}");
    }

    #[test]
    fn differences_of_whole_counts_are_not_taken_for_white_noise() {
        // A wheel that speeds up to 12 rad/s within 0.1 s, counted in degrees every 10 ms.
        let tick = 1.0_f64.to_radians();
        let draw = |seed| {
            let mut random = Pcg64::seed_from_u64(seed);
            let (turned, phase): (f64, f64) = (random.random(), random.random());
            let count = |k: u32| {
                let since_s = (0.01 * (f64::from(k) + phase) - 1.0).max(0.0);
                let angle = 12.0 * (since_s - 0.1 * (1.0 - (-since_s / 0.1).exp()));
                (angle / tick + turned).floor()
            };
            (0..250)
                .map(|k| TimedSample {
                    at_s: 0.01 * (f64::from(k) + 0.5 + phase) + ONSET_S - 1.0,
                    value: (count(k + 1) - count(k)) * tick / 0.01,
                })
                .collect::<Vec<_>>()
        };
        let sigma = tick / 0.01 / 6.0_f64.sqrt();
        let found = normalised(draw, sigma, 0.1, 12.0, Sampling::Differences);
        let is_right = |one: &f64| (0.4..2.0).contains(one);
        assert!(found.iter().all(is_right), "{found:?}");
        // Taken for readings of their own, the gain would seem ten times less certain than it is.
        let naive = normalised(draw, sigma, 0.1, 12.0, Sampling::Readings);
        assert!(naive[1] < 0.05, "{naive:?}");
    }

    #[test]
    fn the_mean_lag_and_the_last_share_follow_from_all_others() {
        let sensor =
            SimulatedSensor { lags: vec![(2.0, 0.4), (12.0, 0.6)], sigma: 0.02, resolution: 0.0, period_s: 0.1 };
        let samples = sensor.run(3, 1_000, step_input(20.0, 4.0, ONSET_S));
        let sigma = estimate_noise(&samples).unwrap();
        let found = identify_step(&samples, &StepOptions::with_sigma(sigma)).unwrap();
        let numbers = StepParameters::from_step(&found, None, Sampling::Readings);
        assert_eq!(numbers.lags.len(), 2);
        let mean_lag = numbers.mean_lag_s;
        assert!((mean_lag.value - 8.0).abs() < 4.0 * mean_lag.sigma, "{mean_lag:?}");
        // Far better known than the slow lag, whose error the shares make good.
        assert!(mean_lag.sigma < 0.7 * numbers.lags[1].time_constant_sigma_s);
        let (first, last) = (numbers.lags[0], numbers.lags[1]);
        assert!((first.share_sigma - last.share_sigma).abs() < 1e-12);
        assert!((numbers.end.value - 4.0).abs() < 4.0 * numbers.end.sigma);
        assert!(numbers.rho_1.abs() < 0.15 && (numbers.residual_rms / 0.02 - 1.0).abs() < 0.1);
        assert_eq!((numbers.gain, numbers.delay_s), (None, None));
    }
}
