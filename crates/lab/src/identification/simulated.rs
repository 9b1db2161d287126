//! A thermometer whose truth is known, written from physics, and independent of the code that it tests.
//!
//! # Model
//! The body of the sensor is warmed along several paths, each a resistance and a capacity; what is measured is a mix of them:
//! ```text
//! dz_j/dt = (T(t) - z_j) / tau_j        shown = sum over j of s_j z_j + n        n Gaussian, then rounded to the last digit
//! ```
//! Between two instants T is taken as a straight line, for which each z_j is known exactly.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::TimedSample;

/// A sensor and how it is read.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedSensor {
    /// tau_j in seconds with s_j; the shares add up to one.
    pub lags: Vec<(f64, f64)>,
    /// Standard deviation of n.
    pub sigma: f64,
    /// Size of the last digit; 0 for none.
    pub resolution: f64,
    /// Time between two samples, in seconds; positive.
    pub period_s: f64,
}

impl SimulatedSensor {
    /// One lag.
    pub fn first_order(tau_s: f64, sigma: f64, period_s: f64) -> Self {
        Self { lags: vec![(tau_s, 1.0)], sigma, resolution: 0.0, period_s }
    }

    /// Its readings from time 0 on, this number of samples, when the quantity is `truth(t)` and was `truth(0)` forever before.
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

    /// From the sample before to this one, in short straight pieces of the truth.
    fn advance(&self, states: &mut [f64], until_s: f64, truth: &impl Fn(f64) -> f64) {
        let piece_s = self.period_s / f64::from(SUBSTEPS);
        for piece in (0..SUBSTEPS).rev() {
            let to_s = until_s - piece_s * f64::from(piece);
            let (before, after) = (truth(to_s - piece_s), truth(to_s));
            let slope = (after - before) / piece_s;
            for (state, (tau_s, _)) in states.iter_mut().zip(&self.lags) {
                // The answer to a ramp lags behind it by tau, plus what is left of where it started.
                let kept = (-piece_s / tau_s).exp();
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

/// Straight pieces between two samples: a step of the truth is placed to this share of a period.
const SUBSTEPS: u32 = 16;

/// A quantity that is at `before` until `at_s` and at `after` from then on.
pub fn step_input(before: f64, after: f64, at_s: f64) -> impl Fn(f64) -> f64 {
    move |now_s| if now_s < at_s { before } else { after }
}

#[cfg(test)]
mod tests {
    use super::*;

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
