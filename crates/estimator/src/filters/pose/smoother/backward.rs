//! The backward pass: from the smoothed state after a step to that after the step before.

use nalgebra::{DMatrix, DVector};

use super::super::PublishedPose;
use super::super::context::UpdateContext;
use super::super::state::PoseState;
use super::forward::AugmentedRows;
use crate::numerics::covariance::times_inverse;
use crate::observations::gyro_window::rounding_variance;
use crate::smoother::SmoothedPose;

/// The correction of the filter's state after a step by all later ones, and the smoothed covariance.
pub(super) struct SmoothedStep {
    correction: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl SmoothedStep {
    /// Without later steps the filter's state is the smoothed one.
    pub(super) fn last<const N: usize>(state: &PoseState<N>, rows: &AugmentedRows) -> Self {
        Self { correction: DVector::zeros(rows.states), covariance: filtered(state, rows) }
    }

    /// The step before: `later` has the copy of the state after it, `earlier` is that state.
    pub(super) fn back<const N: usize>(
        &self,
        later: &PoseState<N>,
        earlier: &PoseState<N>,
        gain: &DMatrix<f64>,
        rows: &AugmentedRows,
    ) -> Self {
        let (n, first) = (rows.states, rows.copy(0));
        // What does not change is corrected by all that was learned since.
        let mut correction = DVector::from_fn(n, |row, _| later.mean[row] - earlier.mean[row] + self.correction[row]);
        let of_copies = gain * &self.correction;
        let learned = &self.covariance - filtered(later, rows);
        let gain_learned = gain * learned;
        let of_copies_covariance = &gain_learned * gain.transpose();
        let mut covariance = self.covariance.clone();
        for (i, &row) in rows.copied.iter().enumerate() {
            correction[row] = later.mean[first + i] + of_copies[i];
            for column in 0..n {
                let value = later.covariance[(first + i, column)] + gain_learned[(i, column)];
                covariance[(row, column)] = value;
                covariance[(column, row)] = value;
            }
        }
        for (i, &row) in rows.copied.iter().enumerate() {
            for (j, &column) in rows.copied.iter().enumerate() {
                let own = later.covariance[(first + i, first + j)];
                let moved = 0.5 * (of_copies_covariance[(i, j)] + of_copies_covariance[(j, i)]);
                covariance[(row, column)] = own + moved;
            }
        }
        Self { correction, covariance }
    }

    /// The smoothed state; its speeds are the filter's.
    pub(super) fn state<const N: usize>(&self, filtered: &PoseState<N>, rows: &AugmentedRows) -> PoseState<N> {
        let mut state = *filtered;
        state.covariance.fill(0.0);
        for row in 0..rows.states {
            state.mean[row] += self.correction[row];
            for column in 0..rows.states {
                state.covariance[(row, column)] = self.covariance[(row, column)];
            }
        }
        state.inject();
        state
    }
}

/// Cov(copy, state) Cov(state)^-1 after a step.
pub(super) fn smoother_gain<const N: usize>(state: &PoseState<N>, rows: &AugmentedRows) -> DMatrix<f64> {
    let cross = DMatrix::from_fn(rows.copied.len(), rows.states, |i, column| state.covariance[(rows.copy(i), column)]);
    times_inverse(&cross, &filtered(state, rows))
}

fn filtered<const N: usize>(state: &PoseState<N>, rows: &AugmentedRows) -> DMatrix<f64> {
    DMatrix::from_fn(rows.states, rows.states, |row, column| state.covariance[(row, column)])
}

/// The pose of a smoothed state at its timestamp. To the filter the encoders' rounding is no error of a heading, because it is gone
/// with the next count. A path that is known to a fraction of a count has it at every instant.
pub(super) fn published<const N: usize>(smoothed: &PoseState<N>, context: &UpdateContext) -> Option<SmoothedPose> {
    let geometry = &context.config.geometry;
    let rounding_rad2 = rounding_variance(geometry);
    let mut shown = PublishedPose::from_state(smoothed).without_odometry_delay(smoothed, context);
    shown.covariance[2][2] += rounding_rad2;
    // Half of the sum of the wheels' errors, where the heading has their difference over the track.
    shown.covariance[0][0] += 0.25 * geometry.track_width.0.powi(2) * rounding_rad2;
    let covariance = smoothed.covariance_in_arena(shown.pose.heading_rad, &shown.covariance);
    Some(SmoothedPose {
        stamp: smoothed.stamp?,
        pose: super::super::state::arena_pose(shown.pose),
        covariance: [0, 1, 2].map(|row| [0, 1, 2].map(|column| covariance[row][column])),
    })
}
