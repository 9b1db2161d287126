//! A sensor's step response as a sum of exponentials.
//!
//! # Model
//! ```text
//! y(t) = y_0 + D h(t - t_0)      h(a) = sum over j of s_j (1 - e^(-a / tau_j)) for a > 0, else 0      sum of s_j = 1       (1)
//! remaining transient            r(a) = sum over j of s_j e^(-a / tau_j)                             u = y_0 + D / G     (2)
//! ```
//! A sensor that rests before the step starts from y_0, so its transient is -D r: paper 2's C e^(A t) x_ini with x_j = -s_j D.
//! Shares may be negative, as for lags in series.
//!
//! # Sources
//! Paper 2 (Markovsky), the model with known dynamics; docs/lab/thermometer.md section 1.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::TimedSample;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// tau.
    pub time_constant_s: f64,
    /// Share of the step; the shares of a response sum to one.
    pub share: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct StepResponse {
    /// y_0, the value before the step.
    pub start: f64,
    /// D, final minus initial value.
    pub step: f64,
    /// t_0, the onset, by the sensor's clock.
    pub onset_s: f64,
    /// The fastest first.
    pub lags: Vec<Lag>,
}

impl StepResponse {
    /// Equation (1).
    pub fn value_at(&self, at_s: f64) -> f64 {
        self.start + self.step * (1.0 - self.remaining(at_s - self.onset_s))
    }

    /// r, the remaining share of the step, by equation (2); 1 before the onset.
    pub fn remaining(&self, since_onset_s: f64) -> f64 {
        let since_s = since_onset_s.max(0.0);
        let of = |lag: &Lag| lag.share * (-since_s / lag.time_constant_s).exp();
        self.lags.iter().map(of).sum()
    }

    /// Time after the onset from which less than this share of the step is left, to a thousandth of the slowest time constant; infinite for a share that
    /// is not positive.
    pub fn settling_time_s(&self, share: f64) -> f64 {
        if share <= 0.0 {
            return f64::INFINITY;
        }
        let slowest_s = self.lags.iter().map(|lag| lag.time_constant_s).fold(0.0, f64::max);
        let step_s = 1e-3 * slowest_s;
        // Shares may be negative, so that the last crossing counts. After 30 slowest lags nothing is left.
        let last = (0..30_000_u32).rev().find(|k| self.remaining(step_s * f64::from(*k)).abs() > share);
        last.map_or(0.0, |last| step_s * f64::from(last + 1))
    }

    pub fn final_value(&self) -> f64 {
        self.start + self.step
    }
}

/// Time after the onset from which a series stays within `limit` of `end`; `None` if its last value is outside, if it is empty, or if a
/// number is not finite.
///
/// The series holds instants and values in time order. The result is the instant of the first value after which none is outside.
pub fn settling_time_s(series: &[(f64, f64)], onset_s: f64, end: f64, limit: f64) -> Option<f64> {
    let is_inside = |value: f64| (value - end).abs() <= limit;
    let last_outside = series.iter().rposition(|(_, value)| !is_inside(*value));
    let first_inside = last_outside.map_or(0, |index| index + 1);
    let (at_s, _) = series.get(first_inside)?;
    let after_s = at_s - onset_s;
    after_s.is_finite().then_some(after_s.max(0.0))
}

// A thermometer whose truth is known, written from physics, and independent of the code that it tests.
//
// # Model
// The body of the sensor is warmed along several paths, each a resistance and a capacity; what is measured is a mix of them:
// ```text
// dz_j/dt = (T(t) - z_j) / tau_j        shown = sum over j of s_j z_j + n        n Gaussian, then rounded to the last digit
// ```
// Between two instants T is taken as a straight line, for which each z_j is known exactly.

#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedSensor {
    /// tau_j in seconds with s_j; the shares sum to one.
    pub lags: Vec<(f64, f64)>,
    pub sigma: f64,
    /// 0 for none.
    pub resolution: f64,
    /// Positive.
    pub period_s: f64,
}

impl SimulatedSensor {
    pub fn first_order(tau_s: f64, sigma: f64, period_s: f64) -> Self {
        Self { lags: vec![(tau_s, 1.0)], sigma, resolution: 0.0, period_s }
    }

