//! Symmetry of covariance matrices, and the inverse of a singular one.

use nalgebra::{DMatrix, DVector, SMatrix, SymmetricEigen};

/// A direction whose eigenvalue of the correlations is below this share of the largest counts as certain.
const CERTAIN: f64 = 1e-11;

/// Makes a matrix exactly symmetric.
pub fn symmetrise<const N: usize>(matrix: &mut SMatrix<f64, N, N>) {
    for i in 0..N {
        for j in 0..i {
            let mean = 0.5 * (matrix[(i, j)] + matrix[(j, i)]);
            matrix[(i, j)] = mean;
            matrix[(j, i)] = mean;
        }
    }
}

/// The inverse of a covariance on its uncertain subspace, zero on the rest.
pub(crate) fn inverse_of_uncertain(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let n = covariance.nrows();
    let unit = DVector::from_fn(n, |i, _| {
        let variance = covariance[(i, i)];
        if variance > 0.0 { variance.sqrt().recip() } else { 0.0 }
    });
    let correlation = DMatrix::from_fn(n, n, |i, j| unit[i] * covariance[(i, j)] * unit[j]);
    let eigen = SymmetricEigen::new(correlation);
    let limit = CERTAIN * eigen.eigenvalues.amax();
    let mut inverse = DMatrix::zeros(n, n);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > limit {
            inverse += vector * vector.transpose() / *value;
        }
    }
    DMatrix::from_fn(n, n, |i, j| unit[i] * inverse[(i, j)] * unit[j])
}
