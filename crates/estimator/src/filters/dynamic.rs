//! Dynamic measurement: the final value of a slow sensor with known dynamics, known long before the sensor shows it.
//!
//! ```text
//! X = [u; x]     F = blkdiag(1, e^(A dt))     H = [G, C]     Q by the walk of u     R = sigma^2
//! start, with the first sample y of a sensor:  u = y / G,  x = 0,  P = (1e5 sigma)^2 I, then that sample is used like any other
//! ```
//! With q = 0 this is recursive least squares for u and the initial states. There is no gate: paper 2 has none, and a
//! wrong model would lock it.
//!
//! Source: Paper 2 (Markovsky); docs/lab/thermometer.md.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{
    BrickClock, FusionOutcome, FusionRecord, Observation, ObservationKind, ScalarEstimate, SensorId, Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::filter::{Filter, FilterConfig};
use crate::models::dynamic_measurement::{DynamicModel, MAX_STATES, QUANTITY, ROWS};
use crate::numerics::covariance::symmetrise;
use crate::saved::{self, RestoreError, covariance, finite};
use crate::update::{ScalarMeasurement, UpdateOutcome, use_scalar};
use crate::validation::{self, add_innovation};

/// Large enough to weigh almost nothing against two samples, small enough to keep ten digits of P.
const PRIOR_SIGMAS: f64 = 1e5;
/// Noise where the robot's file gives none: half a last digit of a thermometer with sixteen steps per kelvin.
pub(super) const DEFAULT_SIGMA_K: f64 = 0.03;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct State {
    stamp: Timestamp<BrickClock>,
    #[serde(deserialize_with = "finite")]
    mean: SVector<f64, ROWS>,
    #[serde(deserialize_with = "covariance")]
    covariance: SMatrix<f64, ROWS, ROWS>,
}

pub struct DynamicFilter {
    model: DynamicModel,
    sigma: f64,
    prior_sigma: f64,
    random_walk_per_sqrt_s: f64,
    history_s: f64,
    state: Option<State>,
    /// The last sample of each sensor, at most one per state.
    last_samples: [Option<(SensorId, Timestamp<BrickClock>)>; MAX_STATES],
}

/// A filter of dynamic measurement without its configuration.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedDynamic {
    state: Option<State>,
    last_samples: [Option<(SensorId, Timestamp<BrickClock>)>; MAX_STATES],
}

impl DynamicFilter {
    pub(super) const fn saved(&self) -> SavedDynamic {
        let Self { model: _, sigma: _, prior_sigma: _, random_walk_per_sqrt_s: _, history_s: _, state, last_samples } =
            self;
        SavedDynamic { state: *state, last_samples: *last_samples }
    }

    pub(super) const fn set_saved(&mut self, saved: &SavedDynamic) {
        SavedDynamic { state: self.state, last_samples: self.last_samples } = *saved;
    }

    /// One thermometer, [`SensorId::THERMOMETER`], of first order; ignores all temperatures if `dynamic_tau_s` is not
    /// positive.
    pub fn new(config: &FilterConfig) -> Self {
        let tau_s = config.params.dynamic_tau_s;
        let model = DynamicModel::first_order(SensorId::THERMOMETER, tau_s).unwrap_or_else(|_| DynamicModel::empty());
        Self::with_model(config, model)
    }

    /// For any model: several sensors, of any order. Noise, walk and history come from the configuration.
    pub fn with_model(config: &FilterConfig, model: DynamicModel) -> Self {
        let sigma = config.noise.temperature_k;
        let sigma = if sigma > 0.0 { sigma } else { DEFAULT_SIGMA_K };
        Self {
            model,
            sigma,
            prior_sigma: PRIOR_SIGMAS * sigma,
            random_walk_per_sqrt_s: config.params.dynamic_walk_k_per_sqrt_s,
            history_s: config.params.history_s,
            state: None,
            last_samples: [None; MAX_STATES],
        }
    }

    /// One standard deviation of the quantity around the first sample, and of each state around zero, if positive and
    /// finite.
    pub fn with_prior_sigma(mut self, sigma: f64) -> Self {
        if sigma > 0.0 && sigma.is_finite() {
            self.prior_sigma = sigma;
        }
        self
    }

    /// The expected sample of a sensor and its variance, noise included; `None` before the first, and for an unknown
    /// sensor.
    pub fn expected(&self, sensor: SensorId, stamp: Timestamp<BrickClock>) -> Option<(f64, f64)> {
        let row = self.model.row_of(sensor)?;
        let state = self.predict_state(self.state?, stamp);
        let by_row = SVector::from(self.propagate_row_back(&row, (stamp - state.stamp).as_secs_f64()));
        let mean = by_row.dot(&state.mean);
        let variance = (state.covariance * by_row).dot(&by_row) + self.sigma * self.sigma;
        Some((mean, variance))
    }

