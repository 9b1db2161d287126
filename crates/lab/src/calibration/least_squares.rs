//! Nonlinear least squares with few unknowns; its standard deviations assume no model of the noise.
//!
//! # Model
//! ```text
//! minimise  sum |r_k(p)|^2           r_k: two whitened residuals of the k-th fix of a run
//! (J'J + lambda D) delta = -J'r      D = diag(J'J); lambda falls after a good step and grows after a bad one
//! cov p = A^-1 B A^-1                A = sum J_k'J_k
//! B = sum_k s_k s_k' + sum_l (1 - l/(L+1)) sum_k (s_k s_k+l' + s_k+l s_k')     s_k = J_k' r_k
//! ```
//! Residuals of a drive are correlated for seconds, because a wheel that has slipped leaves the path beside the truth. `A^-1` alone
//! treats each fix as independent and is far too optimistic; the sums over neighbours in `B` account for the correlation.
//!
//! # Sources
//! Marquardt (1963), SIAM Journal 11(2); Newey and West (1987), Econometrica 55(3), equation 5.

use std::ops::AddAssign as _;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::CalibrationError;

/// Of each run, in time order.
pub(super) type Residuals = Vec<Vec<[f64; 2]>>;

/// Iterations before the fit counts as not converging; five to ten are usual.
const MAX_ITERATIONS: u32 = 60;
/// Converged when no unknown changes by more than this share of its difference step.
const CONVERGENCE_SHARE: f64 = 0.01;
/// Lag up to which residuals count as correlated, as a share of a run.
const CORRELATED_SHARE: f64 = 0.1;

#[derive(Clone, Debug, Default)]
pub(super) struct LeastSquaresFit {
    pub(super) values: Vec<f64>,
    covariance: DMatrix<f64>,
}

impl LeastSquaresFit {
    pub(super) fn sigma(&self, unknown: usize) -> f64 {
        self.covariance[(unknown, unknown)].max(0.0).sqrt()
    }
}

/// Estimates the unknowns from a start; `steps` are those of the central differences, one per unknown, in its unit.
///
/// The number of residuals must not depend on the unknowns.
pub(super) fn fit(
    start: &[f64],
    steps: &[f64],
    residuals: impl Fn(&[f64]) -> Residuals,
) -> Result<LeastSquaresFit, CalibrationError> {
    let mut values = start.to_vec();
    let mut here = residuals(&values);
    let mut cost = squared_cost(&here);
    let mut damping = 0.0;
    for _ in 0..MAX_ITERATIONS {
        let slopes = numeric_jacobian(&values, steps, &residuals);
        let (mut normal, gradient) = normal_equations(&slopes, &here);
        for i in 0..values.len() {
            normal[(i, i)] *= 1.0 + damping;
        }
        let step = ScaledCholesky::new(&normal)?.solve(&gradient);
        let moved: Vec<f64> = values.iter().zip(&step).map(|(v, d)| v - d).collect();
        let there = residuals(&moved);
        let moved_cost = squared_cost(&there);
        let is_still = step.iter().zip(steps).all(|(d, h)| d.abs() <= CONVERGENCE_SHARE * h);
        // At the optimum rounding decides which of two costs is the smaller.
        if moved_cost <= cost * (1.0 + 1e-12) {
            (values, here, cost) = (moved, there, moved_cost);
            damping *= 0.1;
            if damping < 1e-9 {
                damping = 0.0;
            }
        } else {
            damping = (damping * 10.0).max(1e-6);
        }
        if is_still {
            let covariance = robust_covariance(&values, steps, &residuals)?;
            return Ok(LeastSquaresFit { values, covariance });
        }
    }
    Err(CalibrationError::Diverged)
}

/// Change of the solution when the residuals change by each of the `disturbances` (same layout): -A^-1 J'd.
pub(super) fn solution_shift(
    disturbances: impl Iterator<Item = Residuals>,
    values: &[f64],
    steps: &[f64],
    residuals: impl Fn(&[f64]) -> Residuals,
) -> Result<Vec<Vec<f64>>, CalibrationError> {
    let slopes = numeric_jacobian(values, steps, &residuals);
    let (normal, _) = normal_equations(&slopes, &residuals(values));
    let factor = ScaledCholesky::new(&normal)?;
    let moved = disturbances.map(|disturbance| {
        let (_, gradient) = normal_equations(&slopes, &disturbance);
        (-factor.solve(&gradient)).iter().copied().collect()
    });
    Ok(moved.collect())
}

fn squared_cost(residuals: &Residuals) -> f64 {
    let all = residuals.iter().flatten().flatten();
    all.map(|r| r * r).sum()
}

/// Derivatives by each unknown, in the layout of the residuals.
fn numeric_jacobian(values: &[f64], steps: &[f64], residuals: &impl Fn(&[f64]) -> Residuals) -> Vec<Residuals> {
    let mut at = values.to_vec();
    let mut slopes = Vec::with_capacity(values.len());
    for (unknown, step) in steps.iter().enumerate() {
        at[unknown] = values[unknown] + step;
        let mut above = residuals(&at);
        at[unknown] = values[unknown] - step;
        let below = residuals(&at);
        at[unknown] = values[unknown];
        for (up, down) in above.iter_mut().flatten().zip(below.iter().flatten()) {
            *up = [0, 1].map(|axis| (up[axis] - down[axis]) / (2.0 * step));
        }
        slopes.push(above);
    }
    slopes
}

fn score(slopes: &[Residuals], run: usize, fix: usize, residual: [f64; 2]) -> DVector<f64> {
    DVector::from_fn(slopes.len(), |unknown, _| {
        let slope = slopes[unknown][run][fix];
        slope[0] * residual[0] + slope[1] * residual[1]
    })
}

