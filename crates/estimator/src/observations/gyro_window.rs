//! The gyro against the encoders' heading over a window, instead of sample by sample.
//!
//! Differences of one-degree counts every 50 ms are not white: what one interval has too much, the next has too little.
//! Over a window the quantisation is bounded instead of accumulated. The state carries the sum W of the encoder-heading
//! errors since the window began, fully correlated with the heading; the gyro observes it:
//!
//! ```text
//! z = G               the gyro's turn over the window, bias included
//! h(x) = Th + W + b_g T     Th the encoders' turn, T the window's length
//! H = [.. T at b_g, 1 at W]
//! R = q + (r tick / b)^2 / 3 if a count changed,  q = sum of dt^2 (sigma_g^2 + res^2 / 12)
//! ```
//! When the window closes, W is forgotten (zero mean, zero variance) and the next one begins.
//!
//! Source: docs/maths/pose.md section 3.

use nalgebra::{Matrix1, SMatrix, Vector1};
use posebridge_telemetry::{BrickClock, DriveGeometry, SensorNoise, Stamp};

use crate::filters::pose::state::{GYRO_BIAS, Mean, N, WINDOW_ERROR};
use crate::motion::GyroTurn;
use crate::update::Measurement;

/// What has been summed since the window began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroWindow {
    /// When it began.
    pub start: Stamp<BrickClock>,
    /// Up to where the encoders' turn is summed.
    pub until: Stamp<BrickClock>,
    /// The encoders' turn, rad.
    pub encoder_turn_rad: f64,
    /// The encoders' distance, m.
    pub encoder_forward_m: f64,
    /// Whether a wheel moved.
    pub moved: Moved,
}

/// Whether a wheel moved during a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moved {
    /// No count changed.
    No,
    /// At least one count changed.
    Yes,
}

impl GyroWindow {
    /// A window that begins now.
    #[must_use]
    pub const fn starting(at: Stamp<BrickClock>) -> Self {
        Self {
            start: at,
            until: at,
            encoder_turn_rad: 0.0,
            encoder_forward_m: 0.0,
            moved: Moved::No,
        }
    }
}

/// Variance of the turn that a gyro reports over samples with this sum of squared lengths, rad².
#[must_use]
pub fn gyro_variance(noise: &SensorNoise, squared_secs: f64) -> f64 {
    let rate_var = noise.gyro_rad_per_s.powi(2) + noise.gyro_resolution_rad_per_s.powi(2) / 12.0;
    squared_secs * rate_var
}

/// Variance of the heading difference of two encoder readings through their resolution, rad².
#[must_use]
pub fn encoder_quantisation_variance(geometry: &DriveGeometry) -> f64 {
    let mean_radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
    (mean_radius_m * geometry.tick.0 / geometry.track_width.0).powi(2) / 3.0
}

/// Innovation, H and R of a window.
#[must_use]
pub fn measurement(
    mean: &Mean,
    window: &GyroWindow,
    gyro: &GyroTurn,
    geometry: &DriveGeometry,
    noise: &SensorNoise,
) -> Measurement<N, 1> {
    let length_s = (window.until - window.start).as_secs_f64();
    let mut jacobian = SMatrix::<f64, 1, N>::zeros();
    jacobian[(0, GYRO_BIAS)] = length_s;
    jacobian[(0, WINDOW_ERROR)] = 1.0;
    let predicted = window.encoder_turn_rad + mean[WINDOW_ERROR] + mean[GYRO_BIAS] * length_s;
    let quantisation = match window.moved {
        Moved::Yes => encoder_quantisation_variance(geometry),
        Moved::No => 0.0,
    };
    Measurement {
        innovation: Vector1::new(gyro.turn_rad - predicted),
        jacobian,
        noise: Matrix1::new(gyro_variance(noise, gyro.squared_secs) + quantisation),
    }
}
