//! The measurement update: whitening, then one scalar at a time. No matrix inverse, no square root of P.

use std::array::from_fn;

use nalgebra::{SMatrix, SVector};

use crate::numerics::cholesky::{lower_triangle, solve_lower};
use crate::numerics::covariance::symmetrise;

#[derive(Clone, Copy, Debug)]
pub struct LinearizedMeasurement<const N: usize, const M: usize> {
    /// z - h(x), angles wrapped.
    pub innovation: SVector<f64, M>,
    /// dh/dx at x.
    pub jacobian: SMatrix<f64, M, N>,
    /// R.
    pub noise: SMatrix<f64, M, M>,
}

impl<const N: usize, const M: usize> LinearizedMeasurement<N, M> {
    /// S = H P H' + R.
    pub fn innovation_covariance(&self, covariance: &SMatrix<f64, N, N>) -> SMatrix<f64, M, M> {
        self.jacobian * covariance * self.jacobian.transpose() + self.noise
    }
}

/// Normalised innovation squared and log-likelihood of an innovation under N(0, S); `None` when S is not positive definite.
pub fn nis_and_log_likelihood<const M: usize>(
    innovation: &SVector<f64, M>,
    innovation_covariance: &SMatrix<f64, M, M>,
) -> Option<(f64, f64)> {
    let lower = lower_triangle(innovation_covariance)?;
    let white = solve_lower(&lower, innovation);
    let nis = white.norm_squared();
    let log_det: f64 = (0..M).map(|i| 2.0 * lower[(i, i)].ln()).sum();
    let log_likelihood = -0.5 * (nis + log_det + M as f64 * std::f64::consts::TAU.ln());
    Some((nis, log_likelihood))
}

/// Uses a measurement; `false` leaves state and covariance untouched because R is not positive definite.
pub fn apply_measurement<const N: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    measurement: &LinearizedMeasurement<N, M>,
) -> bool {
    let Some(lower) = lower_triangle(&measurement.noise) else {
        return false;
    };
    let white_innovation = solve_lower(&lower, &measurement.innovation);
    let mut white_jacobian = SMatrix::<f64, M, N>::zeros();
    for column in 0..N {
        let solved = solve_lower(&lower, &measurement.jacobian.column(column).into_owned());
        white_jacobian.set_column(column, &solved);
    }
    let start = *mean;
    for i in 0..M {
        let row = white_jacobian.row(i);
        // The innovation was taken at `start`; what the earlier components moved is already explained.
        let innovation = white_innovation[i] - (row * (*mean - start))[0];
        let cross = *covariance * row.transpose();
        let s = (row * cross)[0] + 1.0;
        let gain = cross / s;
        *mean += gain * innovation;
        *covariance -= gain * cross.transpose();
        symmetrise(covariance);
    }
    true
}

/// One scalar observation of a few named rows of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarMeasurement<const K: usize> {
    /// z - h(x), angles wrapped.
    pub innovation: f64,
    /// The rows of the state that it depends on.
    pub rows: [usize; K],
    /// dh/dx of each of these rows.
    pub jacobian: [f64; K],
    /// R, more than zero.
    pub variance: f64,
}

impl<const K: usize> ScalarMeasurement<K> {
    /// S = H P H' + R.
    pub fn innovation_variance<const N: usize>(&self, covariance: &SMatrix<f64, N, N>) -> f64 {
        let mut s = self.variance;
        for (&row, &by_row) in self.rows.iter().zip(&self.jacobian) {
            for (&column, &by_column) in self.rows.iter().zip(&self.jacobian) {
                s += by_row * by_column * covariance[(row, column)];
            }
        }
        s
    }

    /// P H'.
    #[inline]
    pub fn cross_covariance<const N: usize>(&self, covariance: &SMatrix<f64, N, N>) -> SVector<f64, N> {
        // Minus zero, because adding it changes nothing, so that the compiler may leave the first sum out.
        let mut cross = SVector::<f64, N>::repeat(-0.0);
        for (&row, &by) in self.rows.iter().zip(&self.jacobian) {
            for i in 0..N {
                cross[i] += by * covariance[(i, row)];
            }
        }
        cross
    }

