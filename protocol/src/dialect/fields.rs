//! Payloads of any message to the values of its fields, and back, by its definition.
//!
//! Values are those of the wire: no unit is converted, no value judged. Bytes that a payload lacks are zeros, as MAVLink 2 says of zeros that
//! were cut off; so are extension fields in version 1.

use std::ops::Range;

use posebridge_telemetry::Address;

use super::definitions::{FieldDefinition, MessageDefinition, Scalar};
use super::payload::{MAX_PAYLOAD, text_from};
use crate::framing::{FrameRef, START_BYTE_V1, START_BYTE_V2, WireVersion, checksum};

/// A payload of full length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FullPayload([u8; MAX_PAYLOAD]);

/// The value of a field, or of one element of an array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'p> {
    Unsigned(u64),
    Signed(i64),
    Single(f32),
    Double(f64),
    /// All characters of the field, whatever follows the first NUL.
    Text(&'p [u8]),
}

impl Value<'_> {
    /// Appends a number with the fewest digits that read as the same number, or text up to the first NUL with what is not printable replaced.
    #[inline]
    pub(super) fn append_to(&self, text: &mut String) {
        let mut integer = itoa::Buffer::new();
        let mut float = zmij::Buffer::new();
        text.push_str(match self {
            Self::Unsigned(value) => integer.format(*value),
            Self::Signed(value) => integer.format(*value),
            Self::Single(value) => float.format(*value),
            Self::Double(value) => float.format(*value),
            Self::Text(bytes) => return text.push_str(&text_from(bytes)),
        });
    }
}

impl FullPayload {
    /// Bytes beyond the longest payload are ignored.
    pub fn new(payload: &[u8]) -> Self {
        let mut full = [0; MAX_PAYLOAD];
        let length = payload.len().min(MAX_PAYLOAD);
        full[..length].copy_from_slice(&payload[..length]);
        Self(full)
    }

    /// Empty beyond the longest payload.
    pub(super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        self.0.get(range).unwrap_or_default()
    }

    /// The values of a field: one, or as many as its array has elements; text is one value.
    pub fn values(&self, field: &FieldDefinition) -> impl Iterator<Item = Value<'_>> {
        let (size, scalar) = (field.scalar.size(), field.scalar);
        let bytes = self.bytes(field.offset..field.offset + field.size());
        bytes.chunks_exact(if field.is_text() { field.size() } else { size }).map(move |bytes| value_of(scalar, bytes))
    }

    /// Sets one element of a field; false, and nothing is changed, if the value does not fit its type or there is no such element.
    pub fn set(&mut self, field: &FieldDefinition, index: usize, value: Value<'_>) -> bool {
        let size = field.scalar.size();
        let start = field.offset + index * size;
        if index >= usize::from(field.array.unwrap_or(1)) {
            return false;
        }
        let wide;
        let bytes = match value {
            Value::Text(text) if field.is_text() && text.len() <= field.size() => text,
            Value::Unsigned(_) | Value::Signed(_) | Value::Single(_) | Value::Double(_) | Value::Text(_) => {
                let Some(bytes) = bytes_of(field.scalar, value) else { return false };
                wide = bytes;
                &wide[..size]
            }
        };
        let whole = if field.is_text() { field.size() } else { size };
        let Some(target) = self.0.get_mut(start..start + whole) else { return false };
        // A text that was longer before leaves nothing behind.
        target.fill(0);
        target[..bytes.len()].copy_from_slice(bytes);
        true
    }

    /// The payload as `version` sends it: without extension fields, or without the zeros at its end.
    pub fn wire_bytes(&self, definition: &MessageDefinition, version: WireVersion) -> &[u8] {
        match version {
            WireVersion::V1 => &self.0[..usize::from(definition.layout.max_len_v1)],
            WireVersion::V2 => {
                let bytes = &self.0[..usize::from(definition.layout.max_len_v2)];
                let length = bytes.iter().rposition(|byte| *byte != 0).map_or(1, |last| last + 1);
                &bytes[..length]
            }
        }
    }
}

/// `bytes` are those of one value.
#[inline]
pub(super) fn value_of(scalar: Scalar, bytes: &[u8]) -> Value<'_> {
    let mut wide = [0; 8];
    let length = bytes.len().min(8);
    wide[..length].copy_from_slice(&bytes[..length]);
    let [b0, b1, b2, b3, ..] = wide;
    let four = [b0, b1, b2, b3];
    match scalar {
        Scalar::Char => Value::Text(bytes),
        Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => Value::Unsigned(u64::from_le_bytes(wide)),
        Scalar::I8 => Value::Signed(i64::from(b0.cast_signed())),
        Scalar::I16 => Value::Signed(i64::from(i16::from_le_bytes([b0, b1]))),
        Scalar::I32 => Value::Signed(i64::from(i32::from_le_bytes(four))),
        Scalar::I64 => Value::Signed(i64::from_le_bytes(wide)),
        Scalar::F32 => Value::Single(f32::from_le_bytes(four)),
        Scalar::F64 => Value::Double(f64::from_le_bytes(wide)),
    }
}

