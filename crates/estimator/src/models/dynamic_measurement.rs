//! Models of slow sensors: how they approach a constant input, which [`crate::filters::dynamic`] estimates.
//!
//! ```text
//! y_i(t) = G_i u + C_i x_i(t)       dx_i/dt = A_i x_i       each sensor i with states of its own
//! X = [u; x_1; x_2; ..]             F(dt) = blkdiag(1, e^(A dt))             H_i = [G_i, 0 .. C_i .. 0]
//!
//! lags tau_1 .. tau_n               A_i = diag(-1/tau_j)                     C_i = [1 .. 1]
//! coefficients a_0 .. a_(n-1)       y^(n) + a_(n-1) y^(n-1) + .. + a_0 y = a_0 G_i u
//!                                   A_i = companion matrix                   C_i = [1 0 .. 0], x_i = [y - G u, dy/dt, ..]
//!
//! a step du of the input            y_i does not leap with it: C_i dx_i = -G_i du, a direction B = [1; -G_i at x_i ..]
//! an input that walks               Q(dt) = integral over dt of F(s) B B' F(s)' ds, times its density
//! ```
//! Of a sensor with several lags it is not known which takes up a step of the input: each takes up the same share.
//!
//! Source: Paper 2 (Markovsky), the augmented model; docs/lab/thermometer.md sections M1 and M2.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::SensorId;

/// The most states that the sensors of one model may have together. Eight are four sensors of second order.
pub const MAX_STATES: usize = 8;
/// Rows of the augmented state: the quantity and the sensors' states. Unused rows stay zero.
pub const ROWS: usize = 1 + MAX_STATES;
/// The row of the measured quantity u.
pub const QUANTITY: usize = 0;

/// The response of one or several sensors to the quantity that they measure.
#[derive(Clone, Debug, PartialEq)]
pub struct DynamicModel {
    /// A of all sensors, 1/s; block diagonal, zero for unused states.
    rates: SMatrix<f64, MAX_STATES, MAX_STATES>,
    sensors: Vec<SensorOutput>,
    state_count: usize,
    /// B: the effect of a step of the quantity.
    step: [f64; ROWS],
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct SensorOutput {
    sensor: SensorId,
    row: [f64; ROWS],
}

impl DynamicModel {
    /// One sensor of first order: dy/dt = (u - y) / tau. Errors: tau is not positive and finite.
    pub fn first_order(sensor: SensorId, time_constant_s: f64) -> Result<Self, ModelError> {
        Self::empty().with_lags(sensor, 1.0, &[time_constant_s])
    }

    /// Without sensors; `with_lags` and `with_coefficients` add them.
    pub fn empty() -> Self {
        Self {
            rates: SMatrix::zeros(),
            sensors: Vec::new(),
            state_count: 0,
            step: std::array::from_fn(|row| if row == QUANTITY { 1.0 } else { 0.0 }),
        }
    }

    /// Adds a sensor that approaches `gain` u as a sum of exponentials with these time constants, in seconds.
    ///
    /// Errors: a time constant or the gain is no usable number, two time constants are equal (their shares could not be distinguished),
    /// the sensor is in the model already, or there are more than [`MAX_STATES`] states.
    pub fn with_lags(self, sensor: SensorId, gain: f64, time_constants_s: &[f64]) -> Result<Self, ModelError> {
        let mut block = SMatrix::zeros();
        let mut readout = [0.0; MAX_STATES];
        for (j, &tau_s) in time_constants_s.iter().enumerate().take(MAX_STATES) {
            if !(tau_s > 0.0 && tau_s.is_finite() && (1.0 / tau_s).is_finite()) {
                return Err(ModelError::TimeConstant { tau_s });
            }
            if time_constants_s.iter().take(j).any(|other| *other == tau_s) {
                return Err(ModelError::EqualTimeConstants { tau_s });
            }
            block[(j, j)] = -1.0 / tau_s;
            readout[j] = 1.0;
        }
        self.with_block(sensor, gain, time_constants_s.len(), &block, &readout)
    }