    fn use_sample(&mut self, record: &mut FusionRecord, observation: &Observation, y: f64) {
        let Some(row) = self.model.row_of(observation.sensor) else {
            record.outcome = FusionOutcome::Unused;
            return;
        };
        if let Some(verdict) = self.reject_repeated(observation) {
            record.outcome = verdict;
            return;
        }
        let mut state = self.state.map_or_else(
            || self.initial_state(observation.stamp, y / row[QUANTITY]),
            |state| self.predict_state(state, observation.stamp),
        );
        // A late sensor's stamp lies before the state's instant: its row is led back to it.
        let by_row = self.propagate_row_back(&row, (observation.stamp - state.stamp).as_secs_f64());
        let predicted: f64 = (0..ROWS).map(|i| by_row[i] * state.mean[i]).sum();
        let scalar = ScalarMeasurement {
            innovation: y - predicted,
            rows: std::array::from_fn(|i| i),
            jacobian: by_row,
            variance: self.sigma * self.sigma,
        };
        let outcome = use_scalar(&mut state.mean, &mut state.covariance, &scalar, f64::INFINITY);
        if outcome.outcome != UpdateOutcome::Used {
            // The row led back over many time constants is beyond all numbers: nothing is left to learn from it.
            record.outcome = FusionOutcome::TooOld;
            return;
        }
        add_innovation(record, scalar.innovation, &outcome);
        record.outcome = FusionOutcome::Accepted;
        self.state = Some(state);
        self.record_sample(observation);
    }

    /// Paper 2's start: the quantity at the first sample, the states at zero, both almost unknown.
    fn initial_state(&self, stamp: Timestamp<BrickClock>, quantity: f64) -> State {
        let variance = self.prior_sigma.powi(2);
        let mut state = State { stamp, mean: SVector::zeros(), covariance: SMatrix::zeros() };
        state.mean[QUANTITY] = quantity;
        for row in 0..=self.model.states() {
            state.covariance[(row, row)] = variance;
        }
        state
    }

    /// The state predicted to an instant; unchanged for one that is not ahead.
    fn predict_state(&self, mut state: State, to: Timestamp<BrickClock>) -> State {
        let dt_s = (to - state.stamp).as_secs_f64();
        if dt_s <= 0.0 {
            return state;
        }
        let f = self.model.transition(dt_s);
        state.stamp = to;
        state.mean = f * state.mean;
        state.covariance = f * state.covariance * f.transpose();
        if self.random_walk_per_sqrt_s > 0.0 {
            state.covariance += self.model.random_walk_noise(dt_s) * self.random_walk_per_sqrt_s.powi(2);
        }
        symmetrise(&mut state.covariance);
        state
    }

    fn propagate_row_back(&self, row: &[f64; ROWS], lead_s: f64) -> [f64; ROWS] {
        if lead_s >= 0.0 {
            return *row;
        }
        let back = self.model.transition(lead_s);
        std::array::from_fn(|column| (0..ROWS).map(|i| row[i] * back[(i, column)]).sum())
    }

    fn reject_repeated(&self, observation: &Observation) -> Option<FusionOutcome> {
        let (_, last) = self.last_samples.iter().flatten().find(|(sensor, _)| *sensor == observation.sensor)?;
        validation::reject_repeated(Some(*last), observation.stamp)
    }

    fn record_sample(&mut self, observation: &Observation) {
        let slot =
            self.last_samples.iter_mut().find(|slot| slot.is_none_or(|(sensor, _)| sensor == observation.sensor));
        if let Some(slot) = slot {
            *slot = Some((observation.sensor, observation.stamp));
        }
    }
}

impl Filter for DynamicFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        validation::observe_if_valid(observation, self.latest_time(), self.history_s, |record| {
            if let ObservationKind::Temperature(temperature) = observation.measurement {
                self.use_sample(record, observation, temperature.0);
            }
        })
    }

    fn save(&self) -> Vec<u8> {
        saved::to_bytes(&self.saved())
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        self.set_saved(&saved::from_bytes(saved)?);
        Ok(())
    }

    /// Restarts without a state: the length of the break is unknown, and the sensor went on.
    fn restart_clock(&mut self) {
        self.state = None;
        self.last_samples = [None; MAX_STATES];
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.state.map(|state| state.stamp)
    }

    /// The predicted final value, in degrees Celsius. For a constant all that was seen counts for every instant.
    fn scalar_at(&self, stamp: Timestamp<BrickClock>) -> Option<ScalarEstimate> {
        let state = self.state?;
        let ahead_s = (stamp - state.stamp).as_secs_f64();
        if ahead_s < -self.history_s {
            return None;
        }
        let walked = self.random_walk_per_sqrt_s.powi(2) * ahead_s.abs();
        let variance = state.covariance[(QUANTITY, QUANTITY)].max(0.0) + walked;
        Some(ScalarEstimate {
            stamp, value: state.mean[QUANTITY], sigma: variance.sqrt(), rate_per_s: 0.0, unit: "°C"
        })
    }
}
