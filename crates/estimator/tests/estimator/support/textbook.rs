//! The Kalman update of all components at once, by a matrix inverse, as any textbook has it.

use nalgebra::{SMatrix, SVector};

/// Updates mean and covariance by z = H x + v with the covariance R of v.
pub(crate) fn update<const N: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    h: &SMatrix<f64, M, N>,
    r: &SMatrix<f64, M, M>,
    z: &SVector<f64, M>,
) {
    let s = h * *covariance * h.transpose() + r;
    let gain = *covariance * h.transpose() * s.try_inverse().expect("positive definite");
    *mean += gain * (z - h * *mean);
    *covariance = (SMatrix::identity() - gain * h) * *covariance;
}