    /// Adds a sensor with the differential equation y^(n) + a_(n-1) y^(n-1) + .. + a_0 y = a_0 gain u, by a_0 to a_(n-1); a_j in
    /// 1/s to the power of n - j.
    ///
    /// Errors: the equation is not stable (Routh's criterion), the gain is no usable number, the sensor is in the model already, or
    /// there are more than [`MAX_STATES`] states.
    pub fn with_coefficients(self, sensor: SensorId, gain: f64, coefficients: &[f64]) -> Result<Self, ModelError> {
        let order = coefficients.len();
        if order > MAX_STATES {
            return Err(ModelError::TooManyStates { states: order });
        }
        if !is_stable(coefficients) {
            return Err(ModelError::Unstable);
        }
        let mut block = SMatrix::zeros();
        let mut readout = [0.0; MAX_STATES];
        readout[0] = 1.0;
        for (j, &a) in coefficients.iter().enumerate() {
            block[(order - 1, j)] = -a;
            if j + 1 < order {
                block[(j, j + 1)] = 1.0;
            }
        }
        self.with_block(sensor, gain, order, &block, &readout)
    }

    fn with_block(
        mut self,
        sensor: SensorId,
        gain: f64,
        order: usize,
        block: &SMatrix<f64, MAX_STATES, MAX_STATES>,
        readout: &[f64; MAX_STATES],
    ) -> Result<Self, ModelError> {
        if !(gain != 0.0 && gain.is_finite()) {
            return Err(ModelError::Gain { gain });
        }
        if self.row_of(sensor).is_some() {
            return Err(ModelError::DuplicateSensor { sensor });
        }
        let states = self.state_count + order;
        if order == 0 || states > MAX_STATES {
            return Err(ModelError::TooManyStates { states });
        }
        let mut row = [0.0; ROWS];
        row[QUANTITY] = gain;
        let read: f64 = readout.iter().sum();
        for j in 0..order {
            row[1 + self.state_count + j] = readout[j];
            self.step[1 + self.state_count + j] = -gain * readout[j] / read;
            for k in 0..order {
                self.rates[(self.state_count + j, self.state_count + k)] = block[(j, k)];
            }
        }
        self.sensors.push(SensorOutput { sensor, row });
        self.state_count = states;
        Ok(self)
    }

    /// H of a sensor, over all rows; `None` for a sensor that is not in the model.
    pub fn row_of(&self, sensor: SensorId) -> Option<[f64; ROWS]> {
        let known = self.sensors.iter().find(|row| row.sensor == sensor)?;
        Some(known.row)
    }

    pub const fn states(&self) -> usize {
        self.state_count
    }

    /// F over a time in seconds: the quantity stays, the sensors' states follow their dynamics. Negative times go back.
    pub fn transition(&self, dt_s: f64) -> SMatrix<f64, ROWS, ROWS> {
        let mut f = SMatrix::<f64, ROWS, ROWS>::identity();
        f.fixed_view_mut::<MAX_STATES, MAX_STATES>(1, 1).copy_from(&exponential(&(self.rates * dt_s)));
        f
    }

