//! A bank of Kalman filters for a car whose drive nobody measured: distance, speed, and the steady speed per unit of motor input.
//!
//! ```text
//! x = [z, v, g]'        dz/dt = -v        dv/dt = (g u - v) / tau + w        dg/dt = w_g        g steady speed per unit of input
//! ```
//! With tau and the input known this is linear, so that a Kalman filter learns g while it drives. What is not linear is a grid: time
//! constant, process noise, noise of a reading. Members without a motor model (dv/dt = w) stand beside them: a line through the last
//! readings whose length the noises choose. The prediction is the mean of the members, each weighted by its likelihood so far; old
//! readings weigh less, so that a bank follows a car that changes.
//!
//! # Gate
//! A reading beyond max(GATE_MIN, 3 sqrt S) is refused by all; S is that of the mean, and at least that of a car that brakes hard. Two refused ones that agree with each other are another wall, after a
//! turn, or somebody who stays: the bank starts there, and keeps what it had for as long as a passer-by takes.
//!
//! Source: D. T. Magill, IEEE Trans. Automatic Control 10(4), 1965 (weights of a bank).

use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::models::wall_approach::WallApproachModel;

use super::replay_filter::GATE_SIGMAS;

/// The paper's car has 0.433 s. The last one is a car that never reaches its speed before a wall.
const TIME_CONSTANTS_S: [Option<f64>; 5] = [None, Some(0.15), Some(0.45), Some(1.0), Some(2.5)];
/// Densities of the noise on the speed, m²/s³: a car on a level floor, one that slips, one that brakes, one that is stopped.
const SPEED_NOISE: [f64; 5] = [0.003, 0.05, 0.5, AGILE, 30.0];
/// A car that loses 1 m/s in a fifth of a second.
const AGILE: f64 = 5.0;
/// The gate passes what a car does that brakes hard, in sigmas.
const AGILE_SIGMAS: f64 = 2.5;
/// Multiples of the configured noise of a reading.
const RANGE_FACTORS: [f64; 5] = [0.5, 1.0, 2.5, 5.0, 10.0];
/// Density of the noise on the distance, m²/s: a wheel that slips 1 mm in a metre.
const DISTANCE_NOISE: f64 = 1e-5;
/// Of g, (m/s)²/s: a battery that sags, and an input that the motors do not follow: a dead band, a wheel in the air, a wall.
const GAIN_NOISE: [f64; 2] = [0.003, 2.0];
/// Before a car has shown that its motors move it, the input is assumed to do nothing.
const GAIN_SIGMA_M_PER_S: f64 = 2.0;
/// A log may begin on the way.
const START_SPEED_SIGMA_M_PER_S: f64 = 0.7;
/// Weight of the past per reading.
const MEMORY: f64 = 0.9;
/// Share of the weight that goes to all members alike after each reading.
const SHARED: f64 = 0.02;
/// After one refused reading the next one is expected between what was predicted and the refused one: it may be a passer-by or
/// another wall.
const JUMP_SHARE: f64 = 0.45;
/// A reading this many squared sigmas off says no more against a member.
const MAX_NIS: f64 = 16.0;
/// Two refused readings agree when they are as near as the gate, and what a car of this speed drives in between.
const FASTEST_M_PER_S: f64 = 3.0;
/// Somebody who walks by is gone after it.
const PASSING_S: f64 = 1.5;

/// What the bank predicts for an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BankPrediction {
    pub distance_m: f64,
    pub towards_m_per_s: f64,
    /// Of a reading.
    pub sigma_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BankUpdate {
    pub predicted: BankPrediction,
    /// Half-width of the gate.
    pub gate_m: f64,
    pub is_gated: bool,
}

#[derive(Clone, Debug)]
pub struct DriveBank {
    gate_min_m: f64,
    now: Option<BankState>,
    /// A refused reading: time and distance.
    refused: Option<(f64, f64)>,
    /// What the bank had before it started again, and when that was.
    before: Option<(f64, BankState)>,
    /// The input, and since when.
    input: f64,
    range_sigma_m: f64,
}

/// The members at one instant.
#[derive(Clone, Debug)]
struct BankState {
    at_s: f64,
    members: Vec<Member>,
}

#[derive(Clone, Copy, Debug)]
struct Member {
    time_constant_s: Option<f64>,
    speed_noise: f64,
    gain_noise: f64,
    range_var_m2: f64,
    mean: Vector3<f64>,
    covariance: Matrix3<f64>,
    log_weight: f64,
}

impl DriveBank {
    /// With the configured noise of a reading.
    pub const fn new(range_sigma_m: f64, gate_min_m: f64) -> Self {
        Self { gate_min_m, now: None, refused: None, before: None, input: 0.0, range_sigma_m }
    }

