//! Predicts the final value of a slow sensor from its readings, for hours: at rest, during the approach to a new value,
//! and at rest again.
//!
//! ```text
//! at rest     expected reading  mean of the last readings, at most 256
//! step        the test in `change_detector` finds it; the bank starts at the reading before the deviation began
//! settled     after 6 slow time constants, once what is left was below half the noise for 8 readings: at rest again
//! bound       1.96 sigma kappa, where kappa^2 is the observed variance of the innovations over the expected one
//! no bound    before 8 readings at rest, and after one unlike them; while 1.96 sigma kappa is more than a third of the step and more than 4 sigma of
//!             the noise; before half a slow time constant, if that is unknown; with kappa > 2, where the model does not
//!             fit; or while a change without an end explains the readings as well
//! ```
//! Source: docs/lab/thermometer.md, section M7.

use std::collections::VecDeque;

use posebridge_telemetry::estimate::NORMAL_95;
use serde::{Deserialize, Serialize};

use super::change_detector::{ChangeDetector, ReadingClass};
use super::filter_bank::{FilterBank, MeanVariance, StepStart};
use crate::models::slow_sensor::{SensorDynamics, SlowLag};
use crate::saved::{RestoreError, finite};

/// A new step is found with this number of readings; a model that does not fit, with more. After that the needed part of a
/// lag doubles, until the sensor has settled.
const MAX_STEP_READINGS: usize = 4;
/// Half a lag doubled six times: such a sensor says nothing before it has settled.
const MAX_MISFITS: i32 = 6;
/// Readings whose mean is the level at rest. More would follow a slow change too late, fewer would follow it and not
/// show it.
const REST_READINGS: usize = 256;
/// Readings before a step whose mean is its start.
const START_READINGS: usize = 16;
/// With fewer readings a sensor at rest and a slow one that moves look alike.
const MIN_REST_READINGS: usize = 8;
/// A four-hundredth of the slow part of a step is left.
const SETTLED_LAGS: f64 = 6.0;
/// Share of the noise below which nothing is left of a step.
const SETTLED_SIGMAS: f64 = 0.5;
/// A sensor of unknown lags has to show this part of its slow time constant: else a slow change without an end looks like
/// the beginning of a large step.
const MIN_SHOWN_LAGS: f64 = 0.5;
/// As likely as the bound is to miss the end.
const MAX_DRIFT_PROBABILITY: f64 = 0.05;
/// Largest half-width of a bound as a share of the step.
const MAX_BOUND_SHARE: f64 = 1.0 / 3.0;
/// A bound of this many sigmas of the noise says enough about any step.
const MAX_BOUND_SIGMAS: f64 = 4.0;
/// Largest ratio of the observed and the expected standard deviation of the innovations.
const MAX_INFLATION: f64 = 2.0;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct TimedReading {
    #[serde(deserialize_with = "finite")]
    at_s: f64,
    #[serde(deserialize_with = "finite")]
    value: f64,
    /// Not used, but perhaps the first of a step.
    is_outlier: bool,
}

#[derive(Clone, Debug)]
pub struct EndPredictor {
    dynamics: SensorDynamics,
    sigma: f64,
    change_detector: ChangeDetector,
    /// The latest readings, oldest first, at most 256: at rest those of the level, else those since the step began.
    recent: VecDeque<TimedReading>,
    approach: Option<Approach>,
    /// Number of approaches in a row that the readings left slowly.
    misfits: i32,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Approach {
    bank: FilterBank,
    #[serde(deserialize_with = "finite")]
    started_at_s: f64,
    /// Number of the latest readings of which nothing was left of the step.
    settled_readings: usize,
}

/// How a reading compares with what was expected of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingReport {
    pub class: ReadingClass,
    /// `None` for the first reading.
    pub expected: Option<MeanVariance>,
}

/// A predictor without what is known of its sensor.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedPredictor {
    change_detector: ChangeDetector,
    recent: VecDeque<TimedReading>,
    approach: Option<Approach>,
    misfits: i32,
}

