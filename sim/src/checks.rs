//! Range checks that scenarios and link profiles share.

use serde::de::{Deserialize, Deserializer, Error};

/// A number from `low` to `high`, both included; NaN is outside.
pub(crate) fn within<'de, D: Deserializer<'de>>(deserializer: D, low: f64, high: f64) -> Result<f64, D::Error> {
    let value = f64::deserialize(deserializer)?;
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(D::Error::custom(format!("{value} is outside {low} to {high}; give a number in that range")))
    }
}

/// From 0 to 1.
pub(crate) fn probability<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 0.0, 1.0)
}

/// A whole number from `low` to `high`.
pub(crate) fn whole<'de, D: Deserializer<'de>>(deserializer: D, low: u32, high: u32) -> Result<u32, D::Error> {
    let value = u32::deserialize(deserializer)?;
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(D::Error::custom(format!("{value} is outside {low} to {high}")))
    }
}