    /// Q over a time in seconds, at least 0, for a random walk of the quantity with unit density: by doubling from an
    /// interval that is short against all lags, Q(2 h) = F(h) Q(h) F(h)' + Q(h).
    pub fn random_walk_noise(&self, dt_s: f64) -> SMatrix<f64, ROWS, ROWS> {
        let doublings = (row_norm(&self.rates) * dt_s / SHORT_STEP).log2().ceil().clamp(0.0, MAX_DOUBLINGS);
        let short_s = dt_s * (-doublings).exp2();
        let b = SVector::from(self.step);
        let middle = self.transition(0.5 * short_s) * b;
        let mut q = middle * middle.transpose() * short_s;
        let mut f = self.transition(short_s);
        for _ in 0..doublings as u32 {
            q += f * q * f.transpose();
            f *= f;
        }
        q
    }
}

/// Up to this share of the fastest lag the midpoint rule is exact to a ten-thousandth.
const SHORT_STEP: f64 = 1.0 / 32.0;
/// An hour in steps of a nanosecond.
const MAX_DOUBLINGS: f64 = 42.0;

/// The largest sum of the magnitudes in a row.
fn row_norm(matrix: &SMatrix<f64, MAX_STATES, MAX_STATES>) -> f64 {
    matrix.row_iter().map(|row| row.iter().map(|value| value.abs()).sum::<f64>()).fold(0.0, f64::max)
}

/// e^M by Taylor's series of M / 2^s, squared s times (Moler and Van Loan 2003, method 3).
fn exponential(matrix: &SMatrix<f64, MAX_STATES, MAX_STATES>) -> SMatrix<f64, MAX_STATES, MAX_STATES> {
    // Below 1/4 thirteen terms leave less than 1e-17.
    let squarings = (row_norm(matrix) / 0.25).log2().ceil().clamp(0.0, 1_000.0);
    let small = matrix * (-squarings).exp2();
    let mut sum = SMatrix::identity();
    let mut term = SMatrix::identity();
    for k in 1..=TAYLOR_TERMS {
        term = term * small / f64::from(k);
        sum += term;
    }
    for _ in 0..squarings as u32 {
        sum *= sum;
    }
    sum
}

const TAYLOR_TERMS: u32 = 13;

/// Routh's criterion: all roots of s^n + a_(n-1) s^(n-1) + .. + a_0 lie in the left half-plane if and only if the first column of
/// Routh's array is positive.
fn is_stable(coefficients: &[f64]) -> bool {
    let order = coefficients.len();
    if order == 0 || !coefficients.iter().all(|a| *a > 0.0 && a.is_finite()) {
        return false;
    }
    // The polynomial from its highest power on, dealt out to two rows.
    let falling = || std::iter::once(1.0).chain(coefficients.iter().rev().copied());
    let mut upper: Vec<f64> = falling().step_by(2).collect();
    let mut lower: Vec<f64> = falling().skip(1).step_by(2).collect();
    while let Some(&first) = lower.first() {
        if first.is_nan() || first <= 0.0 {
            return false;
        }
        let ratio = upper.first().copied().unwrap_or(0.0) / first;
        let next = (1..upper.len()).map(|k| upper[k] - ratio * lower.get(k).copied().unwrap_or(0.0)).collect();
        upper = std::mem::replace(&mut lower, next);
    }
    true
}

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// Not positive or not finite.
    #[error("a time constant of {tau_s} s is not positive and finite")]
    TimeConstant { tau_s: f64 },
    /// Two equal lags of one sensor cannot be distinguished.
    #[error("two lags of one sensor have the time constant {tau_s} s")]
    EqualTimeConstants { tau_s: f64 },
    /// Zero or not finite.
    #[error("a gain of {gain} is zero or not finite")]
    Gain { gain: f64 },
    /// The sensor would not settle.
    #[error("the coefficients are those of an unstable sensor")]
    Unstable,
    #[error("sensor {sensor} is in the model already")]
    DuplicateSensor { sensor: SensorId },
    #[error("{states} states, must be 1 to {MAX_STATES}")]
    TooManyStates { states: usize },
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: SensorId = SensorId(6);

    #[test]
    fn a_lag_decays_by_its_exponential_over_any_time() {
        let model = DynamicModel::first_order(A, 2.0).unwrap();
        for dt_s in [0.0, 1e-6, 0.3, 2.0, 50.0, 4_000.0, -0.7] {
            let found = model.transition(dt_s)[(1, 1)];
            let expected = (-dt_s / 2.0_f64).exp();
            assert!((found - expected).abs() < 1e-14, "{dt_s}: {found}");
        }
    }

