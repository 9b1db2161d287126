//! Mean and covariance through a nonlinear function by sigma points.
//!
//! ```text
//! X_i = x + sqrt(N) L e_i, X_(N+i) = x - sqrt(N) L e_i      P = L L'      W_i = 1 / (2 N), none in the middle
//! motion       x' = sum W_i f(X_i)      th' = th_0 + atan2(sum W_i sin(th_i - th_0), sum W_i cos(th_i - th_0))
//!              P' = sum W_i (f(X_i) - x')(f(X_i) - x')'
//! observation  z' = sum W_i h(X_i)      S - R = sum W_i (h(X_i) - z')(h(X_i) - z')'
//!              C  = sum W_i (X_i - x)(h(X_i) - z')'
//! ```
//! The weights are those with kappa = 0, alpha = 1, beta = 0, the cubature rule. None is negative, so P' is positive
//! semi-definite whatever the model does; the customary kappa = 3 - n can make it indefinite.
//!
//! Source: Julier and Uhlmann (2004); Arasaratnam and Haykin (2009), section III, for the weights; docs/lab/square.md
//! section M6.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::estimate::row::HEADING;

use crate::numerics::cholesky::factorise;
use crate::numerics::covariance::symmetrise;

/// A pivot this far below zero, as a share of its diagonal element, is rounding.
const ROUNDING: f64 = 1e-9;

/// Mean and covariance after a motion, without process noise; `None` when P has no square root. The heading stands in
/// its usual row.
pub fn predict<const N: usize>(
    mean: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
    advance: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>)> {
    let spread = square_root(covariance)? * (N as f64).sqrt();
    let middle = advance(mean);
    let mut from_middle = [[SVector::<f64, N>::zeros(); 2]; N];
    for (i, pair) in from_middle.iter_mut().enumerate() {
        let column = spread.column(i).into_owned();
        *pair = [advance(&(mean + column)) - middle, advance(&(mean - column)) - middle];
    }
    let weight = 1.0 / (2.0 * N as f64);
    let mut shift = SVector::<f64, N>::zeros();
    let (mut sin, mut cos) = (0.0, 0.0);
    // All points above the mean, then all below it.
    for point in (0..2).flat_map(|side: usize| from_middle.iter().map(move |pair| &pair[side])) {
        shift += point * weight;
        sin += point[HEADING].sin() * weight;
        cos += point[HEADING].cos() * weight;
    }
    // Points all around the circle have no mean direction; that of the middle one is then as good as any.
    shift[HEADING] = if cos > 0.0 { sin.atan2(cos) } else { 0.0 };
    let mut spread_after = SMatrix::<f64, N, N>::zeros();
    for point in (0..2).flat_map(|side: usize| from_middle.iter().map(move |pair| &pair[side])) {
        let off = point - shift;
        spread_after += off * off.transpose() * weight;
    }
    symmetrise(&mut spread_after);
    Some((middle + shift, spread_after))
}

/// An observation that sigma points predict.
#[derive(Clone, Copy, Debug)]
pub struct PredictedObservation<const N: usize, const M: usize> {
    /// z'.
    pub mean: SVector<f64, M>,
    /// S - R.
    pub spread: SMatrix<f64, M, M>,
    /// C.
    pub cross: SMatrix<f64, N, M>,
}

/// `None` when P has no square root.
pub fn observe<const N: usize, const M: usize>(
    mean: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
    of_state: impl Fn(&SVector<f64, N>) -> SVector<f64, M>,
) -> Option<PredictedObservation<N, M>> {
    let spread = square_root(covariance)? * (N as f64).sqrt();
    let weight = 1.0 / (2.0 * N as f64);
    let mut seen = [[SVector::<f64, M>::zeros(); 2]; N];
    let mut expected = SVector::<f64, M>::zeros();
    for (i, pair) in seen.iter_mut().enumerate() {
        let column = spread.column(i).into_owned();
        *pair = [of_state(&(mean + column)), of_state(&(mean - column))];
        expected += (pair[0] + pair[1]) * weight;
    }
    let mut found = PredictedObservation { mean: expected, spread: SMatrix::zeros(), cross: SMatrix::zeros() };
    for (i, pair) in seen.iter().enumerate() {
        let column = spread.column(i).into_owned();
        for (point, sign) in pair.iter().zip([1.0, -1.0]) {
            let off = point - expected;
            found.spread += off * off.transpose() * weight;
            found.cross += column * off.transpose() * (sign * weight);
        }
    }
    Some(found)
}

/// The lower triangle L with L L' = P; a row without variance gets a column of zeros. `None` when P has a negative
/// eigenvalue beyond rounding or is not finite.
pub fn square_root<const N: usize>(covariance: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let root = factorise(covariance, |row, pivot| {
        let rounding = ROUNDING * covariance[(row, row)].abs();
        if !pivot.is_finite() || pivot < -rounding {
            return Err(());
        }
        Ok(if pivot <= rounding { 0.0 } else { pivot.sqrt() })
    })
    .ok()?;
    // Rows without variance of their own can share none with the rows below.
    for row in (0..N).filter(|&row| root[(row, row)] == 0.0) {
        for below in row + 1..N {
            let left = covariance[(below, row)] - root.row(below).dot(&root.row(row));
            let scale = (covariance[(below, below)] * covariance[(row, row)]).sqrt();
            if left.is_nan() || left.abs() > ROUNDING.sqrt() * scale {
                return None;
            }
        }
    }
    Some(root)
}
