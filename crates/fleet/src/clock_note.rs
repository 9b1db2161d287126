//! Notes that a station of a fleet writes into its recording, so that the recordings of several stations can be put on one clock.
//!
//! They are texts of [`Input::Report`](posebridge_telemetry::Input::Report): a person can read them, and this module reads them again.

use std::fmt;
use std::str::FromStr;

use posebridge_telemetry::TimeDelta;
use thiserror::Error;

use crate::names::{NameError, StationId};

const CLOCK: (&str, &str, &str) = ("fleet clock: ", " is ", " s ahead, to ");
const IDENTITY: &str = "fleet: this station is ";
const NANOS_PER_S: u64 = 1_000_000_000;
/// The digits of a nanosecond.
const MAX_DECIMALS: usize = 9;

/// How far ahead the clock of another station is. As text: `fleet clock: lab-2-00000000000000ab is 12.345678901 s ahead, to 0.000123 s`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClockNote {
    /// The other station.
    pub station: StationId,
    /// Host clock of the other station minus that of this one.
    pub offset: TimeDelta,
    /// The true offset is at most this far from it. Its text is rounded up to a microsecond.
    pub uncertainty: TimeDelta,
}

/// Which station recorded. As text: `fleet: this station is lab-1-000000000000001f`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdentityNote {
    pub station: StationId,
}

/// Why a text is no note.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NoteError {
    /// It is about something else.
    #[error("it is no note of a fleet about its clocks")]
    Form,
    #[error("the station of the note: {0}")]
    Station(#[from] NameError),
    #[error("`{0}` is no number of seconds with at most {MAX_DECIMALS} decimals")]
    Seconds(String),
}

impl fmt::Display for ClockNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { station, offset, uncertainty } = self;
        let (prefix, is, ahead) = CLOCK;
        let sign = if offset.as_nanos() < 0 { "-" } else { "" };
        let nanos = offset.as_nanos().unsigned_abs();
        let micros = uncertainty.as_nanos().unsigned_abs().div_ceil(1_000);
        write!(
            f,
            "{prefix}{station}{is}{sign}{}.{:09}{ahead}{}.{:06} s",
            nanos / NANOS_PER_S,
            nanos % NANOS_PER_S,
            micros / 1_000_000,
            micros % 1_000_000
        )
    }
}

impl FromStr for ClockNote {
    type Err = NoteError;

    fn from_str(text: &str) -> Result<Self, NoteError> {
        let (prefix, is, ahead) = CLOCK;
        let body = text.strip_prefix(prefix).and_then(|body| body.strip_suffix(" s")).ok_or(NoteError::Form)?;
        let (station, offsets) = body.split_once(is).ok_or(NoteError::Form)?;
        let (offset, uncertainty) = offsets.split_once(ahead).ok_or(NoteError::Form)?;
        let uncertainty = parse_seconds(uncertainty)?;
        if uncertainty < TimeDelta::ZERO {
            return Err(NoteError::Form);
        }
        Ok(Self { station: station.parse()?, offset: parse_seconds(offset)?, uncertainty })
    }
}

impl fmt::Display for IdentityNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{IDENTITY}{}", self.station)
    }
}

impl FromStr for IdentityNote {
    type Err = NoteError;

    fn from_str(text: &str) -> Result<Self, NoteError> {
        Ok(Self { station: text.strip_prefix(IDENTITY).ok_or(NoteError::Form)?.parse()? })
    }
}

/// Decimal seconds to the nanosecond, without rounding.
fn parse_seconds(text: &str) -> Result<TimeDelta, NoteError> {
    let parse = || {
        let (sign, digits) = text.strip_prefix('-').map_or((1, text), |digits| (-1, digits));
        let (whole, decimals) = digits.split_once('.').unwrap_or((digits, "0"));
        let are_digits = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
        if !are_digits(whole) || !are_digits(decimals) || decimals.len() > MAX_DECIMALS {
            return None;
        }
        let seconds: i64 = whole.parse().ok()?;
        let nanos: i64 = format!("{decimals:0<MAX_DECIMALS$}").parse().ok()?;
        seconds.checked_mul(NANOS_PER_S as i64)?.checked_add(nanos)?.checked_mul(sign)
    };
    parse().map(TimeDelta::from_nanos).ok_or_else(|| NoteError::Seconds(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::names::StationName;

    fn station() -> StationId {
        StationId { name: StationName::new("lab-2").unwrap(), instance: 0xab }
    }

    fn note(offset_nanos: i64, uncertainty_nanos: i64) -> ClockNote {
        ClockNote {
            station: station(),
            offset: TimeDelta::from_nanos(offset_nanos),
            uncertainty: TimeDelta::from_nanos(uncertainty_nanos),
        }
    }

    #[test]
    fn an_offset_is_written_to_the_nanosecond_and_its_uncertainty_is_rounded_up() {
        let text = "fleet clock: lab-2-00000000000000ab is 12.345678901 s ahead, to 0.000123 s";
        assert_eq!(note(12_345_678_901, 122_001).to_string(), text);
        assert_eq!(text.parse(), Ok(note(12_345_678_901, 123_000)));
        for offset in [0, 1, -1, -999_999_999, -1_000_000_000, i64::MAX, -i64::MAX] {
            let written = note(offset, 5_000);
            assert_eq!(written.to_string().parse(), Ok(written));
        }
        let text = "fleet: this station is lab-2-00000000000000ab";
        assert_eq!(IdentityNote { station: station() }.to_string(), text);
        assert_eq!(text.parse(), Ok(IdentityNote { station: station() }));
    }

    #[test]
    fn other_texts_are_no_notes() {
        for text in ["", "saved", "fleet: this station is lab-2-00000000000000ab", "fleet clock: a is 1 s ahead"] {
            assert_eq!(text.parse::<ClockNote>(), Err(NoteError::Form), "{text}");
        }
        let with = |station: &str, offset: &str, uncertainty: &str| {
            format!("fleet clock: {station} is {offset} s ahead, to {uncertainty} s").parse::<ClockNote>()
        };
        assert_eq!(with("lab", "1.0", "0.1"), Err(NoteError::Station(NameError::Instance)));
        let id = "lab-2-00000000000000ab";
        assert!(with(id, "1", "0.1").is_ok());
        assert_eq!(with(id, "1", "-0.1"), Err(NoteError::Form));
        for wrong in
            ["", ".", "1.", ".5", "+1", "--1", "1e3", "NaN", "0.0123456789", "9223372037", "99999999999999999999"]
        {
            assert_eq!(with(id, wrong, "0.1"), Err(NoteError::Seconds(wrong.to_owned())), "{wrong}");
        }
        assert_eq!("fleet: lab".parse::<IdentityNote>(), Err(NoteError::Form));
        assert_eq!("fleet: this station is lab".parse::<IdentityNote>(), Err(NoteError::Station(NameError::Instance)));
    }
}
