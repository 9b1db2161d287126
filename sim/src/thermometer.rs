//! A slow thermometer on the brick: the bath's temperature through the sensor's lags.
//!
//! # Model
//! ```text
//! dx_j/dt = (u - x_j) / tau_j        y = sum of s_j x_j, sum of s_j = 1        shown = round((y + noise) / step) step
//! u = before until the instant at which it is dipped in, after from then on; it has rested in `before` for ever
//! ```
//! # Sources
//! Newton's law of cooling for each lag; two of them for a sensor in a sleeve.

use crate::random::RandomStream;
use crate::scenario::ThermometerSettings;
use crate::time_step::STEP_S;

/// One thermometer and its bath.
#[derive(Clone, Debug)]
pub(crate) struct Thermometer {
    settings: ThermometerSettings,
    lags: Vec<FirstOrderLag>,
    noise: RandomStream,
    steps: u64,
}

#[derive(Clone, Copy, Debug)]
struct FirstOrderLag {
    share: f64,
    /// 1 - e^(-step / tau).
    approach: f64,
    state_c: f64,
}

impl Thermometer {
    /// A thermometer that has rested in its first bath.
    pub(crate) fn new(settings: &ThermometerSettings, seed: u64) -> Self {
        let parts = settings.lags_s.iter().zip(&settings.shares);
        let lag = |(tau_s, share): (&f64, &f64)| FirstOrderLag {
            share: *share,
            approach: -(-STEP_S / tau_s).exp_m1(),
            state_c: settings.before_c,
        };
        Self {
            lags: parts.map(lag).collect(),
            settings: settings.clone(),
            noise: RandomStream::new(seed, "thermometer"),
            steps: 0,
        }
    }

    /// Follows the world by one step.
    pub(crate) fn step(&mut self) {
        let elapsed_s = self.steps as f64 * STEP_S;
        self.steps += 1;
        let bath_c = if elapsed_s < self.settings.dipped_at_s { self.settings.before_c } else { self.settings.after_c };
        for lag in &mut self.lags {
            lag.state_c += lag.approach * (bath_c - lag.state_c);
        }
    }

    /// What it shows, in degrees Celsius.
    pub(crate) fn read(&mut self) -> f64 {
        let true_c: f64 = self.lags.iter().map(|lag| lag.share * lag.state_c).sum();
        let noisy_c = true_c + self.settings.sigma_k * self.noise.normal();
        let step_k = self.settings.resolution_k;
        if step_k > 0.0 { (noisy_c / step_k).round() * step_k } else { noisy_c }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> ThermometerSettings {
        ThermometerSettings {
            lags_s: vec![5.0, 20.0],
            shares: vec![0.25, 0.75],
            sigma_k: 0.0,
            resolution_k: 0.0,
            before_c: 20.0,
            after_c: 60.0,
            dipped_at_s: 3.0,
            ..ThermometerSettings::default()
        }
    }

    #[test]
    fn it_rests_until_it_is_dipped_in_and_then_goes_by_its_exponentials() {
        let mut thermometer = Thermometer::new(&settings(), 1);
        for millis in 0..23_000 {
            let since_s = (f64::from(millis) * STEP_S - 3.0).max(0.0);
            let left = 0.25 * (-since_s / 5.0).exp() + 0.75 * (-since_s / 20.0).exp();
            let (found, expected) = (thermometer.read(), 60.0 - 40.0 * left);
            assert!((found - expected).abs() < 1e-9, "{millis}: {found} {expected}");
            thermometer.step();
        }
    }

    #[test]
    fn it_shows_whole_steps_with_noise_of_the_size_that_was_asked_for() {
        let coarse = ThermometerSettings { sigma_k: 0.3, resolution_k: 0.5, ..settings() };
        let mut thermometer = Thermometer::new(&coarse, 1);
        let shown: Vec<f64> = (0..2_000).map(|_| thermometer.read()).collect();
        assert!(shown.iter().all(|value| (value * 2.0).fract() == 0.0));
        let variance = shown.iter().map(|value| (value - 20.0).powi(2)).sum::<f64>() / 2_000.0;
        // Noise and rounding: 0.09 + 0.25 / 12 = 0.111, give or take three sigma of 2000 draws.
        assert!((variance - 0.111).abs() < 0.011, "{variance}");
    }
}
