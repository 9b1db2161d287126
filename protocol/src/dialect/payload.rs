//! The fields of payloads, little-endian, for any message; and why a payload is refused.
//!
//! Messages without enumerations use the generated types. Those with enumerations are read and written field by field
//! in wire order, because the generated code rejects a whole message for one value that its XML does not list, and an
//! unknown command must still be answered.

use mavlink_core::{MavlinkVersion, MessageData};
use num_traits::{FromBytes, ToBytes};
use posebridge_telemetry::{Address, printable};

use crate::message::{Message, WireStamp};

pub(super) const MAX_PAYLOAD: usize = 255;

/// The fields of a message in wire order; fields at its end that are not written are zero.
#[derive(Debug)]
pub(super) struct Payload {
    pub(super) message_id: u32,
    pub(super) bytes: [u8; MAX_PAYLOAD],
    len: usize,
}

impl Payload {
    pub(super) const fn new(message_id: u32) -> Self {
        Self { message_id, bytes: [0; MAX_PAYLOAD], len: 0 }
    }

    /// Encodes a generated message.
    pub(super) fn encode<D: MessageData>(data: &D) -> Self {
        let mut payload = Self::new(D::ID);
        payload.len = data.ser(MavlinkVersion::V2, &mut payload.bytes);
        payload
    }

    /// Appends raw bytes; the callers' layouts are constants of at most [`MAX_PAYLOAD`] bytes.
    pub(super) fn raw(mut self, bytes: &[u8]) -> Self {
        self.bytes[self.len..self.len + bytes.len()].copy_from_slice(bytes);
        self.len += bytes.len();
        self
    }

    /// Little-endian.
    pub(super) fn number<T: ToBytes + Copy>(self, value: T) -> Self {
        self.raw(value.to_le_bytes().as_ref())
    }

    pub(super) fn f32s(self, values: &[f32]) -> Self {
        values.iter().fold(self, |payload, value| payload.number::<f32>(*value))
    }

    pub(super) fn text<const N: usize>(self, text: &str) -> Self {
        self.raw(&text_to::<N>(text))
    }

    pub(super) fn address(self, address: Address) -> Self {
        self.raw(&[address.system.0, address.component.0])
    }
}

/// Decodes a generated message. Truncated bytes are zeros, in version 1 as well.
pub(super) fn decode_generated<D: MessageData>(payload: &[u8]) -> Result<D, PayloadError> {
    D::deser(MavlinkVersion::V2, payload).map_err(|source| PayloadError::Layout { message_id: D::ID, source })
}

/// Reads fields in order; after the end there are zeros.
#[derive(Debug)]
pub(super) struct PayloadReader<'a> {
    rest: &'a [u8],
}

impl<'a> PayloadReader<'a> {
    pub(super) const fn new(payload: &'a [u8]) -> Self {
        Self { rest: payload }
    }

    fn fill(&mut self, bytes: &mut [u8]) {
        let (taken, rest) = self.rest.split_at(self.rest.len().min(bytes.len()));
        bytes[..taken.len()].copy_from_slice(taken);
        self.rest = rest;
    }

    /// Little-endian.
    pub(super) fn number<T: FromBytes<Bytes: Default + Sized>>(&mut self) -> T {
        let mut bytes = T::Bytes::default();
        self.fill(bytes.as_mut());
        T::from_le_bytes(&bytes)
    }

    pub(super) fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        self.fill(&mut bytes);
        bytes
    }

    pub(super) fn f32s<const N: usize>(&mut self) -> [f32; N] {
        std::array::from_fn(|_| self.number())
    }

    pub(super) fn skip<const N: usize>(&mut self) {
        let _: [u8; N] = self.bytes();
    }

    pub(super) fn text<const N: usize>(&mut self) -> String {
        text_from(&self.bytes::<N>())
    }

    pub(super) fn address(&mut self) -> Address {
        let [system, component] = self.bytes();
        Address::new(system, component)
    }
}