fn normal_equations(slopes: &[Residuals], residuals: &Residuals) -> (DMatrix<f64>, DVector<f64>) {
    let unknowns = slopes.len();
    let mut normal = DMatrix::zeros(unknowns, unknowns);
    let mut gradient = DVector::zeros(unknowns);
    for (run, fixes) in residuals.iter().enumerate() {
        for (fix, residual) in fixes.iter().enumerate() {
            gradient += score(slopes, run, fix, *residual);
            for (j, slope) in slopes.iter().enumerate() {
                let column = score(slopes, run, fix, slope[run][fix]);
                normal.column_mut(j).add_assign(&column);
            }
        }
    }
    (normal, gradient)
}

fn robust_covariance(
    values: &[f64],
    steps: &[f64],
    residuals: &impl Fn(&[f64]) -> Residuals,
) -> Result<DMatrix<f64>, CalibrationError> {
    let here = residuals(values);
    let slopes = numeric_jacobian(values, steps, residuals);
    let (normal, _) = normal_equations(&slopes, &here);
    let mut middle = DMatrix::zeros(values.len(), values.len());
    for (run, fixes) in here.iter().enumerate() {
        let scores: Vec<DVector<f64>> =
            fixes.iter().enumerate().map(|(fix, residual)| score(&slopes, run, fix, *residual)).collect();
        add_correlated(&mut middle, &scores);
    }
    let inverse = ScaledCholesky::new(&normal)?.inverse();
    Ok(&inverse * middle * &inverse)
}

fn add_correlated(middle: &mut DMatrix<f64>, scores: &[DVector<f64>]) {
    let farthest = (scores.len() as f64 * CORRELATED_SHARE) as usize;
    for lag in 0..=farthest {
        let weight = 1.0 - lag as f64 / (farthest as f64 + 1.0);
        for (early, late) in scores.iter().zip(scores.iter().skip(lag)) {
            middle.ger(weight, early, late, 1.0);
            if lag > 0 {
                middle.ger(weight, late, early, 1.0);
            }
        }
    }
}

/// Pivot relative to its row below which its unknown is a linear combination of the others.
const MIN_PIVOT: f64 = 1e-12;

/// Cholesky factor of D A D with ones on its diagonal, and D's diagonal: the units of the unknowns differ by orders of magnitude.
pub(super) struct ScaledCholesky {
    factor: Cholesky<f64, Dyn>,
    scale: DVector<f64>,
}

impl ScaledCholesky {
    /// A must be symmetric and positive definite.
    pub(super) fn new(matrix: &DMatrix<f64>) -> Result<Self, CalibrationError> {
        let undetermined = || CalibrationError::Undetermined("one of the unknowns changes nothing alone");
        let scale = matrix.diagonal().map(|own| own.sqrt().recip());
        if !scale.iter().all(|scale| *scale > 0.0 && scale.is_finite()) {
            return Err(undetermined());
        }
        let factor = scaled(matrix, &scale).cholesky().ok_or_else(undetermined)?;
        let is_regular = factor.l_dirty().diagonal().iter().all(|root| root * root >= MIN_PIVOT);
        if is_regular { Ok(Self { factor, scale }) } else { Err(undetermined()) }
    }

    pub(super) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        self.factor.solve(&right.component_mul(&self.scale)).component_mul(&self.scale)
    }

    fn inverse(&self) -> DMatrix<f64> {
        scaled(&self.factor.inverse(), &self.scale)
    }
}

fn scaled(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] * scale[i] * scale[j])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknowns_that_act_alike_are_refused() {
        let residuals = |p: &[f64]| vec![vec![[p[0] + p[1] - 1.0, 2.0 * (p[0] + p[1])]; 4]];
        let found = fit(&[0.0, 0.0], &[1e-4; 2], residuals);
        assert!(matches!(found, Err(CalibrationError::Undetermined(_))));
    }

    #[test]
    fn a_bent_valley_is_followed_to_its_end() {
        // Rosenbrock (1960): the minimum is at (1, 1).
        let residuals = |p: &[f64]| vec![vec![[10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0]]]];
        let found = fit(&[-1.2, 1.0], &[1e-6; 2], residuals).unwrap();
        assert!((found.values[0] - 1.0).abs() < 1e-6 && (found.values[1] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn residuals_that_repeat_do_not_make_the_mean_better_known() {
        // The mean of 200 numbers, each repeated five times in a row: 40 numbers of variance one.
        let data: Vec<f64> = (0..200_u32).map(|i| if (i / 5).is_multiple_of(2) { 1.0 } else { -1.0 }).collect();
        let draws: Vec<f64> =
            data.iter().enumerate().map(|(i, v)| if (i / 50).is_multiple_of(2) { *v } else { -*v }).collect();
        let sigma = |values: &[f64]| {
            let residuals = |p: &[f64]| vec![values.iter().map(|v| [v - p[0], 0.0]).collect::<Vec<_>>()];
            fit(&[0.3], &[1e-4], residuals).unwrap().sigma(0)
        };
        let constant_by_block: Vec<f64> = (0..200_u32).map(|i| f64::from((i / 20 * 7 % 5) as i32 - 2)).collect();
        let shuffled: Vec<f64> = (0..200_u32).map(|i| f64::from((i * 7 % 5) as i32 - 2)).collect();
        assert!(sigma(&constant_by_block) > 3.0 * sigma(&shuffled));
        // Alternating blocks cancel; what is white keeps the textbook's sigma within a third.
        assert!(sigma(&draws) < 1.0 / 200.0_f64.sqrt());
    }
}
