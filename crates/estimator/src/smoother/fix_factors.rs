//! A fix's observation of the pose in its image, as whitened rows.
//!
//! # Model
//! ```text
//! T' = T Exp(-(tau - tau_0) [v, 0, w]')          the pose at which the fix was true, if its delay is tau and not tau_0
//! h  = p' + R' (l + [tag_forward, tag_left]')    and th'
//! nu = z - h                                      angles wrapped
//! R  = [R_f + (v sigma_t)^2 I, sigma_th^2 + (w sigma_t)^2]
//! ```
//! # Source
//! docs/maths/pose.md section B2; R as in docs/maths/pose.md section 4.

use nalgebra::{Matrix2, Vector2};
use posebridge_telemetry::{Heading, quantities::wrap_rad};

use super::factors::WhitenedRow;
use super::problem::{AssociatedFix, SmoothingProblem};
use super::values::{FIX_DELAY, ProblemValues, TAG_FORWARD, TAG_LEFT, UnwrappedPose};
use crate::models::lie::Se2;
use crate::observations::fix::{FixContext, FixNoise, fix_noise};

/// No camera is better than a micrometre or a microradian: a fix without noise would weigh without bound.
const MIN_VARIANCE: f64 = 1e-12;

/// Rows for x, y and, if there is one, the heading of a fix; the third is empty otherwise. `None` when its covariance is none.
pub(super) fn fix_rows(
    problem: &SmoothingProblem<'_>,
    seen: &AssociatedFix,
    values: &ProblemValues,
) -> Option<([WhitenedRow; 3], u8)> {
    let noise = noise_of_fix(problem, seen);
    let white = noise.position.cholesky()?.l().try_inverse()?;
    let at = true_pose(values.poses[seen.node], seen, values);
    let (sin, cos) = at.heading_rad.sin_cos();
    let lever = lever_in_arena(seen, values, at);
    let seen_at = Vector2::new(seen.fix.position.x.0, seen.fix.position.y.0);
    let innovation = white * (seen_at - Vector2::new(at.x_m, at.y_m) - lever);
    // Minus the derivatives of h: of the pose's xi, of the delay, of the lever.
    let (v, w) = (seen.forward_m_per_s, seen.turn_rad_per_s);
    let ahead = -white * Vector2::new(cos, sin);
    let aside = -white * Vector2::new(-sin, cos);
    let turned = -white * Vector2::new(-lever.y, lever.x);
    let delayed = -(ahead * v + turned * w);
    let layout = problem.layout();
    let mut rows = [0, 1, 2].map(|axis| {
        if axis == 2 {
            return WhitenedRow::default();
        }
        let row = WhitenedRow::from_residual(innovation[axis])
            .with_derivative(layout.pose(seen.node, 0), ahead[axis])
            .with_derivative(layout.pose(seen.node, 1), aside[axis])
            .with_derivative(layout.pose(seen.node, 2), turned[axis]);
        let row = with_constant(problem, row, FIX_DELAY, delayed[axis]);
        let row = with_constant(problem, row, TAG_FORWARD, ahead[axis]);
        with_constant(problem, row, TAG_LEFT, aside[axis])
    });
    let Some(heading) = seen.fix.heading else {
        return Some((rows, 2));
    };
    let weight = 1.0 / noise.heading_rad2.max(MIN_VARIANCE).sqrt();
    let row = WhitenedRow::from_residual(weight * wrap_rad(heading.rad() - at.heading_rad))
        .with_derivative(layout.pose(seen.node, 2), -weight);
    rows[2] = with_constant(problem, row, FIX_DELAY, weight * w);
    Some((rows, 3))
}

fn with_constant(problem: &SmoothingProblem<'_>, row: WhitenedRow, constant: usize, derivative: f64) -> WhitenedRow {
    if problem.is_free[constant] { row.with_derivative(constant, derivative) } else { row }
}

fn noise_of_fix(problem: &SmoothingProblem<'_>, seen: &AssociatedFix) -> FixNoise {
    let mut noise = fix_noise(
        &seen.fix,
        &problem.config.noise,
        [1.0, 1.0],
        &FixContext {
            moved_since: Se2::default(),
            stamp_sigma_s: seen.stamp_sigma_s,
            forward_m_per_s: seen.forward_m_per_s,
            turn_rad_per_s: seen.turn_rad_per_s,
        },
    );
    noise.position += Matrix2::from_diagonal_element(MIN_VARIANCE);
    noise
}

/// Where the robot was when the fix was true.
fn true_pose(node: UnwrappedPose, seen: &AssociatedFix, values: &ProblemValues) -> UnwrappedPose {
    let earlier_s = values.constants[FIX_DELAY] - seen.delay_s;
    node.retract([-earlier_s * seen.forward_m_per_s, 0.0, -earlier_s * seen.turn_rad_per_s])
}

fn lever_in_arena(seen: &AssociatedFix, values: &ProblemValues, at: UnwrappedPose) -> Vector2<f64> {
    let (sin, cos) = at.heading_rad.sin_cos();
    let forward = seen.fix.tag_in_body.x.0 + values.constants[TAG_FORWARD];
    let left = seen.fix.tag_in_body.y.0 + values.constants[TAG_LEFT];
    Vector2::new(cos * forward - sin * left, sin * forward + cos * left)
}

/// The pose that a fix alone suggests, with this heading where it has none.
pub(super) fn pose_from_fix(seen: &AssociatedFix, values: &ProblemValues, heading_rad: f64) -> UnwrappedPose {
    let at = UnwrappedPose {
        x_m: seen.fix.position.x.0,
        y_m: seen.fix.position.y.0,
        heading_rad: seen.fix.heading.map_or(heading_rad, Heading::rad),
    };
    let lever = lever_in_arena(seen, values, at);
    UnwrappedPose { x_m: at.x_m - lever.x, y_m: at.y_m - lever.y, ..at }
}
