//! From the bytes of one message to the input: the frame around the layout.

use posebridge_telemetry::Input;

use super::cursor::Cursor;
use super::{CHECKSUM_BYTES, DecodeError, OLDEST, Place, VERSION};

/// Turns the bytes of one message into the input that was given.
pub(in crate::container) fn decode(bytes: &[u8], place: Place) -> Result<Input, DecodeError> {
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
    let mut cursor = Cursor::new(body);
    let version = cursor.u8()?;
    if !(OLDEST..=VERSION).contains(&version) {
        return Err(DecodeError::Version(version));
    }
    let input = cursor.input()?;
    match cursor.left() {
        0 => Ok(input),
        left => Err(DecodeError::TooLong(left)),
    }
}
