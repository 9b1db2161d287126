//! What ties the unknowns together besides motion and fixes: start, gyro windows, walks and priors, as whitened rows.
//!
//! # Model
//! ```text
//! r = G - (th_to - th_from) - b_g T        a gyro window
//! r = b_g - b_g of the window before       the bias walks from window to window
//! ```
//! A row is a residual over its sigma with its derivatives; the cost is the sum of the squares.
//!
//! # Source
//! docs/maths/pose.md section B2.

use posebridge_telemetry::quantities::wrap_rad;

use super::problem::{GyroInterval, SmoothingProblem};
use super::values::{ProblemValues, UnwrappedPose, VariableLayout, constants_of};
use crate::filter::{FilterConfig, StartPose};
use crate::numerics::elimination::Variable;

/// Most unknowns in one row: two poses and three constants.
pub(super) const MAX_ROW_ENTRIES: usize = 9;
/// Least sigma of a start, a bias or a constant, in its own unit.
const MIN_SIGMA: f64 = 1e-7;
/// Sigma of an unknown start, m: anywhere on a large site. Fixes then decide.
const UNKNOWN_POSITION_SIGMA_M: f64 = 1e4;
/// Any heading at all, rad: so much more than a turn that it says nothing.
const UNKNOWN_HEADING_SIGMA_RAD: f64 = 1e2;

/// A residual over its sigma and its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WhitenedRow {
    entries: [(Variable, f64); MAX_ROW_ENTRIES],
    count: usize,
    /// The residual.
    pub(super) residual: f64,
}

impl WhitenedRow {
    /// A row without derivatives yet.
    pub(super) fn from_residual(residual: f64) -> Self {
        Self { residual, ..Self::default() }
    }

    /// Adds a derivative; there is room for all that a row of ours has.
    pub(super) fn with_derivative(mut self, variable: Variable, derivative: f64) -> Self {
        if let Some(entry) = self.entries.get_mut(self.count) {
            *entry = (variable, derivative);
            self.count += 1;
        }
        self
    }

    /// The derivatives by variable.
    pub(super) fn entries(&self) -> &[(Variable, f64)] {
        &self.entries[..self.count]
    }
}

/// The configured start, or anywhere.
pub(super) fn start_rows(config: &FilterConfig, layout: VariableLayout, first: UnwrappedPose) -> [WhitenedRow; 3] {
    let start = config.start.unwrap_or(StartPose {
        pose: first.to_pose(),
        position_sigma_m: UNKNOWN_POSITION_SIGMA_M,
        heading_sigma_rad: UNKNOWN_HEADING_SIGMA_RAD,
    });
    let position = 1.0 / start.position_sigma_m.max(MIN_SIGMA);
    let heading = 1.0 / start.heading_sigma_rad.max(MIN_SIGMA);
    let (sin, cos) = first.heading_rad.sin_cos();
    let told = UnwrappedPose::from_pose(start.pose);
    let turn_rad = wrap_rad(first.heading_rad - told.heading_rad);
    let (forward, left) = (layout.pose(0, 0), layout.pose(0, 1));
    [
        WhitenedRow::from_residual(position * (first.x_m - told.x_m))
            .with_derivative(forward, position * cos)
            .with_derivative(left, -position * sin),
        WhitenedRow::from_residual(position * (first.y_m - told.y_m))
            .with_derivative(forward, position * sin)
            .with_derivative(left, position * cos),
        WhitenedRow::from_residual(heading * turn_rad).with_derivative(layout.pose(0, 2), heading),
    ]
}

/// A constant's prior.
pub(super) fn constant_row(config: &FilterConfig, constant: usize, value: f64) -> WhitenedRow {
    let prior = constants_of(&config.calibration)[constant];
    let weight = 1.0 / prior.sigma.max(f64::MIN_POSITIVE);
    WhitenedRow::from_residual(weight * (value - prior.value)).with_derivative(constant, weight)
}

/// The prior of the gyro bias: its mean and one standard deviation, rad/s.
pub(super) fn bias_prior(config: &FilterConfig) -> (f64, f64) {
    let known = config.calibration.gyro_bias_rad_per_s;
    let sigma = if known.sigma > 0.0 { known.sigma } else { config.noise.gyro_bias_rad_per_s };
    (known.value, sigma.max(MIN_SIGMA))
}

/// What is known of the bias over a window before the gyro is looked at: its prior, or its walk since the window before.
pub(super) fn bias_row(problem: &SmoothingProblem<'_>, values: &ProblemValues, window: usize) -> WhitenedRow {
    let bias = values.biases[window];
    let Some(before) = window.checked_sub(1) else {
        let (mean, sigma) = bias_prior(problem.config);
        return WhitenedRow::from_residual((bias - mean) / sigma)
            .with_derivative(VariableLayout::bias(window), 1.0 / sigma);
    };
    let walk = problem.config.noise.gyro_bias_walk_rad_per_s_sqrt_s;
    let sigma = walk * problem.windows[window].since_last_s.max(0.0).sqrt();
    let weight = 1.0 / sigma.max(MIN_SIGMA);
    WhitenedRow::from_residual(weight * (bias - values.biases[before]))
        .with_derivative(VariableLayout::bias(window), weight)
        .with_derivative(VariableLayout::bias(before), -weight)
}

/// The gyro's turn over a window against that of the poses.
pub(super) fn window_row(
    layout: VariableLayout,
    window: &GyroInterval,
    index: usize,
    values: &ProblemValues,
) -> WhitenedRow {
    let weight = 1.0 / window.variance.sqrt();
    let turn_rad = values.poses[window.to].heading_rad - values.poses[window.from].heading_rad;
    let residual = window.turn_rad - turn_rad - values.biases[index] * window.length_s;
    let row = WhitenedRow::from_residual(weight * residual)
        .with_derivative(VariableLayout::bias(index), -weight * window.length_s);
    if window.from == window.to {
        return row;
    }
    row.with_derivative(layout.pose(window.from, 2), weight).with_derivative(layout.pose(window.to, 2), -weight)
}
