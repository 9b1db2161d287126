//! Range checks of single numbers while they are read from TOML, so that the error carries the line and the key.
//!
//! The bounds are wide: they keep the physics finite and the memory bounded, they do not assess a design.

use std::ops::RangeInclusive;

use serde::de::{Deserialize, Deserializer, Error};

pub(crate) const LARGEST: f64 = 1e6;
/// Lower bound of sizes that must not be zero.
const SMALLEST: f64 = 1e-6;
/// Bounds the list of manoeuvres.
pub(crate) const MAX_LAPS: u32 = 10_000;
pub(crate) const LAST_VEHICLE_SYSTEM: u8 = 250;
pub const MAX_RUNS: u32 = 100_000;
/// Ten minutes; no real link delays a byte longer.
pub(crate) const LONGEST_MS: f64 = 600_000.0;
const LARGEST_BUFFER: u64 = 16 * 1024 * 1024;

/// A value in `range`; NaN is in no range. `complaint` formats the error about any other value.
fn within<'de, D: Deserializer<'de>, T: Deserialize<'de> + PartialOrd + Copy>(
    deserializer: D,
    range: RangeInclusive<T>,
    complaint: impl FnOnce(T) -> String,
) -> Result<T, D::Error> {
    let value = T::deserialize(deserializer)?;
    if range.contains(&value) { Ok(value) } else { Err(D::Error::custom(complaint(value))) }
}

fn number<'de, D: Deserializer<'de>>(deserializer: D, low: f64, high: f64) -> Result<f64, D::Error> {
    within(deserializer, low..=high, |value| format!("{value} is outside {low} to {high}; give a number in that range"))
}

fn whole<'de, D: Deserializer<'de>>(deserializer: D, low: u32, high: u32) -> Result<u32, D::Error> {
    within(deserializer, low..=high, |value| format!("{value} is outside {low} to {high}"))
}

fn bytes<'de, D: Deserializer<'de>>(deserializer: D, low: u64, high: u64) -> Result<u32, D::Error> {
    let complaint = |value| format!("{value} is outside {low} to {high}; give a whole number in that range");
    within(deserializer, low..=high, complaint).map(|bytes| bytes as u32)
}

pub(crate) fn finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, -LARGEST, LARGEST)
}

pub(crate) fn optional_finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    finite(deserializer).map(Some)
}

pub(crate) fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, SMALLEST, LARGEST)
}

pub(crate) fn non_negative<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.0, LARGEST)
}

pub(crate) fn probability<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.0, 1.0)
}

/// At most 0.5, where a bit carries no information.
pub(crate) fn bit_error_rate<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.0, 0.5)
}

/// A relative error within ±0.5.
pub(crate) fn relative<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, -0.5, 0.5)
}

/// At most 0.1, so that a draw keeps every length positive.
pub(crate) fn relative_sigma<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.0, 0.1)
}

/// At most 0.5, so that every period is positive.
pub(crate) fn period_spread<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.0, 0.5)
}

/// Within ±0.1, given in parts per million.
pub(crate) fn skew_ppm<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, -1e5, 1e5)
}

/// At most 1000 Hz, the world's step.
pub(crate) fn rate_hz<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.01, 200.0)
}

/// A temperature within the range of both thermometer messages.
pub(crate) fn degrees_c<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, -270.0, 320.0)
}

/// Up to 10 seconds.
pub(crate) fn turn_around_ms<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    number(deserializer, 0.0, 1e4).map(Some)
}

/// From a tenth of a second to an hour.
pub(crate) fn restart_interval_s<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    number(deserializer, 0.1, 3_600.0).map(Some)
}

pub(crate) fn millis<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 0.0, LONGEST_MS)
}

pub(crate) fn slot_millis<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    number(deserializer, 0.01, LONGEST_MS).map(Some)
}

/// Up to eleven days.
pub(crate) fn secs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 1e-3, 1e6)
}

/// Up to a gigabyte per second.
pub(crate) fn bytes_per_s<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    number(deserializer, 1.0, 1e9)
}

pub(crate) fn buffer_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    bytes(deserializer, 1, LARGEST_BUFFER)
}

pub(crate) fn burst_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    bytes(deserializer, 0, LARGEST_BUFFER)
}

pub(crate) fn piece_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    bytes(deserializer, 1, 65_535)
}

pub(crate) fn runs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 1, MAX_RUNS)
}

pub(crate) fn step_count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 1, 100_000)
}

/// A delay or a ramp in steps; bounded because all fixes in transit are kept in memory.
pub(crate) fn short_step_count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 0, 1_000)
}

/// Turns of a control loop between two reports.
pub(crate) fn loop_turns<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    within(deserializer, 1..=1_000, |turns| format!("{turns} is outside 1 to 1000; give a number in that range"))
}

pub(crate) fn laps<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    within(deserializer, 1..=MAX_LAPS, |laps| format!("{laps} laps are outside 1 to {MAX_LAPS}"))
}

/// At most 48 bits, so that nanoseconds fit into 64.
pub(crate) fn clock_micros<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    within(deserializer, 0..=(1 << 48) - 1, |micros: u64| {
        format!("a clock that starts at {micros} microseconds is not supported; stay below 2^48")
    })
}

pub(crate) fn tick_micros<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    within(deserializer, 1..=1_000_000, |micros| format!("a tick of {micros} microseconds is outside 1 to 1000000"))
}

pub(crate) fn vehicle_system<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    within(deserializer, 1..=LAST_VEHICLE_SYSTEM, |system| {
        format!("a system id of {system} is outside 1 to {LAST_VEHICLE_SYSTEM}")
    })
}

/// Large enough for every documented telegram, no larger than the buffer of any NXT firmware.
pub(crate) fn telegram_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    within(deserializer, 64..=128, |bytes| format!("telegrams of {bytes} bytes are outside 64 to 128"))
}