    /// One row of P H', with the same order of summation as [`Self::cross_covariance`].
    #[inline]
    fn cross_covariance_at<const N: usize>(&self, covariance: &SMatrix<f64, N, N>, i: usize) -> f64 {
        let terms = self.rows.iter().zip(&self.jacobian);
        terms.fold(-0.0, |sum, (&row, &by)| sum + by * covariance[(i, row)])
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarOutcome {
    /// S = H P H' + R.
    pub innovation_variance: f64,
    /// Innovation squared over S.
    pub nis: f64,
    pub outcome: UpdateOutcome,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpdateOutcome {
    /// State and covariance changed.
    Used,
    /// Its NIS exceeds the gate; nothing changed.
    Gated,
    /// S is not a positive, finite number, or the innovation is not finite; nothing changed.
    Indefinite,
}

/// Uses one scalar observation of a few rows, unless its NIS exceeds `gate` (infinite for none); the covariance stays
/// symmetric to the last bit. Panics: a named row is N or more.
#[inline]
pub fn use_scalar<const N: usize, const K: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    scalar: &ScalarMeasurement<K>,
    gate: f64,
) -> ScalarOutcome {
    let cross = scalar.cross_covariance(covariance);
    let mut s = scalar.variance;
    for (&row, &by) in scalar.rows.iter().zip(&scalar.jacobian) {
        s += by * cross[row];
    }
    // The only division: everything below waits for it.
    let inverse = 1.0 / s;
    let scaled_innovation = scalar.innovation * inverse;
    let nis = scalar.innovation * scaled_innovation;
    // An S of zero, below zero, without end or not a number gives an inverse or a NIS that fails here.
    let usage = if !(inverse > 0.0 && nis.is_finite()) {
        UpdateOutcome::Indefinite
    } else if nis > gate {
        UpdateOutcome::Gated
    } else {
        *mean += cross * scaled_innovation;
        subtract_outer_square(covariance, &cross, inverse);
        UpdateOutcome::Used
    };
    ScalarOutcome { innovation_variance: s, nis, outcome: usage }
}

/// The effect of [`use_scalar`] without a gate on some rows, in rising order, bit for bit; `None` if it would change
/// nothing. Panics: a named row is N or more.
#[inline]
pub fn preview_scalar<const N: usize, const K: usize, const R: usize>(
    mean: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
    scalar: &ScalarMeasurement<K>,
    rows: [usize; R],
) -> Option<([f64; R], [[f64; R]; R])> {
    let mut s = scalar.variance;
    for (&row, &by) in scalar.rows.iter().zip(&scalar.jacobian) {
        s += by * scalar.cross_covariance_at(covariance, row);
    }
    let inverse = 1.0 / s;
    let scaled_innovation = scalar.innovation * inverse;
    if !(inverse > 0.0 && (scalar.innovation * scaled_innovation).is_finite()) {
        return None;
    }
    let cross = rows.map(|row| scalar.cross_covariance_at(covariance, row));
    let scaled = cross.map(|cross| cross * inverse);
    let after = from_fn(|i| {
        from_fn(|j| {
            // Of the triangle that the update computes.
            let (row, column) = (i.max(j), i.min(j));
            covariance[(rows[row], rows[column])] - scaled[row] * cross[column]
        })
    });
    let moved = from_fn(|i| mean[rows[i]] + cross[i] * scaled_innovation);
    Some((moved, after))
}

/// P <- P - c c' / s: one triangle computed, the other copied, so that the result is symmetric.
#[inline]
fn subtract_outer_square<const N: usize>(p: &mut SMatrix<f64, N, N>, c: &SVector<f64, N>, inverse_s: f64) {
    let scaled = c * inverse_s;
    for column in 0..N {
        for row in column..N {
            let value = p[(row, column)] - scaled[row] * c[column];
            p[(row, column)] = value;
            p[(column, row)] = value;
        }
    }
}
