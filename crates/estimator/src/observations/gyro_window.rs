//! The gyro against the encoders' heading over a window: differences of one-degree counts are not white sample by
//! sample, and over a window the quantisation is bounded. The state carries the turn psi since the window began, by the
//! encoders:
//!
//! ```text
//! z = G                                    the gyro's turn over the window, bias included
//! h(x) = (psi + eps) (1 + e_g) + b_g T     T the window's length, eps the rounding of the encoders' heading at its beginning
//! H = [.. 1 + e_g at psi and eps, T at b_g, psi + eps at e_g]        e_g the relative error of the gyro's rate
//! R = q + (r tick / b)^2 / 6     q = sum of dt^2 (sigma_g^2 + res^2 / 12); the second part is the rounding at the end
//! ```
//! The rounding at the end of one window is that at the beginning of the next with the opposite sign, so it is kept as
//! a state. Where the robot rested, both ends have the same rounding, and it drops out of h and R; unchanged counts
//! alone do not prove rest.
//!
//! Source: docs/maths/pose.md section 3.

use posebridge_telemetry::{BrickClock, DriveGeometry, SensorNoise, Timestamp};
use serde::{Deserialize, Serialize};

use super::{PoseView, StateTerm};
use crate::motion::GyroTurn;
use crate::saved::finite;

/// Sums since the window began.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GyroWindow {
    pub start: Timestamp<BrickClock>,
    /// The instant up to which the encoders' turn is summed.
    pub until: Timestamp<BrickClock>,
    #[serde(deserialize_with = "finite")]
    pub forward_m: f64,
}

impl GyroWindow {
    pub const fn starting(at: Timestamp<BrickClock>) -> Self {
        Self { start: at, until: at, forward_m: 0.0 }
    }
}

/// Variance of the turn that a gyro reports over samples with this sum of squared lengths, rad².
pub fn gyro_variance(noise: &SensorNoise, squared_secs: f64) -> f64 {
    let rate_var = noise.gyro_rad_per_s.powi(2) + noise.gyro_resolution_rad_per_s.powi(2) / 12.0;
    squared_secs * rate_var
}

/// Variance of the encoders' heading through the resolution of the counts, rad²: two wheels, each tick²/12.
pub fn rounding_variance(geometry: &DriveGeometry) -> f64 {
    let mean_radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
    (mean_radius_m * geometry.tick.0 / geometry.track_width.0).powi(2) / 6.0
}

/// The most that rounding can contribute to a window's turn, rad: one count of either wheel.
pub fn largest_rounding(geometry: &DriveGeometry) -> f64 {
    (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0) * geometry.tick.0 / geometry.track_width.0
}

/// The gyro's turn over a window against its prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroWindowModel {
    /// z - h(x), rad.
    pub innovation: f64,
    /// Derivative by [`StateTerm::WindowTurn`].
    pub by_turn: f64,
    /// Derivative by [`StateTerm::GyroBias`], s.
    pub by_gyro_bias: f64,
    /// Derivative by [`StateTerm::GyroScale`], rad.
    pub by_gyro_scale: f64,
    /// Derivative by [`StateTerm::HeadingRounding`].
    pub by_rounding: f64,
    /// R, rad².
    pub variance: f64,
}

/// Innovation, H and R of a window. R includes the variance of the rounding at its end, rad²; `None` for a robot at
/// rest, where it equals that at the beginning, which is a state.
pub fn measurement(
    view: &impl PoseView,
    window: &GyroWindow,
    gyro: &GyroTurn,
    noise: &SensorNoise,
    end_rounding_rad2: Option<f64>,
) -> GyroWindowModel {
    let length_s = (window.until - window.start).as_secs_f64();
    let (has_rounding, rounding_rad2) = end_rounding_rad2.map_or((0.0, 0.0), |variance| (1.0, variance));
    let factor = 1.0 + view.term(StateTerm::GyroScale);
    let turned_rad = view.term(StateTerm::WindowTurn) + has_rounding * view.term(StateTerm::HeadingRounding);
    GyroWindowModel {
        innovation: gyro.turn_rad - turned_rad * factor - view.term(StateTerm::GyroBias) * length_s,
        by_turn: factor,
        by_gyro_bias: length_s,
        by_gyro_scale: turned_rad,
        by_rounding: has_rounding * factor,
        variance: gyro_variance(noise, gyro.squared_intervals_s2) + rounding_rad2,
    }
}
