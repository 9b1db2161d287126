//! A thermometer on the brick, dipped from one bath into another.

use serde::Deserialize;
use serde::de::{Deserializer, Error};

use super::checks;

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
    #[serde(deserialize_with = "degrees_c")]
    pub before_c: f64,
    /// The bath into which it is dipped, in degrees Celsius.
    #[serde(deserialize_with = "degrees_c")]
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

/// A temperature that both messages can hold.
fn degrees_c<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    crate::checks::within(deserializer, -270.0, 320.0)
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

/// A thermometer with a share for each lag.
pub(super) fn checked<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<ThermometerSettings>, D::Error> {
    let settings = ThermometerSettings::deserialize(deserializer)?;
    let (lags, shares) = (settings.lags_s.len(), settings.shares.len());
    if lags == shares {
        Ok(Some(settings))
    } else {
        Err(D::Error::custom(format!("there are {lags} lags_s and {shares} shares; give one share for each lag")))
    }
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;

    #[test]
    fn a_thermometer_is_there_only_if_it_is_asked_for() {
        assert_eq!(Scenario::default().thermometer, None);
        let scenario = Scenario::from_toml("[thermometer]\nafter_c = 48.7\n").unwrap();
        assert_eq!(scenario.thermometer.unwrap().after_c, 48.7);
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_its_line_and_key() {
        for (line, key) in [
            ("channel = \"water\"", "temp"),
            ("channel = \"temperature1\"", "temp"),
            ("lags_s = []", "time constants"),
            ("lags_s = [0.0, 3.0]", "time constants"),
            ("shares = [0.5, 0.6]", "sum up to 1"),
            ("lags_s = [3.0]", "one share for each lag"),
            ("after_c = -300.0", "after_c"),
            ("rate_hz = 0.0", "rate_hz"),
            ("lag_s = 3.0", "lag_s"),
        ] {
            let refused = Scenario::from_toml(&format!("[thermometer]\n{line}\n"));
            let said = refused.unwrap_err().to_string();
            assert!(said.contains(key) && said.contains("line "), "{line}: {said}");
        }
    }
}
