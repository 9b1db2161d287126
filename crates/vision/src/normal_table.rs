//! The standard normal distribution, from a table: a refinement asks for it a hundred thousand times.

use std::sync::LazyLock;

/// Beyond so many standard deviations nothing is left.
const NORMAL_REACH: f64 = 4.0;
const NORMAL_STEPS: usize = 64;
/// For [`normal`].
pub(crate) static NORMAL: LazyLock<Vec<(f64, f64)>> = LazyLock::new(|| {
    let half = (NORMAL_REACH * NORMAL_STEPS as f64) as i32;
    (-half..=half + 1).map(|index| exact_normal(f64::from(index) / NORMAL_STEPS as f64)).collect()
});

/// The standard normal distribution below `z`, and its density, from a table: within 1e-5.
pub(crate) fn normal(table: &[(f64, f64)], z: f64) -> (f64, f64) {
    let position = (z.clamp(-NORMAL_REACH, NORMAL_REACH) + NORMAL_REACH) * NORMAL_STEPS as f64;
    let index = position as usize;
    let share = position - index as f64;
    let ((below, density), (next_below, next_density)) = (table[index], table[index + 1]);
    (below + share * (next_below - below), density + share * (next_density - density))
}

fn exact_normal(z: f64) -> (f64, f64) {
    let density = 0.398_942_280_401_432_7 * (-0.5 * z * z).exp();
    // Abramowitz and Stegun 26.2.17: within 7.5e-8.
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let coefficients = [0.319_381_530, -0.356_563_782, 1.781_477_937, -1.821_255_978, 1.330_274_429];
    let series = coefficients.iter().rev().fold(0.0, |sum, coefficient| t * (coefficient + sum));
    let above = density * series;
    (if z < 0.0 { above } else { 1.0 - above }, density)
}
