//! The accelerations at both wheels: how the speeds change between two readings of the encoders.
//!
//! ```text
//! a = (a_L + a_R) / 2        v <- v + a dt          var v <- var v + (sigma_a dt)^2 / 2
//! alpha = (a_R - a_L) / b    w <- w + alpha dt      var w <- var w + 2 (sigma_a dt / b)^2
//! ```
//! They are an input, as in paper 1, equation 21 (with half the track for its r), and take the place of the random walk of the
//! speeds. They never move the pose by themselves: over known travel the wheels do.
//!
//! Source: paper 1 (Valera et al.), equations 20 to 22; docs/maths/pose.md section 5.

use posebridge_telemetry::{DriveGeometry, SensorNoise};

use crate::filters::pose::state::Speed;

/// Forward acceleration at each wheel over an interval, m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accelerations {
    /// At the left wheel.
    pub left_m_per_s2: f64,
    /// At the right wheel.
    pub right_m_per_s2: f64,
}

/// Changes forward speed and turn rate by what was felt for `dt_s`.
pub fn drive_speeds(
    forward: &mut Speed,
    turn: &mut Speed,
    felt: Accelerations,
    dt_s: f64,
    (geometry, noise): (&DriveGeometry, &SensorNoise),
) {
    let b = geometry.track_width.0;
    let sigma = noise.accelerometer_m_per_s2 * dt_s;
    forward.value += 0.5 * (felt.left_m_per_s2 + felt.right_m_per_s2) * dt_s;
    forward.variance += 0.5 * sigma * sigma;
    turn.value += (felt.right_m_per_s2 - felt.left_m_per_s2) / b * dt_s;
    turn.variance += 2.0 * sigma * sigma / (b * b);
}
