//! The distance to a wall ahead, predicted by the drive train between the readings of a slow range sensor, and
//! filtered.
//!
//! ```text
//! x = [z, v]'    models::wall_approach       h(x) = z     H = [1 0]     R = sigma_z^2
//! u = d c        c the command, in m/s: the speed that the robot would settle at. PWM p is c = (p / 80) / d
//! start, with the first reading: x = [z, 0]', P = Sigma_u
//! gate: refused if |nu| > max(GATE_MIN, 3 sqrt S)
//! restart: with the third refused reading in a row, if it lies within the gate of the line through the two before, and with the
//! eighth in any case; x = [z, slope]', P = diag(sigma_z^2, 2 sigma_z^2 / dt^2) over the span of the three. Not in the paper.
//! ```
//! | | `range-kf`, as printed | `range-kf-corrected` |
//! |---|---|---|
//! | A, B | Euler's rule with the measured dt | exact for a held input |
//! | process noise | Sigma_u = diag(50 mm, 50 mm/s)^2 at every step, however short | that much per 7.6 ms, by its density |
//! | a reading within 50 ms of the last step | used as if made at that step | used at its own time, and the state carried there |
//!
//! Source: Paper 3 (Lab 7); docs/lab/wall.md.

use nalgebra::{Matrix2, Vector2};
use posebridge_telemetry::{
    BrickClock, FusionOutcome, FusionRecord, Observation, ObservationKind, ScalarEstimate, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::filter::{Filter, FilterConfig};
use crate::models::wall_approach::{DISTANCE, SPEED, WallApproachModel};
use crate::motion::TimeSeries;
use crate::numerics::covariance::symmetrise;
use crate::saved::{self, Numbers, RestoreError, covariance, finite};
use crate::update::{ScalarMeasurement, UpdateOutcome, use_scalar};
use crate::validation::{self, add_innovation};

/// The mean interval of the paper's loop, to which its process noise per step refers.
const PAPER_STEP_S: f64 = 0.0076;
/// The paper's Sigma_z is 20 mm; used where the robot's file gives no noise.
const PAPER_RANGE_SIGMA_M: f64 = 0.02;
/// The paper matches a reading and a step that are no further apart.
const MATCH_WINDOW: TimeDelta = TimeDelta::from_millis(50);
/// Longer steps than this are exact in both variants. The paper's are 7.6 ms.
const LONGEST_EULER_STEP_S: f64 = 0.1;
/// The same in time constants of the drive train: at one Euler's rule begins to oscillate, at two it is unstable.
const LONGEST_EULER_STEP: f64 = 1.0;
/// Three standard deviations, squared.
const GATE_NIS: f64 = 9.0;

/// Refused readings in a row that agree with each other: another wall, after a turn.
const AGREEING_REFUSALS: usize = 3;
/// Refused readings in a row after which the prediction is worth less than any reading.
const MOST_REFUSALS: usize = 8;
/// Largest standard deviation of the speed at a restart, m/s: of two readings that are close together the slope is noise.
const RESTART_SPEED_SIGMA_M_PER_S: f64 = 1.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RangeFilterVariant {
    Paper,
    /// Noise per second, exact hold, readings at their own time.
    Corrected,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct State {
    stamp: Timestamp<BrickClock>,
    #[serde(deserialize_with = "finite")]
    mean: Vector2<f64>,
    #[serde(deserialize_with = "covariance")]
    covariance: Matrix2<f64>,
    /// The command from here on, m/s.
    #[serde(deserialize_with = "finite")]
    command_m_per_s: f64,
}

pub struct RangeFilter {
    variant: RangeFilterVariant,
    model: WallApproachModel,
    range_var_m2: f64,
    process_var: f64,
    gate_min_m: f64,
    history_s: f64,
    /// `None` before the first reading.
    state: Option<State>,
    history: TimeSeries<State>,
    command: Option<Reading>,
    last_range: Option<Timestamp<BrickClock>>,
    /// The last two refused readings since one was used, the older one first.
    refused: [Option<Reading>; AGREEING_REFUSALS - 1],
    refusals: usize,
}

/// A range filter without its configuration.
#[derive(Serialize, Deserialize)]
struct SavedRangeFilter {
    state: Option<State>,
    history: TimeSeries<State>,
    command: Option<Reading>,
    last_range: Option<Timestamp<BrickClock>>,
    refused: [Option<Reading>; AGREEING_REFUSALS - 1],
    refusals: usize,
}

/// A command in m/s or a range in m, with its instant.
type Reading = (Timestamp<BrickClock>, f64);

impl RangeFilter {
    pub fn new(config: &FilterConfig, variant: RangeFilterVariant) -> Self {
        let params = &config.params;
        let sigma_m = config.noise.wall_range_m;
        let sigma_m = if sigma_m > 0.0 { sigma_m } else { PAPER_RANGE_SIGMA_M };
        Self {
            variant,
            model: WallApproachModel {
                drag_s_per_m: params.wall_drag_s_per_m,
                mass_s2_per_m: params.wall_mass_s2_per_m,
            },
            range_var_m2: sigma_m * sigma_m,
            process_var: params.wall_process_m.powi(2),
            gate_min_m: params.wall_gate_m,
            history_s: params.history_s,
            state: None,
            history: TimeSeries::default(),
            command: None,
            last_range: None,
            refused: [None; AGREEING_REFUSALS - 1],
            refusals: 0,
        }
    }

    /// The state predicted to an instant; unchanged for one that is not ahead.
    fn predict_state(&self, mut state: State, to: Timestamp<BrickClock>) -> State {
        let dt_s = (to - state.stamp).as_secs_f64();
        if dt_s <= 0.0 {
            return state;
        }
        let is_euler = self.variant == RangeFilterVariant::Paper
            && dt_s <= LONGEST_EULER_STEP_S
            && self.model.rate_per_s() * dt_s <= LONGEST_EULER_STEP;
        let step = if is_euler { self.model.euler(dt_s) } else { self.model.exact(dt_s) };
        let input = self.model.drag_s_per_m * state.command_m_per_s;
        state.stamp = to;
        state.mean = step.a * state.mean + step.b * input;
        state.covariance = step.a * state.covariance * step.a.transpose() + self.process_noise(dt_s);
        symmetrise(&mut state.covariance);
        state
    }

    fn process_noise(&self, dt_s: f64) -> Matrix2<f64> {
        match self.variant {
            RangeFilterVariant::Paper => Matrix2::from_diagonal_element(self.process_var),
            RangeFilterVariant::Corrected => {
                let density = self.process_var / PAPER_STEP_S;
                self.model.exact_noise(dt_s, density, density)
            }
        }
    }

    fn observe_command(&mut self, stamp: Timestamp<BrickClock>, command_m_per_s: f64) -> FusionOutcome {
        if let Some(verdict) = validation::reject_repeated(self.command.map(|(last, _)| last), stamp) {
            return verdict;
        }
        self.command = Some((stamp, command_m_per_s));
        if let Some(state) = self.state {
            let mut next = self.predict_state(state, stamp);
            next.command_m_per_s = command_m_per_s;
            self.save_state(next);
        }
        FusionOutcome::Accepted
    }

    fn observe_range(&mut self, record: &mut FusionRecord, stamp: Timestamp<BrickClock>, range_m: f64) {
        if let Some(verdict) = validation::reject_repeated(self.last_range, stamp) {
            record.outcome = verdict;
            return;
        }
        record.outcome = FusionOutcome::Accepted;
        let Some(state) = self.state else {
            self.last_range = Some(stamp);
            let first = self.initial_state(stamp, range_m);
            self.save_state(first);
            return;
        };
        let is_matched = self.variant == RangeFilterVariant::Paper && stamp - state.stamp <= MATCH_WINDOW;
        let mut next = if is_matched { state } else { self.predict_state(state, stamp) };
        let Some(scalar) = self.innovation(&next, stamp, range_m) else {
            record.outcome = FusionOutcome::TooOld;
            return;
        };
        let gate = self.gate_nis(&next, &scalar);
        let outcome = use_scalar(&mut next.mean, &mut next.covariance, &scalar, gate);
        add_innovation(record, scalar.innovation, &outcome);
        match outcome.outcome {
            UpdateOutcome::Used => {
                self.last_range = Some(stamp);
                self.forget_refusals();
                self.save_state(next);
            }
            UpdateOutcome::Gated => {
                let s_m2 = record.innovation_covariance[0][0];
                record.outcome = self.refuse((stamp, range_m), (gate * s_m2).sqrt());
                // A restart was not predicted: like the first reading it has no innovation.
                if record.outcome == FusionOutcome::Accepted {
                    record.degrees_of_freedom = 0;
                    record.nis = 0.0;
                }
            }
            UpdateOutcome::Indefinite => record.outcome = FusionOutcome::Malformed,
        }
    }

    /// Refuses a reading, or restarts with it: a gate that only ever refuses would follow a wall that is no longer ahead.
    fn refuse(&mut self, reading: (Timestamp<BrickClock>, f64), gate_m: f64) -> FusionOutcome {
        self.refusals = self.refusals.saturating_add(1);
        let (stamp, range_m) = reading;
        if let [Some((first, first_m)), Some((second, second_m))] = self.refused {
            let (between_s, since_s) = ((second - first).as_secs_f64(), (stamp - second).as_secs_f64());
            let expected_m = second_m + (second_m - first_m) * since_s / between_s;
            let is_agreed = between_s > 0.0 && since_s > 0.0 && (range_m - expected_m).abs() <= gate_m;
            if is_agreed || self.refusals >= MOST_REFUSALS {
                let span_s = (between_s + since_s).max(f64::MIN_POSITIVE);
                let speed_sigma = ((2.0 * self.range_var_m2).sqrt() / span_s).min(RESTART_SPEED_SIGMA_M_PER_S);
                let towards_m_per_s = if is_agreed { (first_m - range_m) / span_s } else { 0.0 };
                let mut next = self.initial_state(stamp, range_m);
                next.mean[SPEED] = towards_m_per_s;
                let speed_sigma = if is_agreed { speed_sigma } else { RESTART_SPEED_SIGMA_M_PER_S };
                next.covariance = Matrix2::from_diagonal(&Vector2::new(self.range_var_m2, speed_sigma * speed_sigma));
                self.last_range = Some(stamp);
                self.forget_refusals();
                self.save_state(next);
                return FusionOutcome::Accepted;
            }
        }
        self.refused = [self.refused[1], Some(reading)];
        FusionOutcome::Gated
    }

    fn forget_refusals(&mut self) {
        self.refused = [None; AGREEING_REFUSALS - 1];
        self.refusals = 0;
    }

    /// The innovation of a reading against a state that may be later; `None` when it is too late to be used.
    fn innovation(&self, state: &State, stamp: Timestamp<BrickClock>, range_m: f64) -> Option<ScalarMeasurement<2>> {
        let lag = (state.stamp - stamp).max(TimeDelta::ZERO);
        if lag > MATCH_WINDOW {
            return None;
        }
        let (mut by_row, mut predicted_m, mut variance) = ([1.0, 0.0], state.mean[DISTANCE], self.range_var_m2);
        if self.variant == RangeFilterVariant::Corrected && lag > TimeDelta::ZERO {
            let lag_s = lag.as_secs_f64();
            let back = self.model.exact(-lag_s);
            let then = back.a * state.mean + back.b * (self.model.drag_s_per_m * state.command_m_per_s);
            by_row = [back.a[(0, DISTANCE)], back.a[(0, SPEED)]];
            predicted_m = then[DISTANCE];
            variance += self.process_noise(lag_s)[(DISTANCE, DISTANCE)];
        }
        Some(ScalarMeasurement {
            innovation: range_m - predicted_m,
            rows: [DISTANCE, SPEED],
            jacobian: by_row,
            variance,
        })
    }

    /// The paper's gate as a bound of the NIS: nu^2 > max(GATE_MIN^2, 9 S).
    fn gate_nis(&self, state: &State, scalar: &ScalarMeasurement<2>) -> f64 {
        let h = Vector2::from(scalar.jacobian);
        let s = (h.transpose() * state.covariance * h)[0] + scalar.variance;
        (self.gate_min_m.powi(2) / s).max(GATE_NIS)
    }

    fn initial_state(&self, stamp: Timestamp<BrickClock>, range_m: f64) -> State {
        let (commanded, command_m_per_s) = self.command.unwrap_or((stamp, 0.0));
        State {
            stamp: stamp.max(commanded),
            mean: Vector2::new(range_m, 0.0),
            covariance: Matrix2::from_diagonal_element(self.process_var),
            command_m_per_s,
        }
    }

    fn save_state(&mut self, state: State) {
        self.state = Some(state);
        self.history.push(state.stamp, state, TimeDelta::from_secs_f64(self.history_s));
    }
}

impl Filter for RangeFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        validation::observe_if_valid(observation, self.latest_time(), self.history_s, |record| {
            if let ObservationKind::BodyVelocity { forward, .. } = observation.measurement {
                record.outcome = self.observe_command(observation.stamp, forward.0);
            } else if let ObservationKind::WallRange(range) = observation.measurement {
                self.observe_range(record, observation.stamp, range.0);
            }
        })
    }

    fn save(&self) -> Vec<u8> {
        let Self {
            variant: _,
            model: _,
            range_var_m2: _,
            process_var: _,
            gate_min_m: _,
            history_s: _,
            state,
            history,
            command,
            last_range,
            refused,
            refusals,
        } = self;
        saved::to_bytes(&SavedRangeFilter {
            state: *state,
            history: history.clone(),
            command: *command,
            last_range: *last_range,
            refused: *refused,
            refusals: *refusals,
        })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        let saved: SavedRangeFilter = saved::from_bytes(saved)?;
        let mut readings = saved.refused.iter().flatten().chain(&saved.command);
        (readings.all(|(_, value)| value.are_finite()))
            .then_some(())
            .ok_or(RestoreError::Implausible("a reading in it is not finite"))?;
        let SavedRangeFilter { state, history, command, last_range, refused, refusals } = saved;
        self.state = state;
        self.history = history;
        self.command = command;
        self.last_range = last_range;
        self.refused = refused;
        self.refusals = refusals;
        Ok(())
    }

    /// Restarts with the next reading: the distance driven during the break is unknown.
    fn restart_clock(&mut self) {
        self.state = None;
        self.history = TimeSeries::default();
        self.command = None;
        self.last_range = None;
        self.forget_refusals();
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        let commanded = self.command.map(|(stamp, _)| stamp);
        self.state.map(|state| state.stamp).max(commanded)
    }

    /// The distance to the wall, in metres, and its rate.
    fn scalar_at(&self, stamp: Timestamp<BrickClock>) -> Option<ScalarEstimate> {
        let (_, state) = self.history.last_at_or_before(stamp)?;
        let state = self.predict_state(*state, stamp);
        Some(ScalarEstimate {
            stamp,
            value: state.mean[DISTANCE],
            sigma: state.covariance[(DISTANCE, DISTANCE)].max(0.0).sqrt(),
            rate_per_s: -state.mean[SPEED],
            unit: "m",
        })
    }
}
