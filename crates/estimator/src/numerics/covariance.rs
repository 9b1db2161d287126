//! Symmetry of covariance matrices, and division by a singular one.

use nalgebra::{DMatrix, DVector, SMatrix};

/// A state of which the others leave less than this share of its variance counts as certain.
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

/// A P^-1 for a covariance P, by Cholesky's decomposition of the correlations. Rows of P that follow from those before them, and rows
/// of certain states, take no part.
pub(crate) fn times_inverse(a: &DMatrix<f64>, covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let n = covariance.nrows();
    let unit = DVector::from_fn(n, |i, _| {
        let variance = covariance[(i, i)];
        if variance > 0.0 { variance.sqrt().recip() } else { 0.0 }
    });
    // Row by row, as the decomposition reads it.
    let mut lower = vec![0.0; n * n];
    let mut kept: Vec<usize> = Vec::with_capacity(n);
    for i in 0..n {
        let mut pivot = unit[i] * covariance[(i, i)] * unit[i];
        for &j in &kept {
            let shared: f64 = kept.iter().take_while(|k| **k < j).map(|k| lower[i * n + k] * lower[j * n + k]).sum();
            let value = (unit[i] * covariance[(i, j)] * unit[j] - shared) / lower[j * n + j];
            lower[i * n + j] = value;
            pivot -= value * value;
        }
        if pivot > CERTAIN {
            lower[i * n + i] = pivot.sqrt();
            kept.push(i);
        }
    }
    let mut solved = DMatrix::zeros(a.nrows(), n);
    for row in 0..a.nrows() {
        for (position, &i) in kept.iter().enumerate() {
            let shared: f64 = kept[..position].iter().map(|k| lower[i * n + k] * solved[(row, *k)]).sum();
            solved[(row, i)] = (a[(row, i)] * unit[i] - shared) / lower[i * n + i];
        }
        for (position, &i) in kept.iter().enumerate().rev() {
            let shared: f64 = kept[position + 1..].iter().map(|k| lower[k * n + i] * solved[(row, *k)]).sum();
            solved[(row, i)] = (solved[(row, i)] - shared) / lower[i * n + i];
        }
    }
    DMatrix::from_fn(a.nrows(), n, |row, column| solved[(row, column)] * unit[column])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_from_other_rows_takes_no_part_in_the_inverse() {
        let regular = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]);
        // The second row of three is the first and the last together, the fourth is certain.
        let by = DMatrix::from_row_slice(4, 2, &[1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
        let covariance = &by * &regular * by.transpose();
        let a = DMatrix::from_row_slice(1, 2, &[0.3, -0.7]) * &regular * by.transpose();
        let solved = times_inverse(&a, &covariance);
        assert!((&solved * &covariance - &a).amax() < 1e-12, "{solved}");
        assert_eq!(solved[(0, 3)], 0.0);
    }
}
