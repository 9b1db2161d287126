//! A thermometer in service, for hours: its final value, without the instant of immersion and, if need be, without its
//! time constant.
//!
//! The filter of paper 2 ([`super::dynamic`]) or, where no dynamics are given, all time constants at once
//! (`filter_bank`); both restart where the test in `change_detector` finds a new temperature. The bound is the sigma of
//! the final value times kappa of that test.
//!
//! Source: Paper 2 (Markovsky); docs/lab/thermometer.md, section M7.

mod change_detector;
mod filter_bank;

use posebridge_telemetry::{
    BrickClock, FusionOutcome, FusionRecord, Observation, ObservationKind, ScalarEstimate, SensorId, Timestamp,
};

use self::change_detector::{ChangeDetector, ReadingClass};
use self::filter_bank::{FilterBank, MeanVariance};
use super::dynamic::{DEFAULT_SIGMA_K, DynamicFilter};
use crate::filter::{Filter, FilterConfig};
use crate::models::dynamic_measurement::DynamicModel;
use crate::update::{ScalarOutcome, UpdateOutcome};
use crate::validation::{self, add_innovation};

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermometerSettings {
    /// The response of [`SensorId::THERMOMETER`]; `None` learns it from the readings.
    pub model: Option<DynamicModel>,
    /// Noise of a reading, one standard deviation; zero takes that of the robot's sensors.
    pub sigma_k: f64,
    /// The step of its displayed values; zero if fine. It counts as noise of a step over the root of twelve.
    pub resolution_k: f64,
}

pub struct Thermometer {
    model: ThermometerModel,
    change_detector: ChangeDetector,
    history_s: f64,
    last: Option<Timestamp<BrickClock>>,
}

enum ThermometerModel {
    Known(Box<DynamicFilter>),
    Learning { bank: Box<FilterBank>, origin: Option<Timestamp<BrickClock>> },
}

impl Thermometer {
    /// Walk and history come from the configuration, the noise too where the settings have none.
    pub fn new(config: &FilterConfig, settings: &ThermometerSettings) -> Self {
        let configured = [settings.sigma_k, config.noise.temperature_k];
        let sigma_k = configured.into_iter().find(|sigma| *sigma > 0.0);
        let rounding_k = settings.resolution_k.max(0.0) / 12.0_f64.sqrt();
        let sigma_k = sigma_k.unwrap_or(DEFAULT_SIGMA_K).hypot(rounding_k);
        let model = match &settings.model {
            Some(model) => {
                let mut config = config.clone();
                config.noise.temperature_k = sigma_k;
                ThermometerModel::Known(Box::new(DynamicFilter::with_model(&config, model.clone())))
            }
            None => ThermometerModel::Learning { bank: Box::new(FilterBank::new(sigma_k)), origin: None },
        };
        Self { model, change_detector: ChangeDetector::default(), history_s: config.params.history_s, last: None }
    }

    /// As of the last reading, in degrees Celsius; `None` before the first.
    pub fn final_value(&self) -> Option<ScalarEstimate> {
        self.scalar_at(self.last?)
    }

    fn use_reading(&mut self, record: &mut FusionRecord, observation: &Observation, shown: f64) {
        let expected = self.model.expected(observation.stamp);
        if let Some(expected) = expected {
            let innovation = shown - expected.mean;
            let nis = innovation * innovation / expected.variance;
            let outcome = UpdateOutcome::Used;
            add_innovation(record, innovation, &ScalarOutcome { innovation_variance: expected.variance, nis, outcome });
            match self.change_detector.classify(innovation / expected.variance.sqrt()) {
                ReadingClass::Expected => {}
                ReadingClass::Outlier => {
                    record.outcome = FusionOutcome::Gated;
                    return;
                }
                ReadingClass::StepChange => self.model.reset(),
            }
        }
        let is_new = expected.is_some() && !self.model.has_begun();
        let verdict = self.model.update(observation, shown, self.change_detector.inflation());
        record.outcome = verdict;
        if verdict == FusionOutcome::Accepted {
            self.last = Some(observation.stamp);
            if is_new {
                record.outcome = FusionOutcome::PoseReset;
            }
        }
    }
}

impl ThermometerModel {
    /// The expected reading at this instant; `None` before the first.
    fn expected(&mut self, stamp: Timestamp<BrickClock>) -> Option<MeanVariance> {
        match self {
            Self::Known(filter) => {
                let (mean, variance) = filter.expected(SensorId::THERMOMETER, stamp)?;
                Some(MeanVariance { mean, variance })
            }
            Self::Learning { bank, origin } => {
                let origin = (*origin)?;
                Some(bank.predict((stamp - origin).as_secs_f64()))
            }
        }
    }

    fn has_begun(&self) -> bool {
        match self {
            Self::Known(filter) => filter.latest_time().is_some(),
            Self::Learning { origin, .. } => origin.is_some(),
        }
    }

    fn reset(&mut self) {
        match self {
            Self::Known(filter) => filter.restart_clock(),
            Self::Learning { origin, .. } => *origin = None,
        }
    }

    /// Uses a reading of the instant that was predicted last.
    fn update(&mut self, observation: &Observation, shown: f64, inflation: f64) -> FusionOutcome {
        match self {
            Self::Known(filter) => filter.observe(observation).outcome,
            Self::Learning { bank, origin } => {
                if origin.is_none() {
                    *origin = Some(observation.stamp);
                    bank.restart(shown);
                    bank.predict(0.0);
                }
                bank.update(shown, inflation);
                FusionOutcome::Accepted
            }
        }
    }

    /// With the variance by the configured noise times `inflation`.
    fn final_value(&self, stamp: Timestamp<BrickClock>, inflation: f64) -> Option<MeanVariance> {
        match self {
            Self::Known(filter) => {
                let estimate = filter.scalar_at(stamp)?;
                Some(MeanVariance { mean: estimate.value, variance: inflation * estimate.sigma * estimate.sigma })
            }
            Self::Learning { bank, origin } => {
                (*origin)?;
                Some(bank.final_value(inflation))
            }
        }
    }
}

impl Filter for Thermometer {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        validation::observe_if_valid(observation, self.last, self.history_s, |record| {
            if let (ObservationKind::Temperature(shown), SensorId::THERMOMETER) =
                (observation.measurement, observation.sensor)
            {
                match validation::reject_repeated(self.last, observation.stamp) {
                    Some(verdict) => record.outcome = verdict,
                    None => self.use_reading(record, observation, shown.0),
                }
            }
        })
    }

    /// Restarts, because the length of the break is unknown; keeps the learned noise.
    fn restart_clock(&mut self) {
        self.model.reset();
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
        let settled = self.model.final_value(stamp, self.change_detector.inflation())?;
        Some(ScalarEstimate {
            stamp,
            value: settled.mean,
            sigma: settled.variance.max(0.0).sqrt(),
            rate_per_s: 0.0,
            unit: "°C",
        })
    }
}