impl EndPredictor {
    pub(super) fn saved(&self) -> SavedPredictor {
        let Self { dynamics: _, sigma: _, change_detector, recent, approach, misfits } = self;
        let (recent, approach) = (recent.clone(), approach.clone());
        SavedPredictor { change_detector: *change_detector, recent, approach, misfits: *misfits }
    }

    /// This predictor with what another one of the same sensor has seen.
    pub(super) fn with_saved(&self, saved: SavedPredictor) -> Result<Self, RestoreError> {
        let SavedPredictor { change_detector, recent, approach, misfits } = saved;
        (recent.len() <= REST_READINGS)
            .then_some(())
            .ok_or(RestoreError::Implausible("a thermometer in it has too many readings"))?;
        let is_sound = approach.as_ref().is_none_or(|approach| approach.bank.is_sound() && !recent.is_empty());
        (is_sound && (0..=MAX_MISFITS).contains(&misfits))
            .then_some(())
            .ok_or(RestoreError::Implausible("a thermometer in it has numbers that cannot be"))?;
        Ok(Self { dynamics: self.dynamics, sigma: self.sigma, change_detector, recent, approach, misfits })
    }

    /// `sigma` is the noise of a reading, with what rounding adds; positive, in the unit of the readings.
    pub fn new(dynamics: SensorDynamics, sigma: f64) -> Self {
        Self {
            dynamics,
            sigma,
            change_detector: ChangeDetector::default(),
            recent: VecDeque::with_capacity(REST_READINGS),
            approach: None,
            misfits: 0,
        }
    }

    /// Uses a reading. Times are in seconds and rise.
    pub fn observe(&mut self, at_s: f64, value: f64) -> ReadingReport {
        let expected = self.expected(at_s);
        let class = expected.map_or(ReadingClass::Expected, |expected| {
            self.change_detector.classify((value - expected.mean) / expected.variance.sqrt())
        });
        self.remember(TimedReading { at_s, value, is_outlier: class == ReadingClass::Outlier });
        match class {
            ReadingClass::Expected => self.use_expected(value),
            ReadingClass::Outlier => {}
            ReadingClass::StepChange { readings } => self.start_approach(readings),
        }
        ReadingReport { class, expected }
    }

    /// Forgets all readings, but not how noisy they are.
    pub fn restart(&mut self) {
        self.recent.clear();
        self.approach = None;
        self.misfits = 0;
        self.change_detector.restart();
    }

    /// Whether a step was found that has not yet ended.
    pub const fn is_settling(&self) -> bool {
        self.approach.is_some()
    }

    /// The final value; `None` where the readings do not tell it yet, or contradict the model.
    pub fn final_value(&self) -> Option<MeanVariance> {
        let inflation = self.change_detector.inflation();
        let Some(approach) = &self.approach else {
            let level = self.level()?;
            let variance = inflation * self.sigma * self.sigma;
            let rest_readings = self.recent.iter().filter(|reading| !reading.is_outlier).count();
            let is_told = rest_readings >= MIN_REST_READINGS && !self.may_have_begun_to_move();
            return is_told.then_some(MeanVariance { mean: level.mean, variance });
        };
        let found = approach.bank.final_value();
        let variance = inflation * found.variance;
        let half_width = NORMAL_95 * variance.sqrt();
        let limit = (MAX_BOUND_SHARE * approach.bank.step().abs()).max(MAX_BOUND_SIGMAS * self.sigma);
        let are_lags_known = self.dynamics.slow_lag != SlowLag::Unknown && self.misfits == 0;
        let needed_lags = MIN_SHOWN_LAGS * 2.0_f64.powi(self.misfits);
        let are_lags_shown = are_lags_known || approach.bank.elapsed_lags() >= needed_lags;
        let settles = approach.bank.drift_probability() < MAX_DRIFT_PROBABILITY;
        let is_told = settles && are_lags_shown && half_width <= limit && inflation.sqrt() <= MAX_INFLATION;
        is_told.then_some(MeanVariance { mean: found.mean, variance })
    }

