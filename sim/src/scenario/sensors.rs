//! The inertial sensors and the thermometer on board, and the camera overhead.

use posebridge_telemetry::TimeDelta;
use serde::Deserialize;
use serde::de::{Deserializer, Error};

use super::pictures::{RenderedCameraSettings, pictures};

/// Defaults: the HiTechnic gyro behind a brick that averages over the telemetry interval.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GyroSettings {
    /// White noise of one mean.
    pub sigma_deg_per_s: f64,
    /// 0 for none.
    pub quantum_deg_per_s: f64,
    /// Saturation, either sign.
    pub range_deg_per_s: f64,
    /// Relative, positive reads fast: a fixed part plus a sigma times a draw. The sensor keeps it when it is switched off.
    pub scale_error: f64,
    pub scale_error_sigma: f64,
    /// At power-up.
    pub bias_sigma_deg_per_s: f64,
    pub bias_walk_deg_per_s_sqrt_s: f64,
}

impl Default for GyroSettings {
    fn default() -> Self {
        Self {
            sigma_deg_per_s: 0.6,
            quantum_deg_per_s: 1.0,
            range_deg_per_s: 360.0,
            scale_error: 0.0,
            // +-3 % at most (MPU-6050 data sheet), taken as three sigmas.
            scale_error_sigma: 0.01,
            bias_sigma_deg_per_s: 1.0,
            bias_walk_deg_per_s_sqrt_s: 0.01,
        }
    }
}

/// The forward accelerometers at the wheels. Defaults: 200 counts per g, noise of 1.5 counts.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AccelerometerSettings {
    /// White noise of one mean.
    pub sigma_m_per_s2: f64,
    /// 0 for none.
    pub quantum_m_per_s2: f64,
    /// At power-up, from tilt.
    pub bias_sigma_m_per_s2: f64,
}

impl Default for AccelerometerSettings {
    fn default() -> Self {
        Self { sigma_m_per_s2: 0.075, quantum_m_per_s2: 0.049, bias_sigma_m_per_s2: 0.1 }
    }
}

/// The order in which fixes reach the station.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraOrder {
    /// In the order of exposure: a fix waits for the one before it.
    #[default]
    Fifo,
    /// Each after its own latency, so that a slow one is overtaken.
    Free,
}

/// When a camera takes images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraImages {
    /// Periodically.
    #[default]
    Steady,
    /// On request (MAV_CMD_REQUEST_MESSAGE), and at requested intervals.
    OnRequest,
}

/// An interval without fixes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blackout {
    pub from_s: f64,
    pub to_s: f64,
}

/// The overhead camera, a separate MAVLink component with its own clock.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSettings {
    pub is_present: bool,
    pub images: CameraImages,
    pub rate_hz: f64,
    /// Of each axis.
    pub position_sigma_m: f64,
    pub heading_sigma_deg: f64,
    /// Error of the camera's calibration: constant on each square patch of the floor, of each axis. Fixes do not report it.
    pub patch_sigma_m: f64,
    /// Side of a patch; the arena's origin is the centre of one.
    pub patch_size_m: f64,
    pub sees_heading: bool,
    /// Whether a fix carries its standard deviations as covariance.
    pub reports_covariance: bool,
    /// Mean, from the exposure to the sending of the fix.
    pub latency_ms: f64,
    /// Half the width of the uniform spread of the latency.
    pub jitter_ms: f64,
    pub order: CameraOrder,
    /// Probability that an image gives no fix.
    pub dropout: f64,
    pub blackouts: Vec<Blackout>,
    pub outlier: f64,
    /// Of each axis, in addition to the normal noise.
    pub outlier_sigma_m: f64,
    /// In addition to the normal noise.
    pub outlier_sigma_deg: f64,
    /// Lever arm from mid-axle to the tag, forward; the fix is the tag's position.
    pub tag_x_m: f64,
    /// Lever arm from mid-axle to the tag, to the left.
    pub tag_y_m: f64,
    pub clock_start_micros: u64,
    /// Positive runs fast.
    pub clock_skew_ppm: f64,
    /// Rendered pictures, for a program that finds the tags itself. They need no `is_present`: that is about the fixes.
    #[serde(deserialize_with = "pictures")]
    pub pictures: Option<RenderedCameraSettings>,
}

