//! A thermometer in service, for hours: its final value, without the instant of immersion and, if need be, without its
//! time constants.
//!
//! The filter of paper 2 ([`super::dynamic`]) where the lags are exactly known, or else [`EndPredictor`]; both begin anew
//! where the test in `change_detector` finds a new temperature.
//!
//! Source: Paper 2 (Markovsky); docs/lab/thermometer.md, section M7.

mod change_detector;
mod end_predictor;
mod filter_bank;

use posebridge_telemetry::{
    BrickClock, FusionOutcome, FusionRecord, Observation, ObservationKind, ScalarEstimate, SensorId, Timestamp,
};
use serde::{Deserialize, Serialize};

use self::change_detector::ChangeDetector;
pub use self::change_detector::ReadingClass;
use self::end_predictor::SavedPredictor;
pub use self::end_predictor::{EndPredictor, ReadingReport};
pub use self::filter_bank::MeanVariance;
use super::dynamic::{DEFAULT_SIGMA_K, DynamicFilter, SavedDynamic};
use crate::filter::{Filter, FilterConfig};
use crate::models::dynamic_measurement::DynamicModel;
use crate::models::slow_sensor::SensorDynamics;
use crate::saved::{self, RestoreError};
use crate::update::{ScalarOutcome, UpdateOutcome};
use crate::validation::{self, MAX_AHEAD, add_innovation};

/// What is known of a thermometer's response.
#[derive(Clone, Debug, PartialEq)]
pub enum ThermometerResponse {
    /// Exactly, for [`SensorId::THERMOMETER`].
    Exact(Box<DynamicModel>),
    Uncertain(SensorDynamics),
}

#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerSettings {
    pub response: ThermometerResponse,
    /// Noise of a reading, one standard deviation; zero takes that of the robot's sensors.
    pub sigma_k: f64,
    /// The step of its displayed values; zero if fine. It counts as noise of a step over the root of twelve.
    pub resolution_k: f64,
}

impl ThermometerSettings {
    /// Of a thermometer for which nothing else is configured.
    pub const fn from_config(config: &FilterConfig) -> Self {
        let sensor = &config.slow_sensor;
        let response = ThermometerResponse::Uncertain(sensor.dynamics);
        Self { response, sigma_k: sensor.noise, resolution_k: sensor.resolution }
    }
}

pub struct Thermometer {
    model: ThermometerModel,
    history_s: f64,
    /// Of the newest reading, used or not.
    newest: Option<Timestamp<BrickClock>>,
    /// Of the newest reading that was used.
    last: Option<Timestamp<BrickClock>>,
    /// A stamp too far ahead to be believed alone.
    far_ahead: Option<Timestamp<BrickClock>>,
}

enum ThermometerModel {
    Exact(Box<ExactThermometer>),
    Learning { predictor: Box<EndPredictor>, origin: Option<Timestamp<BrickClock>> },
}

/// The filter of paper 2, which begins anew at each new temperature.
struct ExactThermometer {
    filter: DynamicFilter,
    change_detector: ChangeDetector,
}

/// A thermometer without its settings.
#[derive(Serialize, Deserialize)]
struct SavedThermometer {
    model: SavedModel,
    newest: Option<Timestamp<BrickClock>>,
    last: Option<Timestamp<BrickClock>>,
    far_ahead: Option<Timestamp<BrickClock>>,
}

#[derive(Serialize, Deserialize)]
enum SavedModel {
    Exact { filter: Box<SavedDynamic>, change_detector: ChangeDetector },
    Learning { predictor: SavedPredictor, origin: Option<Timestamp<BrickClock>> },
}

impl Thermometer {
    /// Walk and history come from the configuration, the noise too where the settings have none.
    pub fn new(config: &FilterConfig, settings: &ThermometerSettings) -> Self {
        let configured = [settings.sigma_k, config.noise.temperature_k];
        let sigma_k = configured.into_iter().find(|sigma| *sigma > 0.0);
        let rounding_k = settings.resolution_k.max(0.0) / 12.0_f64.sqrt();
        let sigma_k = sigma_k.unwrap_or(DEFAULT_SIGMA_K).hypot(rounding_k);
        let model = match &settings.response {
            ThermometerResponse::Exact(model) => {
                let mut config = config.clone();
                config.noise.temperature_k = sigma_k;
                let filter = DynamicFilter::with_model(&config, (**model).clone());
                ThermometerModel::Exact(Box::new(ExactThermometer {
                    filter,
                    change_detector: ChangeDetector::default(),
                }))
            }
            ThermometerResponse::Uncertain(description) => {
                let predictor = Box::new(EndPredictor::new(*description, sigma_k));
                ThermometerModel::Learning { predictor, origin: None }
            }
        };
        Self { model, history_s: config.params.history_s, newest: None, last: None, far_ahead: None }
    }

    /// As of the last reading, in degrees Celsius; `None` before the first, and where it cannot be told.
    pub fn final_value(&self) -> Option<ScalarEstimate> {
        self.scalar_at(self.last?)
    }

    /// After an hour of silence every stamp is too far ahead; the second one that agrees with the first begins anew.
    fn restart_after_silence(&mut self, stamp: Timestamp<BrickClock>) {
        let is_far = self.newest.is_some_and(|newest| stamp - newest > MAX_AHEAD);
        let follows = |earlier: Timestamp<BrickClock>| stamp > earlier && stamp - earlier <= MAX_AHEAD;
        let is_confirmed = is_far && self.far_ahead.is_some_and(follows);
        self.far_ahead = Some(stamp).filter(|_| is_far && !is_confirmed);
        if is_confirmed {
            self.restart_clock();
        }
    }

