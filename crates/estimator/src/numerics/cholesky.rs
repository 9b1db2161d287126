//! Cholesky's decomposition of small matrices, and what it solves.

use nalgebra::{SMatrix, SVector};

/// Cholesky's factor; `None` when the matrix is not positive definite.
pub(crate) fn lower_triangle<const M: usize>(matrix: &SMatrix<f64, M, M>) -> Option<SMatrix<f64, M, M>> {
    let root_of = |_, pivot: f64| {
        let is_positive = pivot > 0.0 && pivot.is_finite();
        is_positive.then(|| pivot.sqrt()).ok_or(())
    };
    factorise(matrix, root_of).ok()
}

/// Cholesky's decomposition L L' of a symmetric matrix; reads only the lower triangle. `root_of` maps a row and its
/// pivot (the remaining diagonal) to the diagonal of L; zero makes the whole column zero.
///
/// Errors: the first of `root_of`.
pub fn factorise<const M: usize, E>(
    matrix: &SMatrix<f64, M, M>,
    root_of: impl Fn(usize, f64) -> Result<f64, E>,
) -> Result<SMatrix<f64, M, M>, E> {
    let mut lower = SMatrix::<f64, M, M>::zeros();
    for j in 0..M {
        let mut pivot = matrix[(j, j)];
        for k in 0..j {
            pivot -= lower[(j, k)] * lower[(j, k)];
        }
        let root = root_of(j, pivot)?;
        if root == 0.0 {
            continue;
        }
        lower[(j, j)] = root;
        for i in j + 1..M {
            let mut value = matrix[(i, j)];
            for k in 0..j {
                value -= lower[(i, k)] * lower[(j, k)];
            }
            lower[(i, j)] = value / root;
        }
    }
    Ok(lower)
}

/// L^-1 times a vector, by forward substitution.
pub fn solve_lower<const M: usize>(lower: &SMatrix<f64, M, M>, right: &SVector<f64, M>) -> SVector<f64, M> {
    let mut solved = *right;
    for i in 0..M {
        for k in 0..i {
            solved[i] -= lower[(i, k)] * solved[k];
        }
        solved[i] /= lower[(i, i)];
    }
    solved
}