/// Text up to the first NUL; invalid UTF-8 and what is not printable are replaced.
pub(super) fn text_from(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    printable(&String::from_utf8_lossy(&bytes[..end]))
}

/// As many whole characters of `text` as fit into N bytes, padded with NUL.
pub(super) fn text_to<const N: usize>(text: &str) -> [u8; N] {
    let end = (0..=text.len().min(N)).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
    let mut bytes = [0; N];
    bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
    bytes
}

/// The address; `None` for 0/0, which is a broadcast.
pub(super) fn specific_address(address: Address) -> Option<Address> {
    (address != Address::new(0, 0)).then_some(address)
}

/// A stamp in whole microseconds, wrapped to 32 bits.
pub(super) const fn micros32(stamp: WireStamp) -> u32 {
    micros64(stamp) as u32
}

/// A stamp in whole milliseconds, rounded down, wrapped to 32 bits.
pub(super) const fn millis32(stamp: WireStamp) -> u32 {
    match stamp {
        WireStamp::Millis32(millis) => millis,
        WireStamp::Micros32(_) | WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => {
            (micros64(stamp) / 1_000) as u32
        }
    }
}

pub(super) const fn micros64(stamp: WireStamp) -> u64 {
    stamp.as_micros()
}

/// Why the payload of a verified frame is invalid.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PayloadError {
    #[error("message {message_id}: {field} is {value}, it must be finite")]
    NotFinite { message_id: u32, field: &'static str, value: f64 },
    #[error(
        "message {message_id}: a temperature of {degrees_c} degrees Celsius is below absolute zero or above the range of any sensor"
    )]
    Temperature { message_id: u32, degrees_c: f64 },
    /// ODOMETRY in an unsupported coordinate frame.
    #[error(
        "message {message_id}: no conversion from MAV_FRAME {frame}; send 1, 4, 14 to 17, 20 or 21 with child 8, 12 or 13"
    )]
    UnknownFrame {
        message_id: u32,
        /// MAV_FRAME of the pose or of the speeds.
        frame: u8,
    },
    #[error("message {message_id}: its quality is negative, the sender says that it has failed")]
    SenderFailed { message_id: u32 },
    #[error("message {message_id}: {count} wheels, at least 2 are needed")]
    TooFewWheels { message_id: u32, count: u8 },
    #[error("message {message_id}: the payload does not fit its definition")]
    Layout { message_id: u32, source: mavlink_core::error::ParserError },
}

impl PayloadError {
    pub const fn message_id(&self) -> u32 {
        match *self {
            Self::NotFinite { message_id, .. }
            | Self::Temperature { message_id, .. }
            | Self::UnknownFrame { message_id, .. }
            | Self::SenderFailed { message_id }
            | Self::TooFewWheels { message_id, .. }
            | Self::Layout { message_id, .. } => message_id,
        }
    }
}

/// The result of one payload: `None` when the message is known and not used.
pub(super) type Decoded = Result<Option<Message>, PayloadError>;

pub(super) fn require_finite(message_id: u32, field: &'static str, value: f64) -> Result<f64, PayloadError> {
    if value.is_finite() { Ok(value) } else { Err(PayloadError::NotFinite { message_id, field, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_cut_between_characters() {
        assert_eq!(text_to::<4>("abä"), *b"ab\xC3\xA4");
        assert_eq!(text_to::<3>("abä"), *b"ab\0");
        assert_eq!(text_from(&text_to::<3>("abä")), "ab");
        assert_eq!(text_from(b"a\xFFb\0rest"), "a\u{FFFD}b");
        assert_eq!(text_from(b"\x1b]0;owned\x07\r\n"), "?]0;owned???");
    }

    #[test]
    fn stamps_convert_and_wrap() {
        assert_eq!(millis32(WireStamp::Micros64(5_000_000_999)), 5_000_000);
        assert_eq!(micros32(WireStamp::Micros64((1 << 32) + 7)), 7);
        assert_eq!(micros64(WireStamp::Millis32(2)), 2_000);
    }
}
