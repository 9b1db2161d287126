//! A thermometer live: what it will show in the end, without being told when it was dipped in or, if need be, how slow it is.
//!
//! Gets temperatures as they come, for hours. [`super::dynamic`] answers for one approach to one constant temperature, with dynamics
//! that are given; here stands what it takes to leave it running: dynamics that are learnt where none are given
//! (`bank`), and a test that finds where a new approach begins and lets damaged readings pass (`surprise`).
//!
//! # Model
//! ```text
//! dynamics given     the filter of paper 2, begun anew at every break
//! none given         all time constants at once, begun anew at every break
//! bound              sigma of the final value, times kappa of the surprise test
//! ```
//! # Assumptions
//! Between two breaks the temperature is constant. What drifts more slowly than the test sees is followed with a lag, by breaks.
//!
//! # Sources
//! Paper 2 (Markovsky); docs/maths/paper2.md, section 7.

mod bank;
mod surprise;

use posebridge_telemetry::{
    BrickClock, Estimate, FusionRecord, Observation, Observed, ScalarEstimate, SensorId, Stamp, Verdict,
};

use self::bank::{Bank, Moments};
use self::surprise::{Judgement, Surprise};
use super::dynamic::DynamicFilter;
use super::intake;
use super::records::{add_innovation, verdict_without_pose};
use super::{Filter, FilterConfig, StartPose};
use crate::models::dynamic_measurement::DynamicModel;
use crate::update::{ScalarOutcome, Usage};

/// Half a last digit of a thermometer with sixteen steps per kelvin: what is taken where no noise is given.
const DEFAULT_SIGMA_K: f64 = 0.03;

/// What is known of a thermometer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermometerSettings {
    /// How [`SensorId::THERMOMETER`] follows the temperature; `None` lets it be learnt from the readings.
    pub model: Option<DynamicModel>,
    /// Noise of a reading, one standard deviation, in kelvin; zero takes that of the robot's sensors.
    pub sigma_k: f64,
    /// The step between two values that it can show, in kelvin; zero if fine. It counts as noise of a step over the root of twelve.
    pub resolution_k: f64,
}

/// Predicts the final value of one thermometer, reading by reading.
pub struct Thermometer {
    core: Core,
    surprise: Surprise,
    history_s: f64,
    last: Option<Stamp<BrickClock>>,
}

enum Core {
    Known(Box<DynamicFilter>),
    Learning {
        bank: Box<Bank>,
        /// When it began.
        origin: Option<Stamp<BrickClock>>,
    },
}

impl Thermometer {
    /// A thermometer that has not been read. Walk and history come from the configuration, the noise too where the settings have none.
    #[must_use]
    pub fn new(config: &FilterConfig, settings: &ThermometerSettings) -> Self {
        let given = [settings.sigma_k, config.noise.temperature_k];
        let sigma_k = given.into_iter().find(|sigma| *sigma > 0.0);
        let rounding_k = settings.resolution_k.max(0.0) / 12.0_f64.sqrt();
        let sigma_k = sigma_k.unwrap_or(DEFAULT_SIGMA_K).hypot(rounding_k);
        let core = match &settings.model {
            Some(model) => {
                let mut config = config.clone();
                config.noise.temperature_k = sigma_k;
                Core::Known(Box::new(DynamicFilter::with_model(&config, model.clone())))
            }
            None => Core::Learning { bank: Box::new(Bank::new(sigma_k)), origin: None },
        };
        Self { core, surprise: Surprise::default(), history_s: config.params.history_s, last: None }
    }

    /// What it will show in the end, as of its last reading, in degrees Celsius; `None` before the first.
    #[must_use]
    pub fn settled(&self) -> Option<ScalarEstimate> {
        self.scalar_at(self.last?)
    }

    fn use_reading(&mut self, record: &mut FusionRecord, observation: &Observation, shown: f64) {
        let expected = self.core.expected(observation.stamp);
        if let Some(expected) = expected {
            let innovation = shown - expected.mean;
            let outcome = outcome_of(innovation, expected.variance);
            add_innovation(record, innovation, &outcome);
            match self.surprise.judge(innovation / expected.variance.sqrt()) {
                Judgement::Expected => {}
                Judgement::Outlier => {
                    record.verdict = Verdict::Gated;
                    return;
                }
                Judgement::Break => self.core.forget(),
            }
        }
        let is_new = expected.is_some() && !self.core.has_begun();
        let verdict = self.core.take(observation, shown, self.surprise.inflation());
        record.verdict = verdict;
        if verdict == Verdict::Accepted {
            self.last = Some(observation.stamp);
            if is_new {
                record.verdict = Verdict::ResetTo;
            }
        }
    }
}

