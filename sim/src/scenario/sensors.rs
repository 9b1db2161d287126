//! The inertial sensors on board and the camera overhead.

use serde::Deserialize;

use super::checks;
use crate::clock::ClockSettings;

/// The gyro. Defaults: the HiTechnic gyro behind a brick that averages over the telemetry interval.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GyroSettings {
    /// White noise of one mean, in degrees per second.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_deg_per_s: f64,
    /// Resolution, in degrees per second; 0 for none.
    #[serde(deserialize_with = "checks::non_negative")]
    pub quantum_deg_per_s: f64,
    /// Where it saturates, in degrees per second, either way.
    #[serde(deserialize_with = "checks::positive")]
    pub range_deg_per_s: f64,
    /// Bias at power-up: standard deviation, in degrees per second.
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_sigma_deg_per_s: f64,
    /// Random walk of the bias, in degrees per second per square root of a second.
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_walk_deg_per_s_sqrt_s: f64,
}

impl Default for GyroSettings {
    fn default() -> Self {
        Self {
            sigma_deg_per_s: 0.6,
            quantum_deg_per_s: 1.0,
            range_deg_per_s: 360.0,
            bias_sigma_deg_per_s: 1.0,
            bias_walk_deg_per_s_sqrt_s: 0.01,
        }
    }
}

/// The forward accelerometers at the wheels. Defaults: 200 counts per g, noise of 1.5 counts.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AccelerometerSettings {
    /// White noise of one mean, in metres per second squared.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_m_per_s2: f64,
    /// Resolution, in metres per second squared; 0 for none.
    #[serde(deserialize_with = "checks::non_negative")]
    pub quantum_m_per_s2: f64,
    /// Bias at power-up (tilt): standard deviation, in metres per second squared.
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_sigma_m_per_s2: f64,
}

impl Default for AccelerometerSettings {
    fn default() -> Self {
        Self { sigma_m_per_s2: 0.075, quantum_m_per_s2: 0.049, bias_sigma_m_per_s2: 0.1 }
    }
}

/// In which order fixes reach the station.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraOrder {
    /// A fix waits for the one before it.
    #[default]
    Fifo,
    /// Each fix arrives when its own latency is over; a slow one is overtaken.
    Free,
}

/// When a camera takes images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraImages {
    /// At its rate.
    #[default]
    Steady,
    /// On request (MAV_CMD_REQUEST_MESSAGE), and at requested intervals.
    OnRequest,
}

/// A time in which the camera sees nothing.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blackout {
    /// Beginning, in seconds of world time.
    #[serde(deserialize_with = "checks::non_negative")]
    pub from_s: f64,
    /// End, in seconds of world time.
    #[serde(deserialize_with = "checks::non_negative")]
    pub to_s: f64,
}

/// The overhead camera, a MAVLink component of its own with a clock of its own.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSettings {
    /// Whether there is one.
    pub is_present: bool,
    /// When it takes images.
    pub images: CameraImages,
    /// Images per second.
    #[serde(deserialize_with = "checks::rate_hz")]
    pub rate_hz: f64,
    /// Standard deviation of the position, each axis, in metres.
    #[serde(deserialize_with = "checks::non_negative")]
    pub position_sigma_m: f64,
    /// Standard deviation of the heading, in degrees.
    #[serde(deserialize_with = "checks::non_negative")]
    pub heading_sigma_deg: f64,
    /// Whether it measures the heading at all.
    pub sees_heading: bool,
    /// Whether a fix carries these standard deviations as its covariance.
    pub reports_covariance: bool,
    /// Mean time from the exposure to the sending of the fix, in milliseconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub latency_ms: f64,
    /// Half the width of the uniform spread of that time, in milliseconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub jitter_ms: f64,
    /// In which order fixes arrive.
    pub order: CameraOrder,
    /// Probability that an image gives no fix.
    #[serde(deserialize_with = "checks::probability")]
    pub dropout: f64,
    /// Times without any fix.
    pub blackouts: Vec<Blackout>,
    /// Probability that a fix is an outlier.
    #[serde(deserialize_with = "checks::probability")]
    pub outlier: f64,
    /// Additional standard deviation of an outlier's position, each axis, in metres.
    #[serde(deserialize_with = "checks::non_negative")]
    pub outlier_sigma_m: f64,
    /// Additional standard deviation of an outlier's heading, in degrees.
    #[serde(deserialize_with = "checks::non_negative")]
    pub outlier_sigma_deg: f64,
    /// Lever arm from mid-axle to the tag, forward, in metres; the fix is the tag's position.
    #[serde(deserialize_with = "checks::finite")]
    pub tag_x_m: f64,
    /// Lever arm from mid-axle to the tag, to the left, in metres.
    #[serde(deserialize_with = "checks::finite")]
    pub tag_y_m: f64,
    /// What the camera's clock shows at the beginning, in microseconds.
    #[serde(deserialize_with = "checks::clock_micros")]
    pub clock_start_micros: u64,
    /// The clock's rate minus one, in parts per million; positive runs fast.
    #[serde(deserialize_with = "checks::skew_ppm")]
    pub clock_skew_ppm: f64,
}

impl Default for CameraSettings {
    fn default() -> Self {
        Self {
            is_present: true,
            images: CameraImages::default(),
            rate_hz: 10.0,
            position_sigma_m: 0.005,
            heading_sigma_deg: 1.0,
            sees_heading: true,
            reports_covariance: true,
            latency_ms: 80.0,
            jitter_ms: 30.0,
            order: CameraOrder::default(),
            dropout: 0.02,
            blackouts: Vec::new(),
            outlier: 0.0,
            outlier_sigma_m: 0.5,
            outlier_sigma_deg: 30.0,
            tag_x_m: 0.0,
            tag_y_m: 0.0,
            clock_start_micros: 1_234_567_890,
            clock_skew_ppm: -20.0,
        }
    }
}

impl CameraSettings {
    /// The camera's clock, which resolves microseconds.
    pub(crate) const fn clock(&self) -> ClockSettings {
        ClockSettings { start_micros: self.clock_start_micros, skew_ppm: self.clock_skew_ppm, tick_micros: 1 }
    }
}
