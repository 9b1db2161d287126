//! Sums, lines and searches that several experiments need; means and quantiles are in [`posebridge_estimator::numerics::statistics`].

use posebridge_estimator::numerics::statistics::mean;
use posebridge_telemetry::UncertainValue;

/// A mean of values that come one by one; the last digits depend on their order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RunningMean {
    sum: f64,
    pub count: u64,
}

impl RunningMean {
    pub const fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    pub const fn merge(&mut self, other: &Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    /// Root of the mean: of squares their root mean square.
    pub fn root(&self) -> Option<f64> {
        self.mean().map(f64::sqrt)
    }
}

/// Mean, and variance of a single value; `None` with fewer than two.
pub(crate) fn mean_and_variance(values: &[f64]) -> Option<(f64, f64)> {
    let mean = mean(values.iter().copied())?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (mean, squares / (values.len() as f64 - 1.0)))
}

/// Zero without a point.
pub(crate) fn centroid(points: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|axis| mean(points.iter().map(|point| point[axis])).unwrap_or_default())
}

/// Mean of independent values with its standard deviation; `None` with fewer than two.
pub(crate) fn uncertain_mean(values: &[f64]) -> Option<UncertainValue> {
    let (value, variance) = mean_and_variance(values)?;
    Some(UncertainValue { value, sigma: (variance / values.len() as f64).sqrt() })
}

/// Sum of products of values `lag` apart.
pub(crate) fn lagged_sum(values: &[f64], lag: usize) -> f64 {
    values.iter().zip(values.iter().skip(lag)).map(|(a, b)| a * b).sum()
}

/// The variance of a sum of values that are correlated up to `lags` apart, with Bartlett's weights, which keep it positive.
///
/// Source: W. K. Newey, K. D. West, Econometrica 55(3), 1987.
pub(crate) fn correlated_variance(values: &[f64], lags: usize) -> f64 {
    let lagged = (1..=lags).map(|lag| 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * lagged_sum(values, lag));
    lagged_sum(values, 0) + lagged.sum::<f64>()
}

/// What residuals have in common with their neighbours: a model that is not exact leaves such ones.
pub(crate) struct ResidualCorrelation {
    /// Variance of the correlated part; 0 if not significant.
    pub(crate) model_variance: f64,
    /// Correlation length of that part, in samples.
    pub(crate) model_samples: f64,
    /// Samples per independent residual, white noise included.
    pub(crate) samples_per_residual: f64,
}

impl ResidualCorrelation {
    pub(crate) fn from_residuals(residuals: &[f64]) -> Self {
        let count = residuals.len().max(1);
        let covariance = |lag| lagged_sum(residuals, lag) / count as f64;
        let all = covariance(0);
        // Two standard deviations of the covariance of white noise.
        let chance = 2.0 * all / (count as f64).sqrt();
        let common: Vec<f64> = (1..count / 4).map(covariance).take_while(|covariance| *covariance > chance).collect();
        let sum: f64 = common.iter().sum();
        let Some(&next) = common.first() else {
            return Self { model_variance: 0.0, model_samples: 1.0, samples_per_residual: 1.0 };
        };
        Self {
            model_variance: next,
            model_samples: 1.0 + 2.0 * sum / next,
            samples_per_residual: 1.0 + 2.0 * sum / all,
        }
    }
}

/// Zero, and the sum up to each value.
pub(crate) fn running_sums(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let (mut sum, mut sums) = (0.0, vec![0.0]);
    sums.extend(values.into_iter().map(|value| {
        sum += value;
        sum
    }));
    sums
}

/// The value in the middle; of an even number the upper one.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// Start and length of the first longest run in which something holds.
pub(crate) fn longest_run(holds: impl IntoIterator<Item = bool>) -> (usize, usize) {
    let (mut longest, mut length) = ((0, 0), 0);
    for (index, holds) in holds.into_iter().enumerate() {
        length = if holds { length + 1 } else { 0 };
        if length > longest.1 {
            longest = (index + 1 - length, length);
        }
    }
    longest
}

/// The least-squares line through points (x, y).
pub(crate) struct FittedLine {
    /// Means of x and y: the line passes through them.
    pub(crate) centre: (f64, f64),
    pub(crate) slope: f64,
}

impl FittedLine {
    /// `None` unless x varies.
    pub(crate) fn through(points: &[(f64, f64)]) -> Option<Self> {
        let centre = (mean(points.iter().map(|(x, _)| *x))?, mean(points.iter().map(|(_, y)| *y))?);
        let (mut across, mut along) = (0.0, 0.0);
        for (x, y) in points {
            across += (x - centre.0) * (y - centre.1);
            along += (x - centre.0).powi(2);
        }
        (along > 0.0).then_some(Self { centre, slope: across / along })
    }

    /// y minus the line.
    pub(crate) fn residual(&self, (x, y): (f64, f64)) -> f64 {
        y - self.centre.1 - self.slope * (x - self.centre.0)
    }
}

/// Sums over pairs of vectors in the plane, of which a rotation lays the first ones on the second ones.
#[derive(Default)]
pub(crate) struct PairedVectors {
    pub(crate) dot: f64,
    pub(crate) cross: f64,
    /// Of the first ones and of the second ones.
    pub(crate) squares: [f64; 2],
}

impl PairedVectors {
    /// Pairs of points, each seen from its own centre.
    pub(crate) fn about(centres: [[f64; 2]; 2], pairs: impl IntoIterator<Item = [[f64; 2]; 2]>) -> Self {
        let mut sums = Self::default();
        for pair in pairs {
            let [a, b] = [0, 1].map(|which| [0, 1].map(|axis| pair[which][axis] - centres[which][axis]));
            sums.dot += a[0] * b[0] + a[1] * b[1];
            sums.cross += a[0] * b[1] - a[1] * b[0];
            sums.squares[0] += a[0] * a[0] + a[1] * a[1];
            sums.squares[1] += b[0] * b[0] + b[1] * b[1];
        }
        sums
    }

    /// The rotation that does it best by least squares.
    pub(crate) fn angle_rad(&self) -> f64 {
        self.cross.atan2(self.dot)
    }
}

/// The largest of `value` between `low` and `high`, if there is one peak; each step keeps 62 % of the bracket.
pub(crate) fn golden_section(mut low: f64, mut high: f64, steps: u32, value: impl Fn(f64) -> f64) -> f64 {
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    for _ in 0..steps {
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        if value(left) > value(right) {
            high = right;
        } else {
            low = left;
        }
    }
    f64::midpoint(low, high)
}

/// Two independent standard normal numbers from two uniform ones in [0, 1).
///
/// Source: G. E. P. Box, M. E. Muller, A note on the generation of random normal deviates, Ann. Math. Statist. 29(2), 1958.
pub(crate) fn normal_pair(u: f64, v: f64) -> [f64; 2] {
    let radius = (-2.0 * (1.0 - u).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
    [radius * cos, radius * sin]
}
