//! The paper's filter over the samples of one sensor or several.

use posebridge_estimator::filters::dynamic::DynamicFilter;
use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_estimator::{Filter, Params};
use posebridge_telemetry::{Celsius, Observation, ObservationKind, SensorId, SensorNoise, TimeDelta, Timestamp};

use crate::config_without_wheels;
use crate::identification::TimedSample;

/// A filter over samples of several sensors; returns instant, value and sigma after each.
pub(super) struct DynamicFilterConfig {
    pub(super) sigma: f64,
    pub(super) walk_per_sqrt_s: f64,
    /// One standard deviation of the start; `None` for the filter's default.
    pub(super) prior_sigma: Option<f64>,
}

impl DynamicFilterConfig {
    pub(super) const fn constant(sigma: f64) -> Self {
        Self { sigma, walk_per_sqrt_s: 0.0, prior_sigma: None }
    }

    pub(super) fn run_sensors(
        &self,
        model: &DynamicModel,
        samples: &[(SensorId, TimedSample)],
    ) -> Vec<(f64, f64, f64)> {
        let mut filter = self.filter(model);
        samples
            .iter()
            .filter_map(|(sensor, sample)| {
                filter.observe(&Observation {
                    sensor: *sensor,
                    stamp: Timestamp::from_secs_f64(sample.at_s),
                    stamp_sigma: TimeDelta::ZERO,
                    measurement: ObservationKind::Temperature(Celsius(sample.value)),
                });
                let estimate = filter.scalar_at(filter.latest_time()?)?;
                Some((sample.at_s, estimate.value, estimate.sigma))
            })
            .collect()
    }

    pub(super) fn run_sensor(&self, model: &DynamicModel, samples: &[TimedSample]) -> Vec<(f64, f64, f64)> {
        let of = |sample: &TimedSample| (SensorId::THERMOMETER, *sample);
        self.run_sensors(model, &samples.iter().map(of).collect::<Vec<_>>())
    }

    fn filter(&self, model: &DynamicModel) -> DynamicFilter {
        let params = Params { dynamic_walk_k_per_sqrt_s: self.walk_per_sqrt_s, ..Params::default() };
        let config = config_without_wheels(SensorNoise { temperature_k: self.sigma, ..SensorNoise::EXACT }, params);
        let filter = DynamicFilter::with_model(&config, model.clone());
        match self.prior_sigma {
            Some(sigma) => filter.with_prior_sigma(sigma),
            None => filter,
        }
    }
}

/// A first-order sensor; without states if the time constant is not positive.
pub(super) fn first_order(tau_s: f64) -> DynamicModel {
    DynamicModel::first_order(SensorId::THERMOMETER, tau_s).unwrap_or_else(|_| DynamicModel::empty())
}
