//! The update that works with an almost unknown heading: Gauss-Newton on one observation.
//!
//! # Model
//! ```text
//! minimise   c(xi) = xi' P^-1 xi + nu' R^-1 nu         nu the innovation at X exp xi
//! aim at     P H' S^-1 (nu + H xi)                     H taken at X exp xi, S = H P H' + R
//! xi <- xi + a (aim - xi)                              a = 1, 1/2, 1/4 ..: the first with which c falls
//! ```
//! With left-invariant errors an unknown heading is a straight line in xi however far the robot has gone, so that P says exactly
//! what is known; only the observation bends, and the iteration follows it. Whole steps would swing to and fro where a tag far from
//! mid-axle has been seen for long: there an innovation of millimetres bends the valley of c by radians. P may be singular (rows
//! that are certain), so xi = P y is sought by its y. The minimum is chi-square distributed like a NIS.
//!
//! # Source
//! Barrau and Bonnabel (2017); Bell and Cathey (1993) for the iterated update as Gauss-Newton; docs/maths/pose.md section 4.

use nalgebra::{SMatrix, SVector};

use super::state::{FORWARD, HEADING, LEFT, PoseState};
use crate::models::lie::Se2;
use crate::numerics::covariance::symmetrise;
use crate::update::LinearizedMeasurement;

/// Above this standard deviation of the heading an update is iterated, rad: at 0.15 rad the bend of a circle is 1 % of its radius.
pub(super) const ITERATE_ABOVE_RAD: f64 = 0.15;
/// From the far side of the circle it takes about twenty steps.
const MAX_STEPS: usize = 60;
/// A step is halved so often before it counts as none: to a thousandth.
const MAX_HALVINGS: usize = 10;
/// A step by which c falls no more has arrived: a thirty-thousandth of a sigma.
const CONVERGED: f64 = 1e-9;
/// The same after the last step, in a valley that is long and flat: a thirtieth of a sigma.
const NEARLY_CONVERGED: f64 = 1e-3;

/// What an iterated update found.
pub(super) struct IteratedUpdate<const N: usize> {
    /// The state after it.
    pub(super) state: PoseState<N>,
    /// The minimum: what a NIS is for a linear observation.
    pub(super) nis: f64,
}

/// Seeks the most likely correction; `None` when R or S has no inverse, or when the iteration does not arrive.
pub(super) fn iterate<const N: usize, const M: usize>(
    state: &PoseState<N>,
    measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
) -> Option<IteratedUpdate<N>> {
    let mut at = TrialStep::at(state, SVector::zeros(), measure)?;
    let mut fall = f64::INFINITY;
    for _ in 0..MAX_STEPS {
        let aim = at.gauss_newton_target(&state.covariance)?;
        let Some(next) = at.line_search(&aim, state, measure) else {
            // Nowhere on the way is it better than here, but for rounding.
            return at.to_update(state);
        };
        fall = at.cost - next.cost;
        at = next;
        if fall < CONVERGED {
            return at.to_update(state);
        }
    }
    if fall < NEARLY_CONVERGED { at.to_update(state) } else { None }
}

/// A correction that is tried.
struct TrialStep<const N: usize, const M: usize> {
    /// y of xi = P y.
    y: SVector<f64, N>,
    xi: SVector<f64, N>,
    /// Taken at X exp xi.
    measurement: LinearizedMeasurement<N, M>,
    /// c.
    cost: f64,
}

impl<const N: usize, const M: usize> TrialStep<N, M> {
    fn at(
        state: &PoseState<N>,
        y: SVector<f64, N>,
        measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
    ) -> Option<Self> {
        let xi = state.covariance * y;
        let measurement = measure(&corrected_state(state, &xi));
        let nu = measurement.innovation;
        let cost = y.dot(&xi) + nu.dot(&(measurement.noise.try_inverse()? * nu));
        cost.is_finite().then_some(Self { y, xi, measurement, cost })
    }

    /// The y of the correction that would be the most likely one if nothing bent.
    fn gauss_newton_target(&self, p: &SMatrix<f64, N, N>) -> Option<SVector<f64, N>> {
        let jacobian = self.measurement.jacobian * error_transport(&self.xi);
        let s = jacobian * p * jacobian.transpose() + self.measurement.noise;
        let nu = self.measurement.innovation;
        Some(jacobian.transpose() * (s.try_inverse()? * (nu + jacobian * self.xi)))
    }

    /// The first trial on the way to another y, from its end, that is better than this.
    fn line_search(
        &self,
        aim: &SVector<f64, N>,
        state: &PoseState<N>,
        measure: &impl Fn(&PoseState<N>) -> LinearizedMeasurement<N, M>,
    ) -> Option<Self> {
        let mut share = 1.0;
        for _ in 0..=MAX_HALVINGS {
            let y = self.y + (aim - self.y) * share;
            let better = Self::at(state, y, measure).filter(|next| next.cost < self.cost);
            if better.is_some() {
                return better;
            }
            share *= 0.5;
        }
        None
    }

    /// The state moved here, its covariance in the space that it has here.
    ///
    /// The errors that P holds besides the turn, those of the wheels and of earlier fixes, lie in the body's space wherever it points,
    /// and what the robot may turn about moves with it. So they are taken over as they are: turned by the correction, by its right
    /// Jacobian, they would give a robot at rest information about its heading, from nothing but the noise of its fixes.
    fn to_update(&self, state: &PoseState<N>) -> Option<IteratedUpdate<N>> {
        let p = &state.covariance;
        let jacobian = self.measurement.jacobian;
        let s = self.measurement.innovation_covariance(p);
        let gain = p * jacobian.transpose() * s.try_inverse()?;
        let mut settled = corrected_state(state, &self.xi);
        settled.covariance = p - gain * jacobian * p;
        symmetrise(&mut settled.covariance);
        Some(IteratedUpdate { state: settled, nis: self.cost })
    }
}

fn corrected_state<const N: usize>(state: &PoseState<N>, xi: &SVector<f64, N>) -> PoseState<N> {
    let mut moved = *state;
    moved.mean += xi;
    moved.inject();
    moved
}

/// How errors about X exp xi follow from errors about X.
fn error_transport<const N: usize>(xi: &SVector<f64, N>) -> SMatrix<f64, N, N> {
    let mut turn = SMatrix::identity();
    let of_pose = Se2::right_jacobian([xi[FORWARD], xi[LEFT], xi[HEADING]]);
    for row in 0..3 {
        for column in 0..3 {
            turn[(row, column)] = of_pose[(row, column)];
        }
    }
    turn
}