impl Core {
    /// What a reading of this instant should show; `None` before the first.
    fn expected(&mut self, stamp: Stamp<BrickClock>) -> Option<Moments> {
        match self {
            Self::Known(filter) => {
                let (mean, variance) = filter.expected(SensorId::THERMOMETER, stamp)?;
                Some(Moments { mean, variance })
            }
            Self::Learning { bank, origin } => {
                let origin = (*origin)?;
                Some(bank.expect((stamp - origin).as_secs_f64()))
            }
        }
    }

    fn has_begun(&self) -> bool {
        match self {
            Self::Known(filter) => filter.latest().is_some(),
            Self::Learning { origin, .. } => origin.is_some(),
        }
    }

    fn forget(&mut self) {
        match self {
            Self::Known(filter) => filter.restart_clock(),
            Self::Learning { origin, .. } => *origin = None,
        }
    }

    /// Uses a reading of the instant that was expected last.
    fn take(&mut self, observation: &Observation, shown: f64, inflation: f64) -> Verdict {
        match self {
            Self::Known(filter) => filter.observe(observation).verdict,
            Self::Learning { bank, origin } => {
                if origin.is_none() {
                    *origin = Some(observation.stamp);
                    bank.begin(shown);
                    bank.expect(0.0);
                }
                bank.take(shown, inflation);
                Verdict::Accepted
            }
        }
    }

    /// The final value with its variance as the configured noise makes it.
    fn settled(&self, stamp: Stamp<BrickClock>, inflation: f64) -> Option<Moments> {
        match self {
            Self::Known(filter) => {
                let estimate = filter.scalar_at(stamp)?;
                Some(Moments { mean: estimate.value, variance: inflation * estimate.sigma * estimate.sigma })
            }
            Self::Learning { bank, origin } => {
                (*origin)?;
                Some(bank.settled(inflation))
            }
        }
    }
}

fn outcome_of(innovation: f64, variance: f64) -> ScalarOutcome {
    ScalarOutcome { innovation_variance: variance, nis: innovation * innovation / variance, usage: Usage::Used }
}

impl Filter for Thermometer {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let lag = intake::lag_of(observation, self.last);
        let mut record = intake::bare_record(observation, lag, Verdict::Unused);
        let refused = intake::refuse_outright(observation, self.last, self.history_s);
        if let Some(verdict) = refused {
            record.verdict = verdict;
        } else if let (Observed::Temperature(shown), SensorId::THERMOMETER) = (observation.observed, observation.sensor)
        {
            match intake::refuse_repeated(self.last, observation.stamp) {
                Some(verdict) => record.verdict = verdict,
                None => self.use_reading(&mut record, observation, shown.0),
            }
        }
        record
    }

    /// A thermometer has no pose: [`Verdict::Unused`], or [`Verdict::Malformed`] for a pose that cannot be.
    fn set_pose(&mut self, start: &StartPose) -> Verdict {
        verdict_without_pose(start)
    }

    /// How long the break was is not known: it begins anew. What was learnt of the noise stays.
    fn restart_clock(&mut self) {
        self.core.forget();
        self.last = None;
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.last
    }

    fn estimate_at(&self, _: Stamp<BrickClock>) -> Option<Estimate> {
        None
    }

    /// The final value for an instant, in degrees Celsius; for a constant all that was seen counts for every instant.
    fn scalar_at(&self, stamp: Stamp<BrickClock>) -> Option<ScalarEstimate> {
        if (stamp - self.last?).as_secs_f64() < -self.history_s {
            return None;
        }
        let settled = self.core.settled(stamp, self.surprise.inflation())?;
        Some(ScalarEstimate {
            stamp,
            value: settled.mean,
            sigma: settled.variance.max(0.0).sqrt(),
            rate_per_s: 0.0,
            unit: "°C",
        })
    }
}
