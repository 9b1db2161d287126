//! Dynamic measurement: the final value of a slow sensor, known long before the sensor shows it.
//!
//! Gets temperatures, gives the temperature of what the thermometer is dipped into. The sensor's dynamics are known
//! ([`DynamicModel`]); its initial state is not, and is estimated together with the input.
//!
//! # Model
//! ```text
//! X = [u; x]     F = blkdiag(1, e^(A dt))     H = [G, C]     Q by the walk of u     R = sigma^2
//! start, with the first sample y of a sensor:  u = y / G,  x = 0,  P = (1e5 sigma)^2 I, then that sample is used like any other
//! ```
//! With q = 0 this is recursive least squares for u and the initial states, and so block least squares.
//!
//! # Assumptions
//! The dynamics are right and the input is constant (or walks, with `dynamic_walk`). A trend or a wrong time constant is not
//! seen in the sigma that it gives. There is no gate: paper 2 has none, and a wrong model would lock it.
//!
//! # Sources
//! Paper 2 (Markovsky); docs/maths/paper2.md.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{
    BrickClock, Estimate, FusionRecord, Observation, Observed, ScalarEstimate, SensorId, Stamp, Verdict,
};

use super::intake;
use super::records::{add_innovation, verdict_without_pose};
use super::{Filter, FilterConfig, StartPose};
use crate::models::dynamic_measurement::{DynamicModel, MAX_STATES, QUANTITY, ROWS};
use crate::update::{Scalar, Usage, symmetrise, use_scalar};

/// Large enough to weigh next to nothing against two samples, small enough to leave ten digits of P.
const PRIOR_SIGMAS: f64 = 1e5;
/// Half a last digit of a thermometer with sixteen steps per kelvin: what is taken where the robot's file gives no noise.
const DEFAULT_SIGMA_K: f64 = 0.03;

#[derive(Clone, Copy, Debug)]
struct State {
    stamp: Stamp<BrickClock>,
    mean: SVector<f64, ROWS>,
    covariance: SMatrix<f64, ROWS, ROWS>,
}

/// The dynamic measurement filter.
pub struct DynamicFilter {
    model: DynamicModel,
    sigma: f64,
    prior_sigma: f64,
    walk_per_sqrt_s: f64,
    history_s: f64,
    state: Option<State>,
    /// The last sample of each sensor, at most one per state.
    last_samples: [Option<(SensorId, Stamp<BrickClock>)>; MAX_STATES],
}

impl DynamicFilter {
    /// One thermometer, [`SensorId::THERMOMETER`], of first order with the time constant `dynamic_tau_s`. A time constant that
    /// is not positive ([`crate::Params::set`] lets none in) makes a filter that has no use for any temperature.
    #[must_use]
    pub fn new(config: &FilterConfig) -> Self {
        let tau_s = config.params.dynamic_tau_s;
        let model = DynamicModel::first_order(SensorId::THERMOMETER, tau_s).unwrap_or_else(|_| DynamicModel::empty());
        Self::with_model(config, model)
    }

    /// Any model: several sensors, of any order. Noise, walk and history come from the configuration.
    #[must_use]
    pub fn with_model(config: &FilterConfig, model: DynamicModel) -> Self {
        let sigma = config.noise.temperature_k;
        let sigma = if sigma > 0.0 { sigma } else { DEFAULT_SIGMA_K };
        Self {
            model,
            sigma,
            prior_sigma: PRIOR_SIGMAS * sigma,
            walk_per_sqrt_s: config.params.dynamic_walk_k_per_sqrt_s,
            history_s: config.params.history_s,
            state: None,
            last_samples: [None; MAX_STATES],
        }
    }

    /// Starts with another doubt than next to no knowledge: one standard deviation of the quantity and of each state, around the
    /// first sample and around zero. Values that are not positive and finite change nothing.
    #[must_use]
    pub fn with_prior_sigma(mut self, sigma: f64) -> Self {
        if sigma > 0.0 && sigma.is_finite() {
            self.prior_sigma = sigma;
        }
        self
    }

    /// What a sensor should show at an instant, and how far a sample may be off, its noise included (one standard deviation squared);
    /// `None` before the first sample and for a sensor that the model does not know.
    #[must_use]
    pub fn expected(&self, sensor: SensorId, stamp: Stamp<BrickClock>) -> Option<(f64, f64)> {
        let row = self.model.row_of(sensor)?;
        let state = self.predicted(self.state?, stamp);
        let by_row = SVector::from(self.led_back(&row, (stamp - state.stamp).as_secs_f64()));
        let mean = by_row.dot(&state.mean);
        let variance = (state.covariance * by_row).dot(&by_row) + self.sigma * self.sigma;
        Some((mean, variance))
    }