    fn use_reading(&mut self, record: &mut FusionRecord, observation: &Observation, shown: f64) {
        let (report, accepted) = match &mut self.model {
            ThermometerModel::Exact(exact) => exact.observe(observation, shown),
            ThermometerModel::Learning { predictor, origin } => {
                let origin = *origin.get_or_insert(observation.stamp);
                let report = predictor.observe((observation.stamp - origin).as_secs_f64(), shown);
                (report, FusionOutcome::Accepted)
            }
        };
        if let Some(expected) = report.expected {
            let innovation = shown - expected.mean;
            let nis = innovation * innovation / expected.variance;
            let outcome = UpdateOutcome::Used;
            add_innovation(record, innovation, &ScalarOutcome { innovation_variance: expected.variance, nis, outcome });
        }
        record.outcome = match report.class {
            ReadingClass::Expected => accepted,
            ReadingClass::Outlier => FusionOutcome::Gated,
            ReadingClass::StepChange { .. } => FusionOutcome::PoseReset,
        };
        self.newest = Some(observation.stamp);
        if report.class != ReadingClass::Outlier {
            self.last = self.newest;
        }
    }
}

impl ExactThermometer {
    /// With the filter's own verdict on a reading that it was given.
    fn observe(&mut self, observation: &Observation, shown: f64) -> (ReadingReport, FusionOutcome) {
        let expected = self.filter.expected(SensorId::THERMOMETER, observation.stamp);
        let expected = expected.map(|(mean, variance)| MeanVariance { mean, variance });
        let class = expected.map_or(ReadingClass::Expected, |expected| {
            self.change_detector.classify((shown - expected.mean) / expected.variance.sqrt())
        });
        if matches!(class, ReadingClass::StepChange { .. }) {
            self.filter.restart_clock();
        }
        let outcome = match class {
            ReadingClass::Outlier => FusionOutcome::Gated,
            ReadingClass::Expected | ReadingClass::StepChange { .. } => self.filter.observe(observation).outcome,
        };
        (ReadingReport { class, expected }, outcome)
    }
}

impl Filter for Thermometer {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        self.restart_after_silence(observation.stamp);
        validation::observe_if_valid(observation, self.newest, self.history_s, |record| {
            if let (ObservationKind::Temperature(shown), SensorId::THERMOMETER) =
                (observation.measurement, observation.sensor)
            {
                match validation::reject_repeated(self.newest, observation.stamp) {
                    Some(verdict) => record.outcome = verdict,
                    None => self.use_reading(record, observation, shown.0),
                }
            }
        })
    }

    fn save(&self) -> Vec<u8> {
        let Self { model, history_s: _, newest, last, far_ahead } = self;
        let model = match model {
            ThermometerModel::Exact(exact) => {
                SavedModel::Exact { filter: Box::new(exact.filter.saved()), change_detector: exact.change_detector }
            }
            ThermometerModel::Learning { predictor, origin } => {
                SavedModel::Learning { predictor: predictor.saved(), origin: *origin }
            }
        };
        saved::to_bytes(&SavedThermometer { model, newest: *newest, last: *last, far_ahead: *far_ahead })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        let SavedThermometer { model, newest, last, far_ahead } = saved::from_bytes(saved)?;
        match (&mut self.model, model) {
            (ThermometerModel::Exact(exact), SavedModel::Exact { filter, change_detector }) => {
                exact.filter.set_saved(&filter);
                exact.change_detector = change_detector;
            }
            (
                ThermometerModel::Learning { predictor, origin },
                SavedModel::Learning { predictor: saved, origin: saved_origin },
            ) => {
                **predictor = predictor.with_saved(saved)?;
                *origin = saved_origin;
            }
            (ThermometerModel::Exact(_), SavedModel::Learning { .. })
            | (ThermometerModel::Learning { .. }, SavedModel::Exact { .. }) => {
                return Err(RestoreError::Implausible("it knows its thermometer otherwise"));
            }
        }
        self.newest = newest;
        self.last = last;
        self.far_ahead = far_ahead;
        Ok(())
    }

    /// Restarts, because the length of the break is unknown; keeps the learned noise.
    fn restart_clock(&mut self) {
        match &mut self.model {
            ThermometerModel::Exact(exact) => {
                exact.filter.restart_clock();
                exact.change_detector.restart();
            }
            ThermometerModel::Learning { predictor, origin } => {
                predictor.restart();
                *origin = None;
            }
        }
        self.newest = None;
        self.last = None;
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.last
    }

    /// The final value for an instant, in degrees Celsius; for a constant all that was seen counts for every instant.
    fn scalar_at(&self, stamp: Timestamp<BrickClock>) -> Option<ScalarEstimate> {
        if (stamp - self.last?).as_secs_f64() < -self.history_s {
            return None;
        }
        let settled = match &self.model {
            ThermometerModel::Exact(exact) => {
                let estimate = exact.filter.scalar_at(stamp)?;
                let inflation = exact.change_detector.inflation();
                MeanVariance { mean: estimate.value, variance: inflation * estimate.sigma * estimate.sigma }
            }
            ThermometerModel::Learning { predictor, .. } => predictor.final_value()?,
        };
        Some(ScalarEstimate {
            stamp,
            value: settled.mean,
            sigma: settled.variance.max(0.0).sqrt(),
            rate_per_s: 0.0,
            unit: "°C",
        })
    }
}
