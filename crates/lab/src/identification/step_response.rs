//! A sensor's answer to a step, as a sum of exponentials.
//!
//! # Model
//! ```text
//! y(t) = y_0 + D h(t - t_0)      h(a) = sum over j of s_j (1 - e^(-a / tau_j)) for a > 0, else 0      sum of s_j = 1       (1)
//! what is left of the transient   r(a) = sum over j of s_j e^(-a / tau_j)                             u = y_0 + D / G     (2)
//! ```
//! A sensor that rests before the step starts from y_0, so its transient is -D r: paper 2's C e^(A t) x_ini with x_j = -s_j D.
//! Shares may be negative: a lag behind another lag has one.
//!
//! # Sources
//! Paper 2 (Markovsky), the model with known dynamics; docs/lab/thermometer.md section 1.

use posebridge_estimator::models::dynamic_measurement::{DynamicModel, ModelError};
use posebridge_telemetry::SensorId;

/// One exponential of a response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// tau, in seconds.
    pub time_constant_s: f64,
    /// Its share of the step; the shares of a response add up to one.
    pub share: f64,
}

/// A whole response: where it started, where it goes, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct StepResponse {
    /// y_0, what the sensor showed before the step.
    pub start: f64,
    /// D, how far it will go; negative downwards.
    pub step: f64,
    /// t_0, when it began to move, in seconds of the sensor's clock.
    pub onset_s: f64,
    /// The exponentials, the fastest first.
    pub lags: Vec<Lag>,
}

impl StepResponse {
    /// What the sensor shows at an instant, by equation (1).
    pub fn value_at(&self, at_s: f64) -> f64 {
        self.start + self.step * (1.0 - self.remaining(at_s - self.onset_s))
    }

    /// r, the share of the step that is still to come after a time in seconds, by equation (2); 1 before the onset.
    pub fn remaining(&self, since_onset_s: f64) -> f64 {
        let since_s = since_onset_s.max(0.0);
        let of = |lag: &Lag| lag.share * (-since_s / lag.time_constant_s).exp();
        self.lags.iter().map(of).sum()
    }

    /// What it shows in the end.
    pub fn final_value(&self) -> f64 {
        self.start + self.step
    }

    /// The longest time constant, in seconds; 0 without lags.
    pub fn slowest_s(&self) -> f64 {
        let lags = self.lags.iter().map(|lag| lag.time_constant_s);
        lags.fold(0.0, f64::max)
    }

    /// These lags as a model for the dynamic measurement filter, with a gain in the sensor's unit per unit of the quantity. The filter
    /// leaves the shares open: it estimates the transient of each lag.
    ///
    /// # Errors
    /// The lags or the gain are not those of a sensor.
    pub fn model(&self, sensor: SensorId, gain: f64) -> Result<DynamicModel, ModelError> {
        let lags: Vec<f64> = self.lags.iter().map(|lag| lag.time_constant_s).collect();
        DynamicModel::empty().with_lags(sensor, gain, &lags)
    }
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
        assert_eq!((response.final_value(), response.slowest_s()), (4.0, 8.0));
    }

    #[test]
    fn its_model_for_the_filter_has_a_state_for_each_lag() {
        let model = response().model(SensorId::THERMOMETER, 1.0).unwrap();
        assert_eq!(model.states(), 2);
        assert!((model.transition(2.0)[(1, 1)] - (-1.0_f64).exp()).abs() < 1e-14);
        assert!(response().model(SensorId::THERMOMETER, 0.0).is_err());
    }
}
