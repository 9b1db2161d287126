//! Checks of single numbers while they are read, so that the error carries the line and the key.
//!
//! The bounds are wide: they keep the physics finite, they do not assess a design.

use serde::de::{Deserialize, Deserializer, Error};

pub(crate) use crate::checks::probability;
use crate::checks::within;

/// Largest magnitude of any number in a scenario.
pub(crate) const LARGEST: f64 = 1e6;
/// Smallest size of anything that must not be zero.
const SMALLEST: f64 = 1e-6;

/// Most laps of one run; keeps the list of manoeuvres small.
pub(super) const MAX_LAPS: u32 = 10_000;
/// The highest system id of a vehicle.
pub(crate) const LAST_VEHICLE_SYSTEM: u8 = 250;
/// A path needs two points.
const MIN_WAYPOINTS: usize = 2;
/// Most way-points; keeps the list of manoeuvres small.
pub(super) const MAX_WAYPOINTS: usize = 10_000;
/// Way-points closer than this have no direction between them, in metres.
const MIN_SPACING_M: f64 = 1e-3;

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
    if (1..=MAX_LAPS).contains(&laps) {
        Ok(laps)
    } else {
        Err(D::Error::custom(format!("{laps} laps are outside 1 to {MAX_LAPS}")))
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

/// A MAVLink system id of a vehicle; those above are for ground stations.
pub(super) fn vehicle_system<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    let system = u8::deserialize(deserializer)?;
    if (1..=LAST_VEHICLE_SYSTEM).contains(&system) {
        Ok(system)
    } else {
        Err(D::Error::custom(format!("a system id of {system} is outside 1 to {LAST_VEHICLE_SYSTEM}")))
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
    match waypoint_error(&points) {
        None => Ok(points),
        Some((_, reason)) => Err(D::Error::custom(reason)),
    }
}

/// The error in a list of way-points: the index of the first bad one, or the length if one is missing, and the reason.
pub(super) fn waypoint_error(points: &[[f64; 2]]) -> Option<(usize, String)> {
    let count = points.len();
    if count < MIN_WAYPOINTS {
        let reason = format!("the number of way-points is {count}; give {MIN_WAYPOINTS} to {MAX_WAYPOINTS}");
        return Some((count, reason));
    }
    if count > MAX_WAYPOINTS {
        let reason = format!("there are more than {MAX_WAYPOINTS} way-points; give {MIN_WAYPOINTS} to {MAX_WAYPOINTS}");
        return Some((MAX_WAYPOINTS, reason));
    }
    points.iter().enumerate().find_map(|(index, &[x_m, y_m])| {
        let largest = LARGEST;
        // A NaN is within nothing.
        if !(x_m.abs() <= largest && y_m.abs() <= largest) {
            let reason = format!("way-point ({x_m}, {y_m}) is not within {largest} m of zero");
            return Some((index, reason));
        }
        let [last_x_m, last_y_m] = *points.get(index.checked_sub(1)?)?;
        let is_close = (x_m - last_x_m).hypot(y_m - last_y_m) < MIN_SPACING_M;
        let reason = || format!("way-point ({x_m}, {y_m}) is less than 1 mm from the one before; remove one");
        is_close.then(|| (index, reason()))
    })
}