    #[test]
    fn an_oscillating_sensor_goes_by_its_sine() {
        // s^2 + 2 s + 10: e^-t (cos 3t, sin 3t).
        let model = DynamicModel::empty().with_coefficients(A, 1.0, &[10.0, 2.0]).unwrap();
        let f = model.transition(0.8);
        let (sin, cos) = 2.4_f64.sin_cos();
        let decay = (-0.8_f64).exp();
        assert!((f[(1, 1)] - decay * (cos + sin / 3.0)).abs() < 1e-14);
        assert!((f[(1, 2)] - decay * sin / 3.0).abs() < 1e-14);
        assert!((f[(2, 1)] + decay * sin * 10.0 / 3.0).abs() < 1e-13);
    }

    #[test]
    fn a_random_walk_of_the_quantity_is_observed_through_the_lag() {
        let model = DynamicModel::empty().with_lags(A, 2.0, &[3.0]).unwrap();
        for dt_s in [1e-6_f64, 0.4, 5.0, 900.0] {
            // u gains dt; x = y - 2 u falls back from each step of it.
            let (e, e_2) = ((-dt_s / 3.0).exp_m1(), (-2.0 * dt_s / 3.0).exp_m1());
            let q = model.random_walk_noise(dt_s);
            for (found, expected) in [
                (q[(0, 0)], dt_s),
                (q[(1, 0)], 2.0 * 3.0 * e),
                (q[(0, 1)], 2.0 * 3.0 * e),
                (q[(1, 1)], -4.0 * 1.5 * e_2),
            ] {
                assert!((found / expected - 1.0).abs() < 2e-4, "{dt_s}: {q}");
            }
        }
        assert_eq!(model.random_walk_noise(0.0).norm(), 0.0);
    }

    #[test]
    fn a_step_of_the_quantity_makes_no_sensor_leap() {
        let model = DynamicModel::empty()
            .with_lags(A, 1.0, &[5.3, 22.0])
            .unwrap()
            .with_coefficients(SensorId(7), 0.5, &[0.02, 0.2])
            .unwrap();
        let q = model.random_walk_noise(1e-9) / 1e-9;
        for sensor in [A, SensorId(7)] {
            let row = SVector::from(model.row_of(sensor).unwrap());
            assert!((row.transpose() * q * row)[0].abs() < 1e-12, "{sensor}");
        }
        assert!((q[(QUANTITY, QUANTITY)] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_a_sensor_is_refused() {
        let with = |coefficients: &[f64]| DynamicModel::empty().with_coefficients(A, 1.0, coefficients);
        // (s + 3)(s^2 - s + 4): positive coefficients, roots on the right.
        assert_eq!(with(&[12.0, 1.0, 2.0]), Err(ModelError::Unstable));
        assert!(with(&[12.0, 7.0, 4.0]).is_ok(), "(s + 3)(s^2 + s + 4)");
        assert_eq!(with(&[f64::NAN]), Err(ModelError::Unstable));
        assert_eq!(with(&[]), Err(ModelError::Unstable));
        assert!(DynamicModel::first_order(A, 0.0).is_err());
        assert!(DynamicModel::first_order(A, f64::INFINITY).is_err());
        let twice = DynamicModel::first_order(A, 1.0).unwrap();
        assert_eq!(twice.clone().with_lags(A, 1.0, &[2.0]), Err(ModelError::DuplicateSensor { sensor: A }));
        assert!(twice.clone().with_lags(SensorId(7), 0.0, &[2.0]).is_err());
        assert!(twice.clone().with_lags(SensorId(7), 1.0, &[2.0, 2.0]).is_err());
        let many: Vec<f64> = (1..=8).map(f64::from).collect();
        assert_eq!(twice.with_lags(SensorId(7), 1.0, &many), Err(ModelError::TooManyStates { states: 9 }));
    }
}