    /// The motor input from an instant on; 1 is full drive.
    pub fn observe_input(&mut self, at_s: f64, input: f64) {
        let held = self.input;
        self.input = input;
        for state in self.now.iter_mut().chain(self.before.iter_mut().map(|(_, state)| state)) {
            state.predict(at_s, held);
        }
    }

    /// `None` before the first reading.
    pub fn predict(&self, at_s: f64) -> Option<BankPrediction> {
        let mut state = self.now.clone()?;
        state.predict(at_s, self.input);
        Some(state.prediction())
    }

    /// `None` for the reading that starts the bank.
    pub fn observe_range(&mut self, at_s: f64, range_m: f64) -> Option<BankUpdate> {
        let (input, gate_min_m) = (self.input, self.gate_min_m);
        let Some(state) = &mut self.now else {
            self.now = Some(BankState::new(at_s, range_m, self.range_sigma_m));
            return None;
        };
        state.predict(at_s, input);
        let mut predicted = state.prediction();
        let gate_m = gate_min_m.max(GATE_SIGMAS * predicted.sigma_m).max(AGILE_SIGMAS * state.agile_sigma_m());
        let is_gated = (range_m - predicted.distance_m).abs() > gate_m;
        if let Some((_, refused_m)) = self.refused {
            predicted.distance_m += JUMP_SHARE * (refused_m - predicted.distance_m);
        }
        if is_gated {
            self.refuse(at_s, range_m, gate_m);
        } else {
            state.update(range_m);
            self.refused = None;
        }
        Some(BankUpdate { predicted, gate_m, is_gated })
    }

    fn refuse(&mut self, at_s: f64, range_m: f64, gate_m: f64) {
        let input = self.input;
        self.before = self.before.take().filter(|(since_s, _)| at_s - since_s < PASSING_S);
        if let Some((_, mut earlier)) = self.before.clone() {
            earlier.predict(at_s, input);
            let expected = earlier.prediction();
            if (range_m - expected.distance_m).abs() <= self.gate_min_m.max(GATE_SIGMAS * expected.sigma_m) {
                earlier.update(range_m);
                (self.now, self.before, self.refused) = (Some(earlier), None, None);
                return;
            }
        }
        let agrees = |(then_s, then_m): (f64, f64)| {
            (range_m - then_m).abs() <= self.gate_min_m.max(0.5 * gate_m.min(0.5)) + FASTEST_M_PER_S * (at_s - then_s)
        };
        match self.refused {
            Some((then_s, then_m)) if agrees((then_s, then_m)) => {
                let Some(left) = self.now.take() else { return };
                let mut started = left.started_at(then_s, then_m);
                started.predict(at_s, input);
                started.update(range_m);
                (self.now, self.before, self.refused) = (Some(started), Some((at_s, left)), None);
            }
            _ => self.refused = Some((at_s, range_m)),
        }
    }

    /// Steady speed under the input 1 and time constant, s: means over the members that have them.
    pub fn drive(&self) -> Option<(f64, f64)> {
        let state = self.now.as_ref()?;
        let (mut sum, mut steady, mut slowness) = (0.0, 0.0, 0.0);
        for (weight, member) in state.weights().zip(&state.members) {
            let Some(time_constant_s) = member.time_constant_s else { continue };
            sum += weight;
            steady += weight * member.mean[2];
            slowness += weight * time_constant_s.ln();
        }
        (sum > 0.0).then(|| (steady / sum, f64::exp(slowness / sum)))
    }

    /// Weight of the members that use the motor input, 0 to 1.
    pub fn motor_share(&self) -> f64 {
        let Some(state) = &self.now else { return 0.0 };
        let members = state.weights().zip(&state.members);
        members.filter(|(_, member)| member.time_constant_s.is_some()).map(|(weight, _)| weight).sum()
    }
}

impl BankState {
    fn new(at_s: f64, range_m: f64, range_sigma_m: f64) -> Self {
        let mut members = Vec::new();
        for time_constant_s in TIME_CONSTANTS_S {
            // A member without a motor model has no gain; one with it leaves sudden changes to those without.
            let (gain_noises, speed_noises) = match time_constant_s {
                None => (&GAIN_NOISE[..1], &SPEED_NOISE[..]),
                Some(_) => (&GAIN_NOISE[..], &SPEED_NOISE[..4]),
            };
            for (speed_noise, gain_noise) in
                speed_noises.iter().flat_map(|speed| gain_noises.iter().map(move |gain| (*speed, *gain)))
            {
                for factor in RANGE_FACTORS {
                    // Half a nat for each doubling away from the configured noise.
                    let log_weight = -0.35 * f64::abs(f64::ln(factor));
                    let range_var_m2 = (factor * range_sigma_m).powi(2);
                    members.push(Member {
                        time_constant_s,
                        speed_noise,
                        gain_noise,
                        range_var_m2,
                        mean: Vector3::zeros(),
                        covariance: Matrix3::zeros(),
                        log_weight,
                    });
                }
            }
        }
        Self { at_s, members }.started_at(at_s, range_m)
    }

