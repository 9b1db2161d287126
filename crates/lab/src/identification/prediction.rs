//! Predictions of a sensor's final value at each sample, by the predictor that runs live.

use posebridge_estimator::filters::thermometer::EndPredictor;
use posebridge_estimator::models::slow_sensor::SensorDynamics;
use posebridge_telemetry::estimate::NORMAL_95;

use super::{TimedSample, sorted_finite};

/// Probability with which the bound contains the final value.
pub const BOUND_RATE: f64 = 0.95;

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
        let half = NORMAL_95 * self.sigma;
        (self.value - half, self.value + half)
    }

    pub fn holds(&self, end: f64) -> bool {
        let (low, high) = self.bound();
        (low..=high).contains(&end)
    }
}

/// Predicts at each sample where there is a prediction. `sigma` is the noise of a sample, in the sensor's unit.
///
/// Samples that are not finite or not later than the previous one are ignored. Empty if `sigma` is not positive and finite.
pub fn predict(samples: &[TimedSample], sigma: f64, dynamics: &SensorDynamics) -> Vec<EndPrediction> {
    if !(sigma > 0.0 && sigma.is_finite()) {
        return Vec::new();
    }
    let mut predictor = EndPredictor::new(*dynamics, sigma);
    let mut predict_one = |sample: &TimedSample| {
        predictor.observe(sample.at_s, sample.value);
        let end = predictor.final_value()?;
        let is_settling = predictor.is_settling();
        Some(EndPrediction { at_s: sample.at_s, value: end.mean, sigma: end.variance.sqrt(), is_settling })
    };
    sorted_finite(samples).iter().filter_map(&mut predict_one).collect()
}
