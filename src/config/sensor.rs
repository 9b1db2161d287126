//! What is known of a slow sensor: `[robot.sensor]`, `[robot.thermometer.sensor]`, and the file of `--sensor`.

use anyhow::{Result, ensure};
use posebridge_estimator::models::slow_sensor::{LogNormal, MIN_LAG_RATIO, SensorDynamics, SlowLag, SlowSensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The response of a slow sensor as two lags, with how much the sensors of its type differ. `posebridge identify step --save`
/// writes it.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct SensorSection {
    /// The slower time constant.
    pub slow_lag_s: f64,
    /// Its relative standard deviation: that of its natural logarithm.
    #[serde(default = "slow_lag_sigma")]
    pub slow_lag_sigma: f64,
    /// The slower time constant over the faster one.
    #[serde(default = "lag_ratio")]
    pub lag_ratio: f64,
    /// Its relative standard deviation: that of its natural logarithm.
    #[serde(default = "lag_ratio_sigma")]
    pub lag_ratio_sigma: f64,
    /// Share of a step that follows the faster lag.
    #[serde(default = "fast_share")]
    pub fast_share: f64,
    /// One standard deviation.
    #[serde(default = "fast_share_sigma")]
    pub fast_share_sigma: f64,
    /// Probability that there is no faster lag.
    #[serde(default)]
    pub single_lag_probability: f64,
    /// Noise of a reading, one standard deviation; 0 takes `robot.noise.temperature_k`.
    #[serde(default)]
    pub noise: f64,
    /// The step between two values that it can show; 0 if fine.
    #[serde(default)]
    pub resolution: f64,
}

const fn slow_lag_sigma() -> f64 {
    0.25
}

const fn lag_ratio() -> f64 {
    SensorDynamics::UNKNOWN.lag_ratio.median
}

const fn lag_ratio_sigma() -> f64 {
    SensorDynamics::UNKNOWN.lag_ratio.ln_sigma
}

const fn fast_share() -> f64 {
    SensorDynamics::UNKNOWN.fast_share
}

const fn fast_share_sigma() -> f64 {
    SensorDynamics::UNKNOWN.fast_share_sigma
}

/// More than a factor of twenty either way is no description.
const MAX_LN_SIGMA: f64 = 3.0;

impl SensorSection {
    pub fn checked(&self) -> Result<SlowSensor> {
        let ensure_in = |key: &str, value: f64, least: f64, most: f64| -> Result<()> {
            ensure!((least..=most).contains(&value), "`sensor.{key}` is {value}, must be {least} to {most}");
            Ok(())
        };
        ensure_in("slow_lag_s", self.slow_lag_s, 1e-3, 1e6)?;
        ensure_in("slow_lag_sigma", self.slow_lag_sigma, 0.0, MAX_LN_SIGMA)?;
        ensure_in("lag_ratio", self.lag_ratio, MIN_LAG_RATIO, 1e4)?;
        ensure_in("lag_ratio_sigma", self.lag_ratio_sigma, 0.0, MAX_LN_SIGMA)?;
        ensure_in("fast_share", self.fast_share, -10.0, 10.0)?;
        ensure_in("fast_share_sigma", self.fast_share_sigma, 0.0, 10.0)?;
        ensure_in("single_lag_probability", self.single_lag_probability, 0.0, 0.99)?;
        for (key, value) in [("noise", self.noise), ("resolution", self.resolution)] {
            ensure!(
                value == 0.0 || (1e-4..=1e6).contains(&value),
                "`sensor.{key}` is {value}, must be 0 (unknown) or 0.0001 to 1000000"
            );
        }
        let dynamics = SensorDynamics {
            slow_lag: SlowLag::Known(LogNormal { median: self.slow_lag_s, ln_sigma: self.slow_lag_sigma }),
            lag_ratio: LogNormal { median: self.lag_ratio, ln_sigma: self.lag_ratio_sigma },
            fast_share: self.fast_share,
            fast_share_sigma: self.fast_share_sigma,
            single_lag_probability: self.single_lag_probability,
        };
        Ok(SlowSensor { dynamics, noise: self.noise, resolution: self.resolution })
    }

    /// `None` if the time constant is unknown.
    pub fn from_sensor(sensor: &SlowSensor) -> Option<Self> {
        let of = &sensor.dynamics;
        let SlowLag::Known(slow) = of.slow_lag else { return None };
        Some(Self {
            slow_lag_s: slow.median,
            slow_lag_sigma: slow.ln_sigma,
            lag_ratio: of.lag_ratio.median.max(MIN_LAG_RATIO),
            lag_ratio_sigma: of.lag_ratio.ln_sigma,
            fast_share: of.fast_share,
            fast_share_sigma: of.fast_share_sigma,
            single_lag_probability: of.single_lag_probability,
            noise: sensor.noise,
            resolution: sensor.resolution,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_survives_its_file() {
        let dynamics = SensorDynamics {
            slow_lag: SlowLag::Known(LogNormal { median: 23.7, ln_sigma: 0.3 }),
            single_lag_probability: 0.0,
            ..SensorDynamics::UNKNOWN
        };
        let known = SlowSensor { dynamics, noise: 0.03, resolution: 0.0625 };
        let text = toml::to_string(&SensorSection::from_sensor(&known).unwrap()).unwrap();
        let read: SensorSection = toml::from_str(&text).unwrap();
        assert_eq!(read.checked().unwrap(), known);
        assert_eq!(SensorSection::from_sensor(&SlowSensor::UNKNOWN), None);
    }

    #[test]
    fn what_is_no_sensor_is_refused_with_its_key() {
        for (text, key) in [
            ("slow_lag_s = 0", "slow_lag_s"),
            ("slow_lag_s = nan", "slow_lag_s"),
            ("slow_lag_s = 20\nlag_ratio = 1", "lag_ratio"),
            ("slow_lag_s = 20\nfast_share_sigma = -0.1", "fast_share_sigma"),
            ("slow_lag_s = 20\nsingle_lag_probability = 1", "single_lag_probability"),
            ("slow_lag_s = 20\nnoise = inf", "noise"),
        ] {
            let section: SensorSection = toml::from_str(text).unwrap();
            let error = section.checked().unwrap_err().to_string();
            assert!(error.contains(&format!("`sensor.{key}`")), "{text}: {error}");
        }
    }
}
