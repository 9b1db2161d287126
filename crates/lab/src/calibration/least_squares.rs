//! Nonlinear least squares over few unknowns, with standard deviations that assume no model of the noise.
//!
//! # Model
//! ```text
//! minimise  sum |r_k(p)|^2           r_k: two whitened residuals of the k-th sight of a run
//! (J'J + lambda D) delta = -J'r      D = diag(J'J); lambda falls after a good step and grows after a bad one
//! cov p = A^-1 B A^-1                A = sum J_k'J_k
//! B = sum_k s_k s_k' + sum_l (1 - l/(L+1)) sum_k (s_k s_k+l' + s_k+l s_k')     s_k = J_k' r_k
//! ```
//! Residuals of a drive are alike for seconds, because a wheel that has slipped leaves the path beside the truth. `A^-1` alone takes
//! each sight for news and claims far too much; the sums over neighbours in `B` count what is really new.
//!
//! # Sources
//! Marquardt (1963), SIAM Journal 11(2); Newey and West (1987), Econometrica 55(3), equation 5.

use super::CalibrationError;

/// The residuals of each run, in the order of time.
pub(super) type Residuals = Vec<Vec<[f64; 2]>>;

/// Steps after which it is said not to settle; five to ten are usual.
const MAX_ITERATIONS: u32 = 60;
/// Still, when no unknown moves by more than this share of its own difference step.
const CONVERGENCE_SHARE: f64 = 0.01;
/// How far apart residuals still count as alike, as a share of a run.
const CORRELATED_SHARE: f64 = 0.1;

/// The solution.
#[derive(Clone, Debug, Default)]
pub(super) struct LeastSquaresFit {
    /// The unknowns.
    pub(super) values: Vec<f64>,
    /// Their covariance.
    pub(super) covariance: Vec<Vec<f64>>,
}

impl LeastSquaresFit {
    /// One standard deviation of an unknown.
    pub(super) fn sigma(&self, unknown: usize) -> f64 {
        self.covariance[unknown][unknown].max(0.0).sqrt()
    }
}

/// Finds the unknowns from a start; `steps` are those of the central differences, one per unknown, in its unit.
///
/// The residuals must be as many at every place.
///
/// # Errors
/// [`CalibrationError::Undetermined`] when the residuals do not depend on an unknown or on each in its own way,
/// [`CalibrationError::Diverged`].
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
        let (normal, gradient) = normal_equations(&slopes, &here, values.len());
        let step = solve(&damp(&normal, damping), &gradient)?;
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

/// How far the solution moves when the residuals change by each of the `disturbances`, which are laid out as they are: -A^-1 J'd.
///
/// # Errors
/// As [`fit`].
pub(super) fn solution_shift(
    disturbances: impl Iterator<Item = Residuals>,
    values: &[f64],
    steps: &[f64],
    residuals: impl Fn(&[f64]) -> Residuals,
) -> Result<Vec<Vec<f64>>, CalibrationError> {
    let slopes = numeric_jacobian(values, steps, &residuals);
    let (normal, _) = normal_equations(&slopes, &residuals(values), values.len());
    let inverse = inverse(&normal)?;
    let moved = disturbances.map(|disturbance| {
        let (_, gradient) = normal_equations(&slopes, &disturbance, values.len());
        let row = |row: &Vec<f64>| -row.iter().zip(&gradient).map(|(a, g)| a * g).sum::<f64>();
        inverse.iter().map(row).collect()
    });
    Ok(moved.collect())
}

fn squared_cost(residuals: &Residuals) -> f64 {
    let all = residuals.iter().flatten().flatten();
    all.map(|r| r * r).sum()
}

/// Derivatives by each unknown, laid out as the residuals are.
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

/// J'r of one sight.
fn score(slopes: &[Residuals], run: usize, sight: usize, residual: [f64; 2]) -> Vec<f64> {
    let by_unknown = slopes.iter().map(|slope| {
        let slope = slope[run][sight];
        slope[0] * residual[0] + slope[1] * residual[1]
    });
    by_unknown.collect()
}

fn normal_equations(slopes: &[Residuals], residuals: &Residuals, unknowns: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
    let mut normal = zeros(unknowns);
    let mut gradient = vec![0.0; unknowns];
    for (run, sights) in residuals.iter().enumerate() {
        for (sight, residual) in sights.iter().enumerate() {
            let score = score(slopes, run, sight, *residual);
            for i in 0..unknowns {
                gradient[i] += score[i];
                for j in 0..unknowns {
                    let (a, b) = (slopes[i][run][sight], slopes[j][run][sight]);
                    normal[i][j] += a[0] * b[0] + a[1] * b[1];
                }
            }
        }
    }
    (normal, gradient)
}

