//! The damped Gauss-Newton descent, from a first guess to the values of least cost.
//!
//! ```text
//! (J'J + lambda I) delta = -J'r         Levenberg (1944); units of m, rad, rad/s, s, and one for the scales
//! ```
//! lambda is zero as long as the cost falls; a step that would raise it is rejected, and lambda grows.
//!
//! Source: docs/maths/pose.md section B3.

use super::forward_pass::{LinearizedProblem, PassContext, linearize};
use super::problem::ProblemValues;
use super::trajectory::OfflineError;

/// Most steps; a few are usual.
const MAX_STEPS: u32 = 100;
/// Converged when no unknown moves by more: ten nanometres, ten nanoradians.
const CONVERGED: f64 = 1e-8;
/// The first damping; the information of one good fix is ten thousand times that.
const INITIAL_DAMPING: f64 = 1.0;
/// Smaller damping is set to zero: earlier, the first undamped step would overshoot along the rows that are known to a
/// micrometre.
const MIN_DAMPING: f64 = 1e-6;
/// At this damping the step is far below a nanometre.
const MAX_DAMPING: f64 = 1e16;
/// Share of the cost by which rounding alone may raise it.
const ROUNDING: f64 = 1e-9;

/// The least cost and its values.
#[derive(Clone, Debug)]
pub(super) struct Optimum {
    pub(super) values: ProblemValues,
    /// Linearised there, undamped.
    pub(super) linearised: LinearizedProblem,
    pub(super) steps: u32,
}

/// Descends from `values`.
///
/// Errors: [`OfflineError::Diverged`] when no step lowers the cost, or they do not become small;
/// [`OfflineError::NotFinite`] when the first guess has no finite cost.
pub(super) fn minimize(ground: PassContext<'_, '_>, mut values: ProblemValues) -> Result<Optimum, OfflineError> {
    let layout = ground.problem.layout();
    let mut damping = 0.0;
    let mut here = linearize(ground, &values, damping);
    if !here.cost.is_finite() {
        return Err(OfflineError::NotFinite);
    }
    for steps in 1..=MAX_STEPS {
        let step = here.chain.solve(layout.count());
        let size = step.iter().fold(0.0_f64, |most, part| most.max(part.abs()));
        let mut there = values.clone();
        there.retract(layout, &step);
        // A maximum over NaN is none: the sum is checked as well.
        let is_finite = step.iter().sum::<f64>().is_finite();
        if is_finite && size < CONVERGED && damping == 0.0 {
            let linearised = linearize(ground, &there, 0.0);
            return Ok(Optimum { values: there, linearised, steps });
        }
        let tried = linearize(ground, &there, damping);
        if is_finite && tried.cost <= here.cost * (1.0 + ROUNDING) + ROUNDING {
            let relaxed = if damping > MIN_DAMPING { damping / 10.0 } else { 0.0 };
            values = there;
            here = if relaxed == damping { tried } else { linearize(ground, &values, relaxed) };
            damping = relaxed;
        } else {
            damping = (damping * 10.0).max(INITIAL_DAMPING);
            if damping > MAX_DAMPING {
                break;
            }
            here = linearize(ground, &values, damping);
        }
    }
    Err(OfflineError::Diverged { cost: here.cost })
}
