//! The update that bears a heading of which almost nothing is known: Gauss-Newton on one observation.
//!
//! # Model
//! ```text
//! minimise   xi' P^-1 xi + |z - h(X exp xi)|^2 by R^-1
//! xi <- P H' S^-1 (nu(xi) + H xi)        H taken at X exp xi, S = H P H' + R
//! ```
//! With left-invariant errors an unknown heading is a straight line in xi however far the robot has gone, so that P says exactly
//! what is known; only the observation bends, and the iteration follows it. The minimum is chi-square distributed like a NIS.
//!
//! # Source
//! Barrau and Bonnabel (2017); Bell and Cathey (1993) for the iterated update as Gauss-Newton; docs/maths/pose.md section 4.

use nalgebra::{SMatrix, SVector};

use super::state::{FORWARD, HEADING, LEFT, PoseState};
use crate::models::lie::Se2;
use crate::update::{Measurement, symmetrise};

/// Above this standard deviation of the heading an update is iterated, rad: at 0.15 rad the bend of a circle is 1 % of its radius.
pub(super) const ITERATE_ABOVE_RAD: f64 = 0.15;
/// From the far side of the circle it takes about twenty steps.
const MOST_STEPS: usize = 60;
/// A correction that moves no more than this in any row has arrived.
const ARRIVED: f64 = 1e-9;

/// What an iterated update found.
pub(super) struct Found<const N: usize> {
    /// The state after it.
    pub(super) state: PoseState<N>,
    /// The minimum: what a NIS is for a linear observation.
    pub(super) nis: f64,
}

/// Seeks the most likely correction; `None` when S is not positive definite or the iteration does not arrive.
pub(super) fn iterate<const N: usize, const M: usize>(
    state: &PoseState<N>,
    measure: &impl Fn(&PoseState<N>) -> Measurement<N, M>,
) -> Option<Found<N>> {
    let p = &state.covariance;
    let mut xi = SVector::<f64, N>::zeros();
    for _ in 0..MOST_STEPS {
        let moved = moved_by(state, &xi);
        let measurement = measure(&moved);
        let jacobian = measurement.jacobian * turned(&xi);
        let s = jacobian * p * jacobian.transpose() + measurement.noise;
        let weighted = s.try_inverse()? * (measurement.innovation + jacobian * xi);
        let next = p * jacobian.transpose() * weighted;
        let step = next - xi;
        xi = next;
        if step.amax() < ARRIVED {
            return settle(state, &xi, measure);
        }
    }
    None
}

/// The state at the minimum, its covariance in the space that it has there.
fn settle<const N: usize, const M: usize>(
    state: &PoseState<N>,
    xi: &SVector<f64, N>,
    measure: &impl Fn(&PoseState<N>) -> Measurement<N, M>,
) -> Option<Found<N>> {
    let p = &state.covariance;
    let mut settled = moved_by(state, xi);
    let measurement = measure(&settled);
    let turn = turned(xi);
    let jacobian = measurement.jacobian * turn;
    let s = jacobian * p * jacobian.transpose() + measurement.noise;
    let inverse = s.try_inverse()?;
    let gain = p * jacobian.transpose() * inverse;
    let weighted = inverse * (measurement.innovation + jacobian * xi);
    let of_prior = (weighted.transpose() * jacobian * p * jacobian.transpose() * weighted)[0];
    let of_noise = (measurement.innovation.transpose()
        * measurement.noise.try_inverse()?
        * measurement.innovation)[0];
    settled.covariance = turn * (p - gain * jacobian * p) * turn.transpose();
    symmetrise(&mut settled.covariance);
    Some(Found {
        state: settled,
        nis: of_prior + of_noise,
    })
}

fn moved_by<const N: usize>(state: &PoseState<N>, xi: &SVector<f64, N>) -> PoseState<N> {
    let mut moved = *state;
    moved.mean += xi;
    moved.inject();
    moved
}

/// How errors about X exp xi follow from errors about X.
fn turned<const N: usize>(xi: &SVector<f64, N>) -> SMatrix<f64, N, N> {
    let mut turn = SMatrix::identity();
    let of_pose = Se2::right_jacobian([xi[FORWARD], xi[LEFT], xi[HEADING]]);
    for row in 0..3 {
        for column in 0..3 {
            turn[(row, column)] = of_pose[(row, column)];
        }
    }
    turn
}
