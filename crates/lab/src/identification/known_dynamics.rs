//! Least squares for known dynamics: block and recursive.
//!
//! # Model
//! ```text
//! block       [G  C e^(A t_k)] [u; x_ini] ~ y_k, all k, by singular values                                            (11)
//! recursive   K = P phi / (1 + phi' P phi)     theta <- theta + K (y - phi' theta)     P <- P - K phi' P               (12)
//! ```
//! [`posebridge_estimator::filters::dynamic`] must give the same results.
//!
//! # Sources
//! Paper 2 (Markovsky), the stacked system and its recursion; docs/lab/thermometer.md section M2.

use nalgebra::{DMatrix, DVector};
use posebridge_estimator::models::dynamic_measurement::{DynamicModel, ROWS};
use posebridge_telemetry::SensorId;

use super::TimedSample;

/// The final value of a first-order sensor from three equidistant samples: u = (y_1 y_3 - y_2^2) / (y_1 + y_3 - 2 y_2).
///
/// `None` where the samples lie on a line.
pub fn final_value_from_three([first, second, third]: [f64; 3]) -> Option<f64> {
    let bend = first + third - 2.0 * second;
    let found = (first * third - second * second) / bend;
    found.is_finite().then_some(found)
}

/// A quantity with its standard deviation per sigma of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalizedEstimate {
    pub value: f64,
    pub noise_gain: f64,
}

impl NormalizedEstimate {
    fn finite(value: f64, noise_gain: f64) -> Option<Self> {
        (value.is_finite() && noise_gain.is_finite()).then_some(Self { value, noise_gain })
    }
}

/// The stacked system of (11) with a prior in additional rows: u is the first sample over the gain, the transient zero, each with a
/// sigma of `prior_sigmas` times the noise of a sample.
///
/// `None` without samples, or if the model does not contain the sensor.
fn stack_samples(
    model: &DynamicModel,
    samples: &[(SensorId, TimedSample)],
    prior_sigmas: f64,
) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let columns = 1 + model.states();
    let (first_sensor, first) = samples.first()?;
    let mut rows: Vec<f64> = Vec::with_capacity((samples.len() + columns) * columns);
    let mut values: Vec<f64> = Vec::with_capacity(samples.len() + columns);
    for column in 0..columns {
        rows.extend((0..columns).map(|k| f64::from(u8::from(k == column)) / prior_sigmas));
        values.push(0.0);
    }
    values[0] = first.value / model.row_of(*first_sensor)?[0] / prior_sigmas;
    for (sensor, sample) in samples {
        let row = model.row_of(*sensor)?;
        let since = model.transition(sample.at_s - first.at_s);
        rows.extend((0..columns).map(|column| (0..ROWS).map(|k| row[k] * since[(k, column)]).sum::<f64>()));
        values.push(sample.value);
    }
    let matrix = DMatrix::from_row_slice(values.len(), columns, &rows);
    Some((matrix, DVector::from_vec(values)))
}

/// Block least squares (11) for a constant quantity, measured by sensors of known dynamics.
///
/// Samples must be in time order. `None` without samples, if the model does not contain a sensor, or for invalid numbers.
pub fn block_least_squares(
    model: &DynamicModel,
    samples: &[(SensorId, TimedSample)],
    prior_sigmas: f64,
) -> Option<NormalizedEstimate> {
    let (matrix, values) = stack_samples(model, samples, prior_sigmas)?;
    let svd = matrix.svd(true, true);
    let solution = svd.solve(&values, 0.0).ok()?;
    let v_t = svd.v_t.as_ref()?;
    let parts = svd.singular_values.iter().enumerate();
    let variance: f64 = parts.map(|(k, s)| (v_t[(k, 0)] / s).powi(2)).sum();
    NormalizedEstimate::finite(solution[0], variance.sqrt())
}

/// Recursive least squares (12) with the same prior; otherwise like [`block_least_squares`].
pub fn recursive_least_squares(
    model: &DynamicModel,
    samples: &[(SensorId, TimedSample)],
    prior_sigmas: f64,
) -> Option<NormalizedEstimate> {
    let (matrix, values) = stack_samples(model, samples, prior_sigmas)?;
    let columns = matrix.ncols();
    let mut theta = DVector::zeros(columns);
    theta[0] = values[0] * prior_sigmas;
    let mut p = DMatrix::identity(columns, columns) * prior_sigmas * prior_sigmas;
    for i in columns..values.len() {
        let phi = matrix.row(i).transpose();
        let gain = &p * &phi / (1.0 + (phi.transpose() * &p * &phi)[0]);
        theta += &gain * (values[i] - phi.dot(&theta));
        p -= &gain * (phi.transpose() * &p);
    }
    NormalizedEstimate::finite(theta[0], p[(0, 0)].max(0.0).sqrt())
}