    /// `count` readings from time 0 on, for the quantity `truth(t)`, which was `truth(0)` forever before.
    pub fn run(&self, seed: u64, count: usize, truth: impl Fn(f64) -> f64) -> Vec<TimedSample> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut states: Vec<f64> = self.lags.iter().map(|_| truth(0.0)).collect();
        (0..count)
            .map(|k| {
                let at_s = self.period_s * k as f64;
                if k > 0 {
                    self.advance(&mut states, at_s, &truth);
                }
                let paths = self.lags.iter().zip(&states);
                let clean: f64 = paths.map(|((_, share), state)| share * state).sum();
                let noisy = clean + self.sigma * random.sample::<f64, _>(StandardNormal);
                TimedSample { at_s, value: self.quantize(noisy) }
            })
            .collect()
    }

    /// Integrates from the previous sample to this one, with the truth piecewise constant.
    fn advance(&self, states: &mut [f64], until_s: f64, truth: &impl Fn(f64) -> f64) {
        let substep_s = self.period_s / f64::from(SUBSTEPS);
        for substep in (0..SUBSTEPS).rev() {
            let to_s = until_s - substep_s * f64::from(substep);
            let (before, after) = (truth(to_s - substep_s), truth(to_s));
            let slope = (after - before) / substep_s;
            for (state, (tau_s, _)) in states.iter_mut().zip(&self.lags) {
                // The answer to a ramp lags behind it by tau, plus what is left of where it started.
                let kept = (-substep_s / tau_s).exp();
                let (lagged_before, lagged_after) = (before - slope * tau_s, after - slope * tau_s);
                *state = lagged_after + kept * (*state - lagged_before);
            }
        }
    }

    fn quantize(&self, value: f64) -> f64 {
        if self.resolution > 0.0 {
            return (value / self.resolution).round() * self.resolution;
        }
        value
    }
}

/// Integration steps between two samples, and the time resolution of a step of the truth.
const SUBSTEPS: u32 = 16;

/// `before` until `at_s`, `after` from then on.
pub fn step_input(before: f64, after: f64, at_s: f64) -> impl Fn(f64) -> f64 {
    move |now_s| if now_s < at_s { before } else { after }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn response() -> StepResponse {
        let lag = |time_constant_s, share| Lag { time_constant_s, share };
        StepResponse { start: 20.0, step: -16.0, onset_s: 5.0, lags: vec![lag(2.0, 0.25), lag(8.0, 0.75)] }
    }

    #[test]
    fn it_rests_before_the_onset_and_ends_a_step_away() {
        let response = response();
        for at_s in [-100.0, 0.0, 5.0] {
            assert!((response.value_at(at_s) - 20.0).abs() < 1e-12);
        }
        assert!((response.value_at(1e4) - 4.0).abs() < 1e-12);
        let by_hand = 20.0 - 16.0 * (1.0 - 0.25 * (-3.0_f64).exp() - 0.75 * (-0.75_f64).exp());
        assert!((response.value_at(11.0) - by_hand).abs() < 1e-12);
        assert_eq!(response.final_value(), 4.0);
    }

    #[test]
    fn it_counts_from_the_last_excursion() {
        let series: Vec<(f64, f64)> =
            [9.0, 5.0, 3.2, 4.5, 3.1, 2.9].into_iter().enumerate().map(|(k, value)| (10.0 + k as f64, value)).collect();
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 0.5), Some(4.0));
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 2.0), Some(1.0));
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 9.0), Some(0.0));
        assert_eq!(settling_time_s(&series, 10.0, 3.0, 0.01), None);
        assert_eq!(settling_time_s(&[], 0.0, 3.0, 1.0), None);
        assert_eq!(settling_time_s(&[(0.0, f64::NAN)], 0.0, 3.0, 1.0), None);
    }

    #[test]
    fn a_step_is_approached_by_newtons_law() {
        let sensor = SimulatedSensor::first_order(5.0, 0.0, 0.5);
        for sample in sensor.run(1, 60, step_input(20.0, 4.0, 10.0)) {
            let since_s = sample.at_s - 10.0;
            let expected = if since_s > 0.0 { 4.0 + 16.0 * (-since_s / 5.0).exp() } else { 20.0 };
            // The step is a ramp of one piece, here 1/32 s.
            assert!((sample.value - expected).abs() < 0.06, "{sample:?}");
        }
    }

    #[test]
    fn a_ramp_is_followed_by_the_time_constant_behind() {
        let sensor = SimulatedSensor::first_order(5.0, 0.0, 1.0);
        let last = sensor.run(1, 101, |now_s| 0.1 * now_s).pop().unwrap();
        assert!((last.value - (10.0 - 0.5)).abs() < 1e-6, "{last:?}");
    }

    #[test]
    fn noise_is_seeded_and_rounding_leaves_whole_digits() {
        let sensor =
            SimulatedSensor { lags: vec![(1.0, 0.5), (9.0, 0.5)], sigma: 0.2, resolution: 0.0625, period_s: 1.0 };
        let run = |seed| sensor.run(seed, 200, step_input(20.0, 4.0, 10.0));
        assert_eq!(run(3), run(3));
        assert_ne!(run(3), run(4));
        assert!(run(3).iter().all(|sample| (sample.value / 0.0625).fract() == 0.0));
    }
}
