//! The inertial sensors and the thermometer on board, and the camera overhead.

use serde::Deserialize;
use serde::de::{Deserializer, Error};

use crate::checks;

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

/// Its lags, its noise, its baths. Defaults: a DS18B20 in its sleeve, read four times a second.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThermometerSettings {
    /// In which message it is sent: `scaled_pressure`, or the name of a NAMED_VALUE_FLOAT, which begins with `temp`.
    #[serde(deserialize_with = "channel")]
    pub channel: String,
    /// How often it is read and sent, in hertz.
    #[serde(deserialize_with = "checks::rate_hz")]
    pub rate_hz: f64,
    /// Time constants, in seconds.
    #[serde(deserialize_with = "lags")]
    pub lags_s: Vec<f64>,
    /// The share of the step that each lag takes; they sum up to 1.
    #[serde(deserialize_with = "shares")]
    pub shares: Vec<f64>,
    /// White noise of a reading, one standard deviation, in kelvin.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_k: f64,
    /// The step between two values that it can show, in kelvin; 0 if fine.
    #[serde(deserialize_with = "checks::non_negative")]
    pub resolution_k: f64,
    /// The bath in which it has rested, in degrees Celsius.
    #[serde(deserialize_with = "checks::degrees_c")]
    pub before_c: f64,
    /// The bath into which it is dipped, in degrees Celsius.
    #[serde(deserialize_with = "checks::degrees_c")]
    pub after_c: f64,
    /// When, in seconds of world time.
    #[serde(deserialize_with = "checks::non_negative")]
    pub dipped_at_s: f64,
}

impl Default for ThermometerSettings {
    /// The lags are what `posebridge lab thermometer` finds in recordings of three of them, the step is that of the data sheet.
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
    /// Whether it is sent in SCALED_PRESSURE and not as a named value.
    pub(crate) fn is_scaled_pressure(&self) -> bool {
        self.channel == SCALED_PRESSURE
    }
}

/// The name of the channel that has none on the wire.
const SCALED_PRESSURE: &str = "scaled_pressure";
/// Bytes of NAMED_VALUE_FLOAT.name (common.xml).
const LONGEST_NAME: usize = 10;
/// Most lags; enough for any sensor.
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