    fn use_sample(&mut self, record: &mut FusionRecord, observation: &Observation, y: f64) {
        let Some(row) = self.model.row_of(observation.sensor) else {
            record.verdict = Verdict::Unused;
            return;
        };
        if let Some(verdict) = self.refuse_repeated(observation) {
            record.verdict = verdict;
            return;
        }
        let mut state = self.state.map_or_else(
            || self.started(observation.stamp, y / row[QUANTITY]),
            |state| self.predicted(state, observation.stamp),
        );
        // A sensor that is late speaks of an instant before the state's: its row is led back to it.
        let by_row = self.led_back(&row, (observation.stamp - state.stamp).as_secs_f64());
        let predicted: f64 = (0..ROWS).map(|i| by_row[i] * state.mean[i]).sum();
        let scalar = Scalar {
            innovation: y - predicted,
            rows: std::array::from_fn(|i| i),
            by_row,
            variance: self.sigma * self.sigma,
        };
        let outcome = use_scalar(&mut state.mean, &mut state.covariance, &scalar, f64::INFINITY);
        if outcome.usage != Usage::Used {
            // The row led back over many time constants is beyond all numbers: nothing is left to learn from it.
            record.verdict = Verdict::TooOld;
            return;
        }
        add_innovation(record, scalar.innovation, &outcome);
        record.verdict = Verdict::Accepted;
        self.state = Some(state);
        self.remember(observation);
    }

    /// Paper 2's start: the first sample for the quantity, nothing for the states, and next to no trust in either.
    fn started(&self, stamp: Stamp<BrickClock>, quantity: f64) -> State {
        let variance = self.prior_sigma.powi(2);
        let mut state = State { stamp, mean: SVector::zeros(), covariance: SMatrix::zeros() };
        state.mean[QUANTITY] = quantity;
        for row in 0..=self.model.states() {
            state.covariance[(row, row)] = variance;
        }
        state
    }

    /// The state carried on to an instant; unchanged for one that is not ahead.
    fn predicted(&self, mut state: State, to: Stamp<BrickClock>) -> State {
        let dt_s = (to - state.stamp).as_secs_f64();
        if dt_s <= 0.0 {
            return state;
        }
        let f = self.model.transition(dt_s);
        state.stamp = to;
        state.mean = f * state.mean;
        state.covariance = f * state.covariance * f.transpose();
        if self.walk_per_sqrt_s > 0.0 {
            state.covariance += self.model.walk_noise(dt_s) * self.walk_per_sqrt_s.powi(2);
        }
        symmetrise(&mut state.covariance);
        state
    }

    fn led_back(&self, row: &[f64; ROWS], lead_s: f64) -> [f64; ROWS] {
        if lead_s >= 0.0 {
            return *row;
        }
        let back = self.model.transition(lead_s);
        std::array::from_fn(|column| (0..ROWS).map(|i| row[i] * back[(i, column)]).sum())
    }

    /// Each sensor's samples are used in their order and once.
    fn refuse_repeated(&self, observation: &Observation) -> Option<Verdict> {
        let (_, last) = self.last_samples.iter().flatten().find(|(sensor, _)| *sensor == observation.sensor)?;
        intake::refuse_repeated(Some(*last), observation.stamp)
    }

    fn remember(&mut self, observation: &Observation) {
        let slot =
            self.last_samples.iter_mut().find(|slot| slot.is_none_or(|(sensor, _)| sensor == observation.sensor));
        if let Some(slot) = slot {
            *slot = Some((observation.sensor, observation.stamp));
        }
    }
}

impl Filter for DynamicFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let latest = self.latest();
        let lag = intake::lag_of(observation, latest);
        let mut record = intake::bare_record(observation, lag, Verdict::Unused);
        if let Some(verdict) = intake::refuse_outright(observation, latest, self.history_s) {
            record.verdict = verdict;
        } else if let Observed::Temperature(temperature) = observation.observed {
            self.use_sample(&mut record, observation, temperature.0);
        }
        record
    }

    /// A thermometer has no pose: [`Verdict::Unused`], or [`Verdict::Malformed`] for a pose that cannot be.
    fn set_pose(&mut self, start: &StartPose) -> Verdict {
        verdict_without_pose(start)
    }

    /// How long the break was is not known, and the sensor's state went on: it starts anew.
    fn restart_clock(&mut self) {
        self.state = None;
        self.last_samples = [None; MAX_STATES];
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.state.map(|state| state.stamp)
    }

    fn estimate_at(&self, _: Stamp<BrickClock>) -> Option<Estimate> {
        None
    }

    /// The predicted final value, in degrees Celsius. For a constant all that was seen counts for every instant.
    fn scalar_at(&self, stamp: Stamp<BrickClock>) -> Option<ScalarEstimate> {
        let state = self.state?;
        let ahead_s = (stamp - state.stamp).as_secs_f64();
        if ahead_s < -self.history_s {
            return None;
        }
        let walked = self.walk_per_sqrt_s.powi(2) * ahead_s.abs();
        let variance = state.covariance[(QUANTITY, QUANTITY)].max(0.0) + walked;
        Some(ScalarEstimate {
            stamp, value: state.mean[QUANTITY], sigma: variance.sqrt(), rate_per_s: 0.0, unit: "°C"
        })
    }
}
