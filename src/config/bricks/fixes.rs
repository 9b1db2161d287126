//! `[camera.json]`: how cameras on links with `brick = "camera-json"` are heard.

use anyhow::{Result, ensure};
use posebridge_protocol::bricks::camera_json::CameraJsonSettings;
use posebridge_telemetry::TimeDelta;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A camera that is later than this sees another world.
const LONGEST_DELAY_MS: f64 = 60_000.0;

/// Cameras that speak JSON.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct FixSection {
    /// How long before its arrival a fix was exposed that does not say when.
    pub delay_ms: f64,
    /// It may be so much more or less.
    pub delay_spread_ms: f64,
    /// Fixes that say a lower quality, in per cent, are left out.
    pub least_quality: f64,
}

impl Default for FixSection {
    fn default() -> Self {
        let usual = CameraJsonSettings::default();
        Self {
            delay_ms: usual.delay.as_millis_f64(),
            delay_spread_ms: usual.delay_spread.as_millis_f64(),
            least_quality: usual.min_quality,
        }
    }
}

impl FixSection {
    /// The settings of the codec.
    ///
    /// # Errors
    /// A value makes no sense; the message names its key.
    pub(super) fn settings(&self) -> Result<CameraJsonSettings> {
        for (key, value, most) in [
            ("delay_ms", self.delay_ms, LONGEST_DELAY_MS),
            ("delay_spread_ms", self.delay_spread_ms, LONGEST_DELAY_MS),
            ("least_quality", self.least_quality, 100.0),
        ] {
            ensure!((0.0..=most).contains(&value), "`{key}` is {value}, must lie between 0 and {most}");
        }
        Ok(CameraJsonSettings {
            delay: TimeDelta::from_secs_f64(self.delay_ms * 1e-3),
            delay_spread: TimeDelta::from_secs_f64(self.delay_spread_ms * 1e-3),
            min_quality: self.least_quality,
            ..CameraJsonSettings::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Result<CameraJsonSettings, String> {
        let section: FixSection = toml::from_str(text).map_err(|error| error.to_string())?;
        section.settings().map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn without_a_word_it_is_the_usual_one_and_milliseconds_become_spans() {
        assert_eq!(settings("").unwrap(), CameraJsonSettings::default());
        let parsed = settings("delay_ms = 150.5\nleast_quality = 40").unwrap();
        assert_eq!(parsed.delay, TimeDelta::from_micros(150_500));
        assert_eq!(parsed.min_quality, 40.0);
    }

    #[test]
    fn what_cannot_be_is_refused_by_its_key() {
        for (text, expected) in [
            ("delay_ms = -1.0", "`delay_ms` is -1"),
            ("delay_spread_ms = nan", "`delay_spread_ms` is NaN"),
            ("least_quality = 101.0", "`least_quality` is 101"),
            ("latency = 1.0", "latency"),
        ] {
            let error = settings(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
