//! Checks of single numbers while they are read, so that the error carries the line and the key.
//!
//! The bounds are wide: they keep the physics finite, they do not judge a design.

use serde::de::{Deserialize, Deserializer, Error};

pub(crate) use crate::checks::probability;
use crate::checks::within;

/// Largest magnitude of any number in a scenario.
pub(crate) const LARGEST: f64 = 1e6;
/// Smallest size of anything that must not be zero.
const SMALLEST: f64 = 1e-6;

/// Anything finite.
pub(crate) fn finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, -LARGEST, LARGEST)
}

/// Greater than zero.
pub(crate) fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, SMALLEST, LARGEST)
}

/// Zero or greater.
pub(crate) fn non_negative<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 0.0, LARGEST)
}

/// A relative error of at most a half, either way.
pub(super) fn relative<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, -0.5, 0.5)
}

/// The standard deviation of a relative error; at most a tenth, so that a draw keeps every length positive.
pub(crate) fn relative_sigma<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 0.0, 0.1)
}

/// A clock's rate error, at most a tenth either way, in parts per million.
pub(super) fn skew_ppm<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, -1e5, 1e5)
}

/// A rate that the world's step of one millisecond can resolve, in hertz.
pub(super) fn rate_hz<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 0.01, 200.0)
}

/// A number of laps.
pub(crate) fn laps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let laps = u32::deserialize(deserializer)?;
    if (1..=super::course::MAX_LAPS).contains(&laps) {
        Ok(laps)
    } else {
        Err(D::Error::custom(format!("{laps} laps are outside 1 to {}", super::course::MAX_LAPS)))
    }
}

/// A clock's value, at most 48 bits, so that nanoseconds fit into 64.
pub(super) fn clock_micros<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    let micros = u64::deserialize(deserializer)?;
    if micros < 1 << 48 {
        Ok(micros)
    } else {
        Err(D::Error::custom(format!("a clock that starts at {micros} microseconds is not supported; stay below 2^48")))
    }
}

/// A clock's resolution: 1 microsecond to 1 second.
pub(super) fn tick_micros<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let micros = u32::deserialize(deserializer)?;
    if (1..=1_000_000).contains(&micros) {
        Ok(micros)
    } else {
        Err(D::Error::custom(format!("a tick of {micros} microseconds is outside 1 to 1000000")))
    }
}

/// A time of up to 10 seconds, in milliseconds.
pub(super) fn optional_millis<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    within(deserializer, 0.0, 1e4).map(Some)
}

/// A time from a tenth of a second to an hour, in seconds.
pub(super) fn optional_seconds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    within(deserializer, 0.1, 3_600.0).map(Some)
}

/// Anything finite.
pub(super) fn optional_finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    finite(deserializer).map(Some)
}

/// The buffer of an NXT's firmware: large enough for every telegram that is documented, no larger than any that was made.
pub(super) fn telegram_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    let bytes = usize::deserialize(deserializer)?;
    if (64..=128).contains(&bytes) {
        Ok(bytes)
    } else {
        Err(D::Error::custom(format!("telegrams of {bytes} bytes are outside 64 to 128")))
    }
}

/// A list of way-points.
pub(super) fn waypoints<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    let points = Vec::<[f64; 2]>::deserialize(deserializer)?;
    match super::waypoints::fault(&points) {
        None => Ok(points),
        Some((_, reason)) => Err(D::Error::custom(reason)),
    }
}
