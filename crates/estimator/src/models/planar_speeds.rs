//! A body in the plane whose speeds are states and whose accelerations are an input.
//!
//! # Model
//! ```text
//! x  = [x, y, th, v, w]'              rows as telemetry::estimate::row      u = [a, alpha]'
//! ph = th + w dt / 2
//! x' = x + v dt cos ph      y' = y + v dt sin ph      th' = th + w dt      v' = v + a dt      w' = w + alpha dt
//!
//!     [ 1 0 -v dt sin ph  dt cos ph  -v dt^2 sin ph / 2 ]
//!     [ 0 1  v dt cos ph  dt sin ph   v dt^2 cos ph / 2 ]
//! F = [ 0 0  1            0           dt                ]
//!     [ 0 0  0            1           0                 ]
//!     [ 0 0  0            0           1                 ]
//! ```
//! The heading is not wrapped: a filter that compares it with an integral must know how many turns both have made.
//!
//! # Sources
//! Paper 1 (Valera et al.), equations 13, 20 to 22 and 24; docs/maths/paper1.md sections 3 and 4.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::DriveGeometry;
use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};

use super::se2::{BodyStep, StepRule, displace};

/// Number of states.
pub const N: usize = 5;
/// Mean of the state, SI units.
pub type Mean = SVector<f64, N>;
/// Covariance of the state, SI units squared.
pub type Covariance = SMatrix<f64, N, N>;

/// The accelerations of the body: the input.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Acceleration {
    /// Along the body's x axis, m/s².
    pub forward_m_per_s2: f64,
    /// About the vertical, rad/s².
    pub turn_rad_per_s2: f64,
}

impl Acceleration {
    /// Turns the accelerations felt at the two wheels, in m/s², into those of the body.
    ///
    /// ```text
    /// a = (a_L + a_R) / 2          alpha = (a_R - a_L) / b
    /// ```
    #[must_use]
    pub fn of_wheels(left_m_per_s2: f64, right_m_per_s2: f64, geometry: &DriveGeometry) -> Self {
        Self {
            forward_m_per_s2: 0.5 * (left_m_per_s2 + right_m_per_s2),
            turn_rad_per_s2: (right_m_per_s2 - left_m_per_s2) / geometry.track_width.0,
        }
    }
}

/// Moves the state by `dt_s` seconds: pose by the speeds at the beginning, speeds by the accelerations.
#[must_use]
pub fn advance(mean: &Mean, felt: Acceleration, dt_s: f64) -> Mean {
    let moved = displace(mean[HEADING], step_of(mean, dt_s), StepRule::Midpoint);
    Mean::new(
        mean[X] + moved.dx_m,
        mean[Y] + moved.dy_m,
        mean[HEADING] + mean[TURN] * dt_s,
        mean[FORWARD] + felt.forward_m_per_s2 * dt_s,
        mean[TURN] + felt.turn_rad_per_s2 * dt_s,
    )
}

/// F: the derivative of [`advance`] by the state, 5 x 5. The input does not enter it.
#[must_use]
pub fn jacobian(mean: &Mean, dt_s: f64) -> Covariance {
    let moved = displace(mean[HEADING], step_of(mean, dt_s), StepRule::Midpoint);
    let mut f = Covariance::identity();
    for (axis, row) in [X, Y].into_iter().enumerate() {
        f[(row, HEADING)] = moved.by_heading[axis];
        f[(row, FORWARD)] = moved.by_forward[axis] * dt_s;
        f[(row, TURN)] = moved.by_turn[axis] * dt_s;
    }
    f[(HEADING, TURN)] = dt_s;
    f
}

fn step_of(mean: &Mean, dt_s: f64) -> BodyStep {
    BodyStep {
        forward_m: mean[FORWARD] * dt_s,
        turn_rad: mean[TURN] * dt_s,
    }
}
