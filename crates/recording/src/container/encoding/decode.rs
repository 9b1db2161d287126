//! Decodes one message: version, checksum and input.

use posebridge_telemetry::Input;

use super::cursor::InputDecoder;
use super::{CHECKSUM_BYTES, DecodeError, NEWEST_VERSION, OLDEST_VERSION, RecordPosition};

/// Turns the bytes of one message into the input that was given.
pub(in crate::container) fn decode(bytes: &[u8], place: RecordPosition) -> Result<Input, DecodeError> {
    let Some((body, checksum)) = bytes.split_last_chunk::<CHECKSUM_BYTES>() else {
        return Err(DecodeError::TooShort { wanted: CHECKSUM_BYTES, left: bytes.len() });
    };
    let (found, expected) = (u32::from_le_bytes(*checksum), place.checksum(body));
    if found != expected {
        return Err(DecodeError::Checksum { found, expected });
    }
    if i64::try_from(place.log_time).is_err() {
        return Err(DecodeError::Time(place.log_time));
    }
    let mut cursor = InputDecoder::new(body);
    let version = cursor.u8()?;
    if !(OLDEST_VERSION..=NEWEST_VERSION).contains(&version) {
        return Err(DecodeError::Version(version));
    }
    let input = cursor.input()?;
    match cursor.remaining() {
        0 => Ok(input),
        left => Err(DecodeError::TooLong(left)),
    }
}