    /// Whether the latest reading is unlike the level: damaged, or the first of a step.
    fn may_have_begun_to_move(&self) -> bool {
        self.recent.back().is_some_and(|latest| latest.is_outlier)
    }

    /// The expected reading at an instant, with its noise; `None` before the first.
    fn expected(&mut self, at_s: f64) -> Option<MeanVariance> {
        let noise_variance = self.sigma * self.sigma;
        if let Some(approach) = &mut self.approach {
            return Some(approach.bank.predict(at_s - approach.started_at_s, noise_variance));
        }
        let level = self.level()?;
        Some(MeanVariance { mean: level.mean, variance: level.variance + noise_variance })
    }

    /// At rest.
    fn level(&self) -> Option<MeanVariance> {
        mean_of(self.recent.iter().filter(|reading| !reading.is_outlier), self.sigma)
    }

    fn remember(&mut self, reading: TimedReading) {
        if self.recent.len() == REST_READINGS {
            self.recent.pop_front();
        }
        self.recent.push_back(reading);
    }

    fn use_expected(&mut self, value: f64) {
        let noise_variance = self.sigma * self.sigma;
        let Some(approach) = &mut self.approach else { return };
        let bank = &mut approach.bank;
        bank.update(value, noise_variance);
        let is_settled = bank.elapsed_lags() > SETTLED_LAGS && bank.remainder().abs() < SETTLED_SIGMAS * self.sigma;
        approach.settled_readings = if is_settled { approach.settled_readings.saturating_add(1) } else { 0 };
        // Older readings are still those of the step.
        let (settled_readings, is_lost) = (approach.settled_readings, bank.is_empty());
        if is_lost || settled_readings >= MIN_REST_READINGS {
            self.approach = None;
            self.misfits = 0;
            self.keep_last(settled_readings.max(1));
        }
    }

    /// The step began before the last `readings` readings.
    fn start_approach(&mut self, readings: usize) {
        let split = self.recent.len().saturating_sub(readings).max(1);
        let is_at_rest = self.approach.is_none();
        if !is_at_rest && readings > MAX_STEP_READINGS {
            self.misfits = (self.misfits + 1).min(MAX_MISFITS);
        }
        // In the middle of another approach only the last reading before the step says where the sensor was.
        let start_count = if is_at_rest { START_READINGS } else { 1 };
        let before = self.recent.range(..split).rev().filter(|reading| !reading.is_outlier).take(start_count);
        let (Some(level), Some(last)) = (mean_of(before, self.sigma), self.recent.get(split - 1)) else { return };
        let started_at_s = last.at_s;
        self.keep_last(self.recent.len() - split);
        for reading in &mut self.recent {
            reading.is_outlier = false;
        }
        let Some(latest) = self.recent.back() else { return };
        let start = StepStart { level, change: latest.value - level.mean, duration_s: latest.at_s - started_at_s };
        let mut bank = FilterBank::new(&self.dynamics, &start, self.sigma);
        let noise_variance = self.sigma * self.sigma;
        for reading in &self.recent {
            bank.predict(reading.at_s - started_at_s, noise_variance);
            bank.update(reading.value, noise_variance);
        }
        self.approach = (!bank.is_empty()).then_some(Approach { bank, started_at_s, settled_readings: 0 });
    }

    fn keep_last(&mut self, count: usize) {
        let surplus = self.recent.len().saturating_sub(count);
        self.recent.drain(..surplus);
    }
}

fn mean_of<'a>(readings: impl Iterator<Item = &'a TimedReading>, sigma: f64) -> Option<MeanVariance> {
    let (mut count, mut sum) = (0.0, 0.0);
    for reading in readings {
        count += 1.0;
        sum += reading.value;
    }
    (count > 0.0).then(|| MeanVariance { mean: sum / count, variance: sigma * sigma / count })
}
