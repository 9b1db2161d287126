//! `[[robot.thermometer]]`: what is known of a thermometer, by the channel that it is read by.

use anyhow::{Context, Result, ensure};
use posebridge_estimator::filters::thermometer::ThermometerSettings;
use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_station::ThermometerConfig;
use posebridge_telemetry::{ChannelName, SensorId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One thermometer. Those that are not listed are learnt from what they show.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RobotThermometer {
    /// Its channel: `scaled_pressure`, or the name of a NAMED_VALUE_FLOAT, which begins with `temp`.
    pub channel: String,
    /// Its time constants, one for each lag, as `posebridge lab thermometer` identifies them; without any they are learnt.
    #[serde(default)]
    pub lags_s: Vec<f64>,
    /// What it shows per degree, once it has settled.
    #[serde(default = "no_gain")]
    pub gain: f64,
    /// Noise of a reading, one standard deviation; 0 takes `robot.noise.temperature_k`.
    #[serde(default)]
    pub sigma_k: f64,
    /// The step between two values that it can show; 0 if fine.
    #[serde(default)]
    pub resolution_k: f64,
}

const fn no_gain() -> f64 {
    1.0
}

/// All thermometers of a robot.
///
/// # Errors
/// A value makes no sense, or a channel is named twice; the message names the key.
pub(super) fn checked(thermometers: &[RobotThermometer]) -> Result<Vec<ThermometerConfig>> {
    let mut known: Vec<ThermometerConfig> = Vec::with_capacity(thermometers.len());
    for (index, thermometer) in thermometers.iter().enumerate() {
        let config = thermometer.checked().with_context(|| format!("`robot.thermometer`, number {}", index + 1))?;
        ensure!(
            known.iter().all(|other| other.channel != config.channel),
            "`robot.thermometer` has the channel `{}` twice",
            thermometer.channel
        );
        known.push(config);
    }
    Ok(known)
}

impl RobotThermometer {
    fn checked(&self) -> Result<ThermometerConfig> {
        let channel = ChannelName::from_bytes(self.channel.as_bytes());
        let is_spelled = channel.as_str() == self.channel;
        let is_known = self.channel == "scaled_pressure" || self.channel.starts_with("temp");
        ensure!(
            is_spelled && is_known,
            "`channel` is `{}`, must be scaled_pressure or a name of at most ten printable characters that begins with temp",
            self.channel
        );
        for (key, value) in [("sigma_k", self.sigma_k), ("resolution_k", self.resolution_k)] {
            ensure!(value.is_finite() && value >= 0.0, "`{key}` is {value}, must be zero or more");
        }
        let model = if self.lags_s.is_empty() {
            ensure!(self.gain == 1.0, "`gain` is {}, but without `lags_s` the gain must be 1", self.gain);
            None
        } else {
            let model = DynamicModel::empty()
                .with_lags(SensorId::THERMOMETER, self.gain, &self.lags_s)
                .context("`lags_s` and `gain`")?;
            Some(model)
        };
        Ok(ThermometerConfig {
            channel,
            settings: ThermometerSettings { model, sigma_k: self.sigma_k, resolution_k: self.resolution_k },
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::config::load_text;

    fn thermometers(text: &str) -> anyhow::Result<usize> {
        let loaded = load_text("test", text, &[])?;
        Ok(loaded.config.station_config()?.robot.thermometers.len())
    }

    #[test]
    fn a_thermometer_may_be_known_in_part() {
        let text = "[[robot.thermometer]]\nchannel = \"temp1\"\nlags_s = [5.3, 22]\n\
                    [[robot.thermometer]]\nchannel = \"scaled_pressure\"\nresolution_k = 0.5\n";
        assert_eq!(thermometers(text).unwrap(), 2);
        assert_eq!(thermometers("").unwrap(), 0);
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_its_key() {
        for (line, key) in [
            ("channel = \"water\"", "channel"),
            ("channel = \"temp water\"", "channel"),
            ("channel = \"temp\"\nlags_s = [-1.0]", "lags_s"),
            ("channel = \"temp\"\nlags_s = [2.0, 2.0]", "lags_s"),
            ("channel = \"temp\"\nlags_s = [2.0]\ngain = 0.0", "gain"),
            ("channel = \"temp\"\ngain = 2.0", "gain"),
            ("channel = \"temp\"\nsigma_k = nan", "sigma_k"),
            ("channel = \"temp\"\nresolution_k = -1.0", "resolution_k"),
            ("channel = \"temp\"\nlag_s = [2.0]", "lag_s"),
            ("channel = \"temp\"\n[[robot.thermometer]]\nchannel = \"temp\"", "twice"),
        ] {
            let refused = thermometers(&format!("[[robot.thermometer]]\n{line}\n"));
            let error = format!("{:#}", refused.unwrap_err());
            let has_place = error.contains("robot.thermometer") || error.contains("line 3");
            assert!(error.contains(key) && has_place, "{line}: {error}");
        }
    }
}
