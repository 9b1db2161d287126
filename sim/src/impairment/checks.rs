//! Checks of single numbers of a profile while they are read, so that the error carries the line and the key.
//!
//! The bounds keep arithmetic finite and memory bounded; they do not assess a link.

use serde::de::{Deserialize, Deserializer, Error};

pub(super) use crate::checks::probability;
use crate::checks::within;

/// Ten minutes: longer than any link holds anything back.
pub(super) const LONGEST_MS: f64 = 600_000.0;
/// Eleven days.
const LONGEST_S: f64 = 1e6;
/// A gigabyte per second.
const FASTEST_BYTES_PER_S: f64 = 1e9;
/// Largest buffer that a profile can ask for, in bytes.
const LARGEST_BUFFER: u64 = 16 * 1024 * 1024;
/// At this rate of errors nothing of a bit is left.
const RANDOM_BIT: f64 = 0.5;

fn whole_within<'de, D: Deserializer<'de>>(deserializer: D, low: u64, high: u64) -> Result<u32, D::Error> {
    let value = u64::deserialize(deserializer)?;
    match u32::try_from(value) {
        Ok(fits) if (low..=high).contains(&value) => Ok(fits),
        _ => Err(D::Error::custom(format!("{value} is outside {low} to {high}; give a whole number in that range"))),
    }
}

/// From 0 to a half.
pub(super) fn bit_error_rate<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 0.0, RANDOM_BIT)
}

/// Milliseconds, zero or more.
pub(super) fn millis<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 0.0, LONGEST_MS)
}

/// Milliseconds between two slots.
pub(super) fn slot_millis<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    within(deserializer, 0.01, LONGEST_MS).map(Some)
}

/// Seconds, more than zero.
pub(super) fn secs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 1e-3, LONGEST_S)
}

/// Bytes per second.
pub(super) fn bytes_per_s<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    within(deserializer, 1.0, FASTEST_BYTES_PER_S)
}

/// A buffer that holds something.
pub(super) fn buffer_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole_within(deserializer, 1, LARGEST_BUFFER)
}

/// Bytes that may pass at once.
pub(super) fn burst_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole_within(deserializer, 0, LARGEST_BUFFER)
}

/// Bytes of a piece.
pub(super) fn piece_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole_within(deserializer, 1, 65_535)
}