    /// The same members with their weights, at a distance of which one reading is known.
    fn started_at(&self, at_s: f64, range_m: f64) -> Self {
        let mut members = self.members.clone();
        for member in &mut members {
            member.mean = Vector3::new(range_m, 0.0, 0.0);
            member.covariance = Matrix3::from_diagonal(&Vector3::new(
                member.range_var_m2,
                START_SPEED_SIGMA_M_PER_S.powi(2),
                GAIN_SIGMA_M_PER_S.powi(2),
            ));
        }
        Self { at_s, members }
    }

    fn predict(&mut self, to_s: f64, input: f64) {
        let dt_s = to_s - self.at_s;
        if dt_s <= 0.0 {
            return;
        }
        self.at_s = to_s;
        for member in &mut self.members {
            member.predict(dt_s, input);
        }
    }

    fn update(&mut self, range_m: f64) {
        let mut most = f64::NEG_INFINITY;
        for member in &mut self.members {
            member.update(range_m);
            most = most.max(member.log_weight);
        }
        for member in &mut self.members {
            member.log_weight = MEMORY * (member.log_weight - most);
        }
        // A share of the weight goes to all alike: a member that was wrong for long may be right from here on.
        let sum: f64 = self.members.iter().map(|member| member.log_weight.exp()).sum();
        let count = self.members.len() as f64;
        for member in &mut self.members {
            member.log_weight = ((1.0 - SHARED) * member.log_weight.exp() / sum + SHARED / count).ln();
        }
    }

    /// Sigma of a reading by the members that let a car stop at once.
    fn agile_sigma_m(&self) -> f64 {
        let (mut sum, mut variance) = (0.0, 0.0);
        for (weight, member) in self.weights().zip(&self.members) {
            if member.time_constant_s.is_none() && member.speed_noise == AGILE {
                sum += weight;
                variance += weight * (member.covariance[(0, 0)] + member.range_var_m2);
            }
        }
        if sum > 0.0 { (variance / sum).sqrt() } else { 0.0 }
    }

    fn weights(&self) -> impl Iterator<Item = f64> + '_ {
        let most = self.members.iter().map(|member| member.log_weight).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = self.members.iter().map(|member| (member.log_weight - most).exp()).sum();
        self.members.iter().map(move |member| (member.log_weight - most).exp() / sum)
    }

    fn prediction(&self) -> BankPrediction {
        let members = || self.weights().zip(&self.members);
        let mean = |of: fn(&Member) -> f64| members().map(|(weight, member)| weight * of(member)).sum::<f64>();
        let distance_m = mean(|member| member.mean[0]);
        let variance = members().map(|(weight, member)| {
            weight * (member.covariance[(0, 0)] + member.range_var_m2 + (member.mean[0] - distance_m).powi(2))
        });
        BankPrediction {
            distance_m,
            towards_m_per_s: mean(|member| member.mean[1]),
            sigma_m: variance.sum::<f64>().sqrt(),
        }
    }
}

impl Member {
    fn predict(&mut self, dt_s: f64, input: f64) {
        let (transition, noise) = if let Some(time_constant_s) = self.time_constant_s {
            let model = WallApproachModel { drag_s_per_m: 1.0, mass_s2_per_m: time_constant_s };
            let step = model.exact(dt_s);
            let mut whole = Matrix3::identity();
            whole.fixed_view_mut::<2, 2>(0, 0).copy_from(&step.a);
            whole.fixed_view_mut::<2, 1>(0, 2).copy_from(&(step.b * input));
            (whole, model.exact_noise(dt_s, DISTANCE_NOISE, self.speed_noise))
        } else {
            let whole = Matrix3::new(1.0, -dt_s, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
            let (q, shared) = (self.speed_noise, -0.5 * self.speed_noise * dt_s * dt_s);
            let distance = DISTANCE_NOISE * dt_s + q * dt_s.powi(3) / 3.0;
            (whole, nalgebra::Matrix2::new(distance, shared, shared, q * dt_s))
        };
        self.mean = transition * self.mean;
        self.covariance = transition * self.covariance * transition.transpose();
        let mut moved = self.covariance.fixed_view_mut::<2, 2>(0, 0);
        moved += noise;
        if self.time_constant_s.is_some() {
            self.covariance[(2, 2)] += self.gain_noise * dt_s;
        }
    }

    fn update(&mut self, range_m: f64) {
        let s_m2 = self.covariance[(0, 0)] + self.range_var_m2;
        let innovation_m = range_m - self.mean[0];
        self.log_weight -= 0.5 * ((innovation_m * innovation_m / s_m2).min(MAX_NIS) + s_m2.ln());
        let gain = self.covariance.column(0) / s_m2;
        self.mean += gain * innovation_m;
        self.covariance -= gain * gain.transpose() * s_m2;
    }
}
