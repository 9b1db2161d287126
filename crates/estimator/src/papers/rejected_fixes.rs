//! Recovery of a filter whose gate rejects one fix after the other.
//!
//! ```text
//! z_i   the tag by the last three rejected fixes          q_i   the tag by the filter, which follows the wheels alone
//! q_i - mean(q) turned by d = z_i - mean(z)               d = atan2(sum q x z, sum q . z), least squares
//! ```
//! Errors of the camera are not a rigid motion of the driven path; a wrong pose is. So three rejected fixes that agree
//! with the path up to one shift and one turn move the pose, and three outliers do not.
//!
//! Source: Umeyama (1991) for the turn of least squares; docs/lab/square.md section M5.

use posebridge_telemetry::{BrickClock, Timestamp, UncertainValue, quantities::wrap_rad};
use serde::{Deserialize, Serialize};

use crate::saved::finite;

const COUNT: usize = 3;
/// Root mean square distance of the positions from their middle that makes a heading, m.
const MIN_SPREAD_M: f64 = 0.04;
/// Error of the driven path as a share of its extent: slip and wrong radii.
const PATH_ERROR: f64 = 0.1;
/// Largest residual in sigmas of a fix.
const MAX_SIGMAS: f64 = 3.0;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RejectedFix {
    pub(super) stamp: Timestamp<BrickClock>,
    /// The tag by the fix.
    #[serde(deserialize_with = "finite")]
    pub(super) measured_m: [f64; 2],
    /// The tag by the filter.
    #[serde(deserialize_with = "finite")]
    pub(super) expected_m: [f64; 2],
    /// Heading by the fix less that by the filter.
    pub(super) turn_rad: Option<UncertainValue>,
}

/// The last fixes that were rejected without one that was used between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RejectedFixes([Option<RejectedFix>; COUNT]);

impl RejectedFixes {
    /// One of an instant that is already here, or is older, counts once.
    pub(super) fn push(&mut self, fix: RejectedFix) {
        let last = self.0[COUNT - 1].map(|last| last.stamp);
        if last.is_none_or(|last| last < fix.stamp) {
            self.0.rotate_left(1);
            self.0[COUNT - 1] = Some(fix);
        }
    }

    /// The turn by which the filter's path lies on the fixes, whose position has this sigma; `None` without three fixes
    /// and where they do not agree with it.
    pub(super) fn common_turn(&self, sigma_m: f64) -> Option<UncertainValue> {
        let [Some(a), Some(b), Some(c)] = self.0 else {
            return None;
        };
        let fixes = [a, b, c];
        let measured = about_their_middle(fixes.map(|fix| fix.measured_m));
        let expected = about_their_middle(fixes.map(|fix| fix.expected_m));
        let spread_m = (sum_of(&expected, &expected, dot) / COUNT as f64).sqrt();
        let turn = if spread_m >= MIN_SPREAD_M {
            let value = sum_of(&expected, &measured, cross).atan2(sum_of(&expected, &measured, dot));
            UncertainValue { value, sigma: (sigma_m / (spread_m * (COUNT as f64).sqrt())).hypot(PATH_ERROR) }
        } else {
            // The robot stands: only the camera's own headings can tell.
            let newest = fixes[COUNT - 1].turn_rad?;
            let agrees = |fix: &RejectedFix| {
                fix.turn_rad.is_some_and(|turn| {
                    wrap_rad(turn.value - newest.value).abs() <= MAX_SIGMAS * turn.sigma.hypot(newest.sigma)
                })
            };
            fixes.iter().all(agrees).then_some(newest)?
        };
        let (sin, cos) = turn.value.sin_cos();
        let residual_m = measured.iter().zip(&expected).map(|(z, q)| {
            let turned = [cos * q[0] - sin * q[1], sin * q[0] + cos * q[1]];
            (z[0] - turned[0]).hypot(z[1] - turned[1])
        });
        let limit_m = MAX_SIGMAS * sigma_m + PATH_ERROR * spread_m;
        residual_m.fold(0.0, f64::max).le(&limit_m).then_some(turn)
    }
}

fn about_their_middle(points: [[f64; 2]; COUNT]) -> [[f64; 2]; COUNT] {
    let middle = [0, 1].map(|axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / COUNT as f64);
    points.map(|point| [point[0] - middle[0], point[1] - middle[1]])
}

fn sum_of(one: &[[f64; 2]; COUNT], other: &[[f64; 2]; COUNT], of: fn(&[f64; 2], &[f64; 2]) -> f64) -> f64 {
    one.iter().zip(other).map(|(one, other)| of(one, other)).sum()
}

fn dot(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}
