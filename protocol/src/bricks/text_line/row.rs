//! Parses one line to values in SI units.

use std::ops::Neg;

use super::numbers::numbers;
use super::settings::{ChecksumPolicy, Column, ColumnSign, LineLayout, Quantity, Separator, TextLineSettings};
use crate::message::WireStamp;

/// Largest turn rate, rad/s: sixteen turns per second, beyond any gyro of such a board.
const MAX_RAD_PER_S: f64 = 100.0;
/// Largest range of a sensor on a robot, m.
const MAX_RANGE_M: f64 = 1_000.0;
/// Range of a thermometer, degrees Celsius: from absolute zero to the melting point of tungsten, as in the other
/// protocols.
const TEMPERATURES_C: std::ops::RangeInclusive<f64> = -273.15..=3_500.0;
/// Voltages of the batteries of small robots; a board without one says 0.
const BATTERIES_V: std::ops::RangeInclusive<f64> = 0.0..=60.0;
/// Larger counts are not exact in f64.
const MAX_COUNT: i64 = 1 << 53;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BoardReading {
    /// Of the board's own clock, 32 bits.
    pub(super) time: Option<WireStamp>,
    pub(super) left: Option<i64>,
    pub(super) right: Option<i64>,
    pub(super) turn_rate_rad_per_s: Option<f64>,
    pub(super) range_m: Option<f64>,
    pub(super) temperature_c: Option<f64>,
    pub(super) battery_v: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum LineError {
    #[error("it is no text")]
    NotText,
    #[error("its checksum is {found:02X} and not {expected:02X}")]
    Checksum { found: u8, expected: u8 },
    #[error("it has no checksum")]
    NoChecksum,
    #[error("it has no `{0}`")]
    Missing(Quantity),
    #[error("it has `{0}` twice")]
    Duplicate(Quantity),
    #[error("it has {found} values and not {expected}")]
    Count { found: usize, expected: usize },
    /// A line for people.
    #[error("it has no number")]
    NoNumber,
    #[error("`{0}` is no number that can be")]
    InvalidNumber(Quantity),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ChecksumStatus {
    Verified,
    Absent,
}

/// The text of a line without `$` and checksum, and whether it had a checksum.
pub(crate) fn strip_checksum(line: &[u8], checksum: ChecksumPolicy) -> Result<(&str, ChecksumStatus), LineError> {
    let is_text = |byte: &u8| matches!(byte, 0x20..=0x7E | b'\t');
    let text = std::str::from_utf8(line)
        .ok()
        .filter(|text| text.bytes().all(|byte| is_text(&byte)))
        .ok_or(LineError::NotText)?
        .trim_ascii();
    let text = text.strip_prefix('$').unwrap_or(text);
    let Some((text, found)) = checksum_of(text) else {
        return match checksum {
            ChecksumPolicy::Optional => Ok((text, ChecksumStatus::Absent)),
            ChecksumPolicy::Required => Err(LineError::NoChecksum),
        };
    };
    let expected = exclusive_or(text.as_bytes());
    if found == expected { Ok((text, ChecksumStatus::Verified)) } else { Err(LineError::Checksum { found, expected }) }
}

/// The exclusive or of all bytes: NMEA 0183's checksum.
pub(super) fn exclusive_or(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum ^ byte)
}

/// The text before `*hh`, and the value of `hh`.
fn checksum_of(text: &str) -> Option<(&str, u8)> {
    let (text, digits) = text.rsplit_once('*')?;
    let is_checksum = digits.len() == 2 && digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    let found = u8::from_str_radix(digits, 16).ok()?;
    is_checksum.then_some((text, found))
}

/// Parses a line without its checksum. Names that are not in the layout are added to `unknown`.
pub(super) fn parse_row(
    text: &str,
    settings: &TextLineSettings,
    unknown: &mut dyn FnMut(&str),
) -> Result<BoardReading, LineError> {
    match &settings.layout {
        LineLayout::Columns { columns, separator } => {
            parse_columns(text, columns, *separator, settings.gyro_counts_per_deg_per_s)
        }
        LineLayout::Pairs { keys, separator, key_separator } => {
            let pairs = pairs(text, *separator, *key_separator);
            parse_pairs(&pairs, keys, settings.gyro_counts_per_deg_per_s, unknown)
        }
    }
}

fn parse_columns(
    text: &str,
    columns: &[Column],
    separator: Separator,
    gyro_counts_per_deg_per_s: f64,
) -> Result<BoardReading, LineError> {
    let values: Vec<&str> = split(text, separator);
    if separator == Separator::Words && values.is_empty() {
        return Err(LineError::NoNumber);
    }
    if values.len() != columns.len() {
        return Err(LineError::Count { found: values.len(), expected: columns.len() });
    }
    let mut row = BoardReading::default();
    for (column, value) in columns.iter().zip(values) {
        row.set(*column, value, gyro_counts_per_deg_per_s).ok_or(LineError::InvalidNumber(column.quantity))?;
    }
    Ok(row)
}

fn parse_pairs(
    pairs: &[(&str, &str)],
    keys: &[(String, Column)],
    gyro_counts_per_deg_per_s: f64,
    unknown: &mut dyn FnMut(&str),
) -> Result<BoardReading, LineError> {
    let mut row = BoardReading::default();
    for (key, column) in keys {
        let mut values = pairs.iter().filter(|(name, _)| name == key);
        let (_, value) = values.next().ok_or(LineError::Missing(column.quantity))?;
        if values.next().is_some() {
            return Err(LineError::Duplicate(column.quantity));
        }
        row.set(*column, value, gyro_counts_per_deg_per_s).ok_or(LineError::InvalidNumber(column.quantity))?;
    }
    for (name, _) in pairs {
        if !keys.iter().any(|(key, _)| key == name) {
            unknown(name);
        }
    }
    Ok(row)
}

/// Names and values. If both separators are the same, names and values alternate.
fn pairs(text: &str, separator: Separator, key_separator: Separator) -> Vec<(&str, &str)> {
    if separator == key_separator {
        let fields: Vec<&str> = split(text, separator);
        let pairs = fields.chunks(2).filter_map(|pair| match pair {
            [key, value] => Some((*key, *value)),
            _ => None,
        });
        return pairs.collect();
    }
    let pairs = split(text, separator).into_iter().filter_map(|pair| match key_separator {
        Separator::Blank => pair.split_once([' ', '\t']),
        // Words are between numbers: no name is left.
        Separator::Words => None,
        Separator::Comma | Separator::Semicolon | Separator::Pipe | Separator::Colon | Separator::Equals => {
            pair.split_once(key_separator.text())
        }
    });
    pairs.map(|(key, value)| (key.trim_ascii(), value.trim_ascii())).collect()
}

/// The parts of a text, trimmed. Several blanks are one.
fn split(text: &str, separator: Separator) -> Vec<&str> {
    match separator {
        Separator::Words => numbers(text).into_iter().map(|number| number.text).collect(),
        Separator::Blank => text.split_ascii_whitespace().collect(),
        Separator::Comma | Separator::Semicolon | Separator::Pipe | Separator::Colon | Separator::Equals => {
            text.split(separator.text()).map(str::trim_ascii).collect()
        }
    }
}

impl BoardReading {
    /// Stores a value; `None` if it is not a valid number for its quantity.
    fn set(&mut self, column: Column, value: &str, gyro_counts_per_deg_per_s: f64) -> Option<()> {
        match column.quantity {
            Quantity::TimeMs => self.time = Some(WireStamp::Millis32(counter(value)?)),
            Quantity::TimeUs => self.time = Some(WireStamp::Micros32(counter(value)?)),
            Quantity::TimeS => self.time = Some(WireStamp::Micros32(micros(parse_float(value)?)?)),
            Quantity::LeftTicks => self.left = Some(signed(parse_integer(value)?, column.sense)),
            Quantity::RightTicks => self.right = Some(signed(parse_integer(value)?, column.sense)),
            Quantity::GyroDegPerS => {
                self.turn_rate_rad_per_s = Some(rate(parse_float(value)?.to_radians(), column.sense)?);
            }
            Quantity::GyroRadPerS => {
                self.turn_rate_rad_per_s = Some(rate(parse_float(value)?, column.sense)?);
            }
            Quantity::GyroCounts => {
                let deg_per_s = parse_float(value)? / gyro_counts_per_deg_per_s;
                self.turn_rate_rad_per_s = Some(rate(deg_per_s.to_radians(), column.sense)?);
            }
            Quantity::DistanceMm => self.range_m = range(parse_float(value)? / 1_000.0),
            Quantity::DistanceCm => self.range_m = range(parse_float(value)? / 100.0),
            Quantity::DistanceM => self.range_m = range(parse_float(value)?),
            Quantity::TemperatureC => {
                let shown = Some(parse_float(value)?);
                self.temperature_c = Some(shown.filter(|shown| TEMPERATURES_C.contains(shown))?);
            }
            Quantity::BatteryV => {
                let volts = parse_float(value).filter(|volts| BATTERIES_V.contains(volts))?;
                self.battery_v = (volts > 0.0).then_some(volts);
            }
            Quantity::Ignore => {}
        }
        Some(())
    }
}

fn parse_float(text: &str) -> Option<f64> {
    let value: f64 = text.parse().ok()?;
    value.is_finite().then_some(value)
}

/// A whole number; boards that print floats write `12.00`.
fn parse_integer(text: &str) -> Option<i64> {
    let value = match text.parse::<i64>() {
        Ok(value) => value,
        Err(_) => parse_float(text).filter(|value| value.fract() == 0.0)? as i64,
    };
    (-MAX_COUNT..=MAX_COUNT).contains(&value).then_some(value)
}

/// A clock value, modulo its period.
fn counter(text: &str) -> Option<u32> {
    let value = parse_integer(text).filter(|value| *value >= 0)?;
    Some(value as u32)
}

/// Seconds as microseconds, modulo the counter's period.
fn micros(seconds: f64) -> Option<u32> {
    let micros = (seconds * 1e6).round();
    (0.0..=MAX_COUNT as f64).contains(&micros).then_some(micros as u64 as u32)
}

fn rate(rad_per_s: f64, sense: ColumnSign) -> Option<f64> {
    (rad_per_s.abs() <= MAX_RAD_PER_S).then_some(signed(rad_per_s, sense))
}

fn signed<T: Neg<Output = T>>(value: T, sense: ColumnSign) -> T {
    match sense {
        ColumnSign::Normal => value,
        ColumnSign::Inverted => -value,
    }
}

/// Range finders without an echo give zero, a negative or a very large number.
fn range(range_m: f64) -> Option<f64> {
    (range_m > 0.0 && range_m <= MAX_RANGE_M).then_some(range_m)
}