impl Default for CameraSettings {
    fn default() -> Self {
        Self {
            is_present: true,
            images: CameraImages::default(),
            rate_hz: 10.0,
            position_sigma_m: 0.005,
            heading_sigma_deg: 1.0,
            // Four cameras over a room of robots are right to 1 cm (Mobile Emulab), taken as three sigmas.
            patch_sigma_m: 0.003,
            patch_size_m: 0.5,
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
            pictures: None,
        }
    }
}

impl CameraSettings {
    /// Whether a blackout falls on this time.
    pub(crate) fn is_dark(&self, world: TimeDelta) -> bool {
        let now_s = world.as_secs_f64();
        self.blackouts.iter().any(|dark| (dark.from_s..dark.to_s).contains(&now_s))
    }
}

/// Lags, noise and baths of a thermometer. Defaults: a DS18B20 in its sleeve, read four times a second.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThermometerSettings {
    /// `scaled_pressure`, or the name of a NAMED_VALUE_FLOAT, which begins with `temp`.
    #[serde(deserialize_with = "channel")]
    pub channel: String,
    /// Of reading and sending.
    pub rate_hz: f64,
    #[serde(deserialize_with = "lags")]
    pub lags_s: Vec<f64>,
    /// Share of each lag in the step response; the sum is 1.
    #[serde(deserialize_with = "shares")]
    pub shares: Vec<f64>,
    /// White noise of a reading.
    pub sigma_k: f64,
    /// 0 for none.
    pub resolution_k: f64,
    /// Temperature of the bath in which it has rested.
    pub before_c: f64,
    /// Temperature of the bath into which it is dipped.
    pub after_c: f64,
    pub dipped_at_s: f64,
}

impl Default for ThermometerSettings {
    /// The lags are those that `posebridge lab thermometer` identifies from recordings of three of them; the resolution is that of the
    /// data sheet.
    fn default() -> Self {
        Self {
            channel: SCALED_PRESSURE.to_owned(),
            rate_hz: 4.0,
            lags_s: vec![5.3, 22.0],
            shares: vec![0.3, 0.7],
            sigma_k: 0.03,
            resolution_k: 0.0625,
            before_c: 20.0,
            after_c: 60.0,
            dipped_at_s: 10.0,
        }
    }
}

impl ThermometerSettings {
    pub(crate) fn is_scaled_pressure(&self) -> bool {
        self.channel == SCALED_PRESSURE
    }
}

/// Channel name of the message that carries no name.
const SCALED_PRESSURE: &str = "scaled_pressure";
/// Bytes of NAMED_VALUE_FLOAT.name (common.xml).
const LONGEST_NAME: usize = 10;
const MOST_LAGS: usize = 4;

fn channel<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let channel = String::deserialize(deserializer)?;
    let is_printable = channel.bytes().all(|byte| byte.is_ascii_graphic());
    let is_name = channel.starts_with("temp") && channel.len() <= LONGEST_NAME && is_printable;
    if is_name || channel == SCALED_PRESSURE {
        Ok(channel)
    } else {
        Err(D::Error::custom(format!(
            "a thermometer is sent as {SCALED_PRESSURE} or under a name of at most {LONGEST_NAME} printable characters that begins \
             with temp, not as {channel:?}"
        )))
    }
}

fn lags<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let lags_s = Vec::<f64>::deserialize(deserializer)?;
    let are_sound = lags_s.iter().all(|tau_s| (1e-3..=1e5).contains(tau_s));
    if are_sound && (1..=MOST_LAGS).contains(&lags_s.len()) {
        Ok(lags_s)
    } else {
        Err(D::Error::custom(format!(
            "{lags_s:?} are no time constants; give 1 to {MOST_LAGS} numbers from 0.001 to 100000 seconds"
        )))
    }
}

fn shares<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let shares = Vec::<f64>::deserialize(deserializer)?;
    let sum: f64 = shares.iter().sum();
    if (sum - 1.0).abs() < 1e-9 {
        Ok(shares)
    } else {
        Err(D::Error::custom(format!("the shares {shares:?} sum up to {sum}; they must sum up to 1")))
    }
}

pub(super) fn thermometer<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<ThermometerSettings>, D::Error> {
    let settings = ThermometerSettings::deserialize(deserializer)?;
    let (lags, shares) = (settings.lags_s.len(), settings.shares.len());
    if lags == shares {
        Ok(Some(settings))
    } else {
        Err(D::Error::custom(format!("there are {lags} lags_s and {shares} shares; give one share for each lag")))
    }
}
