//! The dynamic measurement filter over samples, and small pieces of pictures.

use posebridge_estimator::filters::dynamic::DynamicFilter;
use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_estimator::{Filter, FilterConfig, Params};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_telemetry::{
    Calibration, Celsius, DriveGeometry, Meters, Observation, ObservationKind, Radians, SensorId, SensorNoise,
    TimeDelta, Timestamp,
};

use super::super::TimedSample;

/// What the filter makes of samples of several sensors: instant, value and sigma after each.
pub(super) struct DynamicFilterConfig {
    pub(super) sigma: f64,
    pub(super) walk_per_sqrt_s: f64,
    /// One standard deviation of the start; the filter's own if not given.
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

    /// The same for one thermometer.
    pub(super) fn run_sensor(&self, model: &DynamicModel, samples: &[TimedSample]) -> Vec<(f64, f64, f64)> {
        let of = |sample: &TimedSample| (SensorId::THERMOMETER, *sample);
        self.run_sensors(model, &samples.iter().map(of).collect::<Vec<_>>())
    }

    fn filter(&self, model: &DynamicModel) -> DynamicFilter {
        let config = FilterConfig {
            // A thermometer on a bench: no wheel turns.
            geometry: DriveGeometry {
                left_wheel_radius: Meters(0.03),
                right_wheel_radius: Meters(0.03),
                track_width: Meters(0.1),
                tick: Radians(0.01),
            },
            noise: SensorNoise { temperature_k: self.sigma, ..SensorNoise::EXACT },
            start: None,
            params: Params { dynamic_walk_k_per_sqrt_s: self.walk_per_sqrt_s, ..Params::default() },
            calibration: Calibration::default(),
            arena_map: std::sync::Arc::default(),
        };
        let filter = DynamicFilter::with_model(&config, model.clone());
        match self.prior_sigma {
            Some(sigma) => filter.with_prior_sigma(sigma),
            None => filter,
        }
    }
}

/// A sensor of first order; one without states for a time constant that is none.
pub(super) fn first_order(tau_s: f64) -> DynamicModel {
    DynamicModel::first_order(SensorId::THERMOMETER, tau_s).unwrap_or_else(|_| DynamicModel::empty())
}

pub(super) fn line(name: &str, points: Vec<(f64, f64)>) -> Curve {
    Curve { name: name.to_owned(), shape: CurveShape::Line(points) }
}

pub(super) fn level(name: &str, value: f64) -> Curve {
    Curve { name: name.to_owned(), shape: CurveShape::Level(value) }
}

/// The band of 95 % around values with their sigmas.
pub(super) fn band(name: &str, values: &[(f64, f64, f64)]) -> Curve {
    let half = super::super::prediction::BOUND_SIGMAS;
    let of = |(at_s, value, sigma): &(f64, f64, f64)| (*at_s, value - half * sigma, value + half * sigma);
    Curve { name: name.to_owned(), shape: CurveShape::Band(values.iter().map(of).collect()) }
}

/// The values alone, for a line.
pub(super) fn filter_values(all: &[(f64, f64, f64)]) -> Vec<(f64, f64)> {
    all.iter().map(|(at_s, value, _)| (*at_s, *value)).collect()
}

pub(super) fn sample_points(samples: &[TimedSample]) -> Vec<(f64, f64)> {
    let of = |sample: &TimedSample| (sample.at_s, sample.value);
    samples.iter().map(of).collect()
}

/// A picture of temperatures over time, one panel for each set of curves.
pub(super) fn temperatures(title: &str, panels: Vec<Vec<Curve>>) -> Plot {
    let axes = panels.into_iter().map(|curves| Axes {
        x_name: "time [s]".to_owned(),
        y_name: "temperature [degrees C]".to_owned(),
        height_px: 240.0,
        is_map: false,
        curves,
    });
    Plot { title: title.to_owned(), key_figures: String::new(), axes: axes.collect() }
}