/// Little-endian, the lowest bytes of the type's size; `None` if the value does not fit.
fn bytes_of(scalar: Scalar, value: Value<'_>) -> Option<[u8; 8]> {
    let bits = 8 * scalar.size() as u32;
    match (scalar, value) {
        (Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64, Value::Unsigned(value)) => {
            (bits == 64 || value >> bits == 0).then(|| value.to_le_bytes())
        }
        (Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64, Value::Signed(value)) => {
            let unused = 64 - bits;
            ((value << unused) >> unused == value).then(|| value.to_le_bytes())
        }
        (Scalar::F32, Value::Single(value)) => {
            let mut wide = [0; 8];
            wide[..4].copy_from_slice(&value.to_le_bytes());
            Some(wide)
        }
        (Scalar::F64, Value::Double(value)) => Some(value.to_le_bytes()),
        _ => None,
    }
}

/// An unsigned frame with this payload, as a sender without further flags writes it; `None` for a message that this version cannot name.
pub fn frame(
    definition: &MessageDefinition,
    version: WireVersion,
    source: Address,
    sequence: u8,
    payload: &FullPayload,
) -> Option<Vec<u8>> {
    if version == WireVersion::V1 && definition.id > 0xFF {
        return None;
    }
    let payload = payload.wire_bytes(definition, version);
    let [id0, id1, id2, _] = definition.id.to_le_bytes();
    let (system, component) = (source.system.0, source.component.0);
    let mut frame = match version {
        WireVersion::V1 => vec![START_BYTE_V1, payload.len() as u8, sequence, system, component, id0],
        WireVersion::V2 => {
            vec![START_BYTE_V2, payload.len() as u8, 0, 0, sequence, system, component, id0, id1, id2]
        }
    };
    frame.extend_from_slice(payload);
    let sum = checksum(&frame[1..], definition.layout.crc_extra);
    frame.extend(sum.to_le_bytes());
    Some(frame)
}

/// Names of the columns of a message's table: the field, `[i]` for the elements of an array, and its unit in square brackets behind a space.
pub fn columns(definition: &MessageDefinition) -> Vec<String> {
    let names = definition.fields.iter().flat_map(|field| {
        let unit = field.unit.map_or_else(String::new, |unit| format!(" [{unit}]"));
        let elements = field.array.filter(|_| !field.is_text());
        (0..elements.unwrap_or(1)).map(move |index| match elements {
            Some(_) => format!("{}[{index}]{unit}", field.name),
            None => format!("{}{unit}", field.name),
        })
    });
    names.collect()
}

/// Whether [`frame`] makes exactly this frame of its values.
pub fn is_reproduced(definition: &MessageDefinition, frame: &FrameRef<'_>, payload: &FullPayload) -> bool {
    self::frame(definition, frame.version, frame.source, frame.sequence, payload).is_some_and(|made| made == frame.raw)
}

#[cfg(test)]
mod tests {
    use super::super::definition;
    use super::super::definitions::definitions;
    use super::*;

    #[test]
    fn every_message_is_written_as_it_was_read_at_every_length() {
        for definition in definitions() {
            let longest = usize::from(definition.layout.max_len_v2);
            let bytes: Vec<u8> = (0..longest).map(|at| (at as u8).wrapping_mul(37).wrapping_add(1)).collect();
            for length in 0..=longest {
                let read = FullPayload::new(&bytes[..length]);
                let mut written = FullPayload::new(&[]);
                for field in &definition.fields {
                    for (index, value) in read.values(field).enumerate() {
                        assert!(written.set(field, index, value), "{}.{}", definition.name, field.name);
                    }
                }
                assert_eq!(written, read, "{} of {length} bytes", definition.name);
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let status = definition(1).unwrap();
        let field = |name: &str| status.fields.iter().find(|field| field.name == name).unwrap();
        let mut payload = FullPayload::new(&[]);
        assert!(!payload.set(field("load"), 0, Value::Unsigned(65_536)));
        assert!(!payload.set(field("load"), 1, Value::Unsigned(1)), "it is no array");
        assert!(!payload.set(field("current_battery"), 0, Value::Signed(-32_769)));
        assert!(!payload.set(field("current_battery"), 0, Value::Single(1.0)));
        assert!(payload.set(field("current_battery"), 0, Value::Signed(-32_768)));
        assert_eq!(payload.values(field("current_battery")).next(), Some(Value::Signed(-32_768)));
        assert_eq!(frame(definition(42_102).unwrap(), WireVersion::V1, Address::new(1, 1), 0, &payload), None);
    }

    #[test]
    fn a_shorter_text_leaves_nothing_of_the_one_before() {
        let value = definition(22).unwrap();
        let name = value.fields.iter().find(|field| field.is_text()).unwrap();
        let mut payload = FullPayload::new(&[]);
        for text in [b"RATE_P".as_slice(), b"GAIN"] {
            assert!(payload.set(name, 0, Value::Text(text)));
        }
        let Some(Value::Text(text)) = payload.values(name).next() else { panic!("it is text") };
        assert_eq!(text[..6], *b"GAIN\0\0");
    }

    #[test]
    fn columns_have_units_and_elements() {
        let names = columns(definition(42_102).unwrap());
        assert_eq!(names[..2], ["time_us [us]", "x [m]"]);
        assert_eq!(names[6], "covariance[0]");
    }
}
