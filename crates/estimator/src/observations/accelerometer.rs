//! The accelerations at both wheels: how the speeds change between two readings of the encoders.
//!
//! ```text
//! a = (a_L + a_R) / 2        v <- v + a dt          var v <- var v + (sigma_a dt)^2 / 2
//! alpha = (a_R - a_L) / b    w <- w + alpha dt      var w <- var w + 2 (sigma_a dt / b)^2
//! ```
//! Accelerations are an input, as in paper 1, equation 21 (with half the track for its r), and replace the random walk
//! of the speeds. They never move the pose by themselves: over known travel the wheels do.
//!
//! Source: paper 1 (Valera et al.), equations 20 to 22; docs/maths/pose.md section 5.

use posebridge_telemetry::{DriveGeometry, SensorNoise};

use crate::models::planar_speeds::Acceleration;

/// Mean forward acceleration at each wheel over an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelAccelerations {
    pub left_m_per_s2: f64,
    pub right_m_per_s2: f64,
}

/// Changes of the speeds and of their variances over an interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpeedChange {
    pub forward_m_per_s: f64,
    pub forward_variance: f64,
    pub turn_rad_per_s: f64,
    pub turn_variance: f64,
}

pub fn speed_change(felt: WheelAccelerations, dt_s: f64, geometry: &DriveGeometry, noise: &SensorNoise) -> SpeedChange {
    let b = geometry.track_width.0;
    let body = Acceleration::from_wheels(felt.left_m_per_s2, felt.right_m_per_s2, geometry);
    let sigma = noise.accelerometer_m_per_s2 * dt_s;
    SpeedChange {
        forward_m_per_s: body.forward_m_per_s2 * dt_s,
        forward_variance: 0.5 * sigma * sigma,
        turn_rad_per_s: body.turn_rad_per_s2 * dt_s,
        turn_variance: 2.0 * sigma * sigma / (b * b),
    }
}