fn robust_covariance(
    values: &[f64],
    steps: &[f64],
    residuals: &impl Fn(&[f64]) -> Residuals,
) -> Result<Vec<Vec<f64>>, CalibrationError> {
    let unknowns = values.len();
    let here = residuals(values);
    let slopes = numeric_jacobian(values, steps, residuals);
    let (normal, _) = normal_equations(&slopes, &here, unknowns);
    let mut middle = zeros(unknowns);
    for (run, sights) in here.iter().enumerate() {
        let scores: Vec<Vec<f64>> =
            sights.iter().enumerate().map(|(sight, residual)| score(&slopes, run, sight, *residual)).collect();
        add_correlated(&mut middle, &scores);
    }
    let inverse = inverse(&normal)?;
    Ok(product(&product(&inverse, &middle), &inverse))
}

/// The sums of B over one run.
fn add_correlated(middle: &mut [Vec<f64>], scores: &[Vec<f64>]) {
    let farthest = (scores.len() as f64 * CORRELATED_SHARE) as usize;
    for lag in 0..=farthest {
        let weight = 1.0 - lag as f64 / (farthest as f64 + 1.0);
        for (early, late) in scores.iter().zip(scores.iter().skip(lag)) {
            for (i, row) in middle.iter_mut().enumerate() {
                for (j, cell) in row.iter_mut().enumerate() {
                    let once = early[i] * late[j];
                    let both = if lag == 0 { once } else { once + late[i] * early[j] };
                    *cell += weight * both;
                }
            }
        }
    }
}

fn zeros(size: usize) -> Vec<Vec<f64>> {
    vec![vec![0.0; size]; size]
}

fn product(a: &[Vec<f64>], b: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let cell = |i: usize, j: usize| (0..b.len()).map(|k| a[i][k] * b[k][j]).sum();
    (0..a.len()).map(|i| (0..b.len()).map(|j| cell(i, j)).collect()).collect()
}

fn damp(normal: &[Vec<f64>], damping: f64) -> Vec<Vec<f64>> {
    let mut damped = normal.to_vec();
    for (i, row) in damped.iter_mut().enumerate() {
        row[i] *= 1.0 + damping;
    }
    damped
}

/// What is left of a pivot beside its row's own size below which its unknown is a mixture of the others.
const MIN_PIVOT: f64 = 1e-12;

/// The lower triangle L of L L' = D A D with ones on the diagonal of D A D, and D's diagonal.
fn cholesky_factor(matrix: &[Vec<f64>]) -> Result<(Vec<Vec<f64>>, Vec<f64>), CalibrationError> {
    let undetermined = CalibrationError::Undetermined("one of the unknowns changes nothing alone");
    let size = matrix.len();
    let mut scale = Vec::with_capacity(size);
    for (i, row) in matrix.iter().enumerate() {
        if !(row[i] > 0.0 && row[i].is_finite()) {
            return Err(undetermined);
        }
        scale.push(1.0 / row[i].sqrt());
    }
    let mut lower = zeros(size);
    for i in 0..size {
        for j in 0..=i {
            let done: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let rest = matrix[i][j] * scale[i] * scale[j] - done;
            if i == j {
                if rest.is_nan() || rest < MIN_PIVOT {
                    return Err(undetermined);
                }
                lower[i][i] = rest.sqrt();
            } else {
                lower[i][j] = rest / lower[j][j];
            }
        }
    }
    Ok((lower, scale))
}

/// Solves A x = b for a symmetric positive A.
///
/// # Errors
/// [`CalibrationError::Undetermined`]: A is singular.
pub(super) fn solve(matrix: &[Vec<f64>], right: &[f64]) -> Result<Vec<f64>, CalibrationError> {
    let (lower, scale) = cholesky_factor(matrix)?;
    let size = matrix.len();
    let mut x: Vec<f64> = right.iter().zip(&scale).map(|(b, s)| b * s).collect();
    for i in 0..size {
        let done: f64 = (0..i).map(|k| lower[i][k] * x[k]).sum();
        x[i] = (x[i] - done) / lower[i][i];
    }
    for i in (0..size).rev() {
        let done: f64 = (i + 1..size).map(|k| lower[k][i] * x[k]).sum();
        x[i] = (x[i] - done) / lower[i][i];
    }
    Ok(x.iter().zip(&scale).map(|(x, s)| x * s).collect())
}

fn inverse(matrix: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, CalibrationError> {
    let size = matrix.len();
    let column = |j: usize| {
        let unit: Vec<f64> = (0..size).map(|i| f64::from(u8::from(i == j))).collect();
        solve(matrix, &unit)
    };
    // Of a symmetric matrix columns are rows.
    (0..size).map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_system_is_solved() {
        let matrix = vec![vec![4.0, 2.0, 0.0], vec![2.0, 5.0, 3.0], vec![0.0, 3.0, 6.0]];
        // By hand: A (1, -2, 3)' = (0, 1, 12)'.
        let x = solve(&matrix, &[0.0, 1.0, 12.0]).unwrap();
        for (found, wanted) in x.iter().zip([1.0, -2.0, 3.0]) {
            assert!((found - wanted).abs() < 1e-12, "{x:?}");
        }
    }

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
