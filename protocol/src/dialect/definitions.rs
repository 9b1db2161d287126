//! Every message of the stock dialects and of ours as its definition gives it: name, CRC_EXTRA, lengths, fields in the order of the wire.
//!
//! The station reads messages by the generated types and the readers of this module's neighbours; this table is for files, whose
//! messages are shown whatever they are. [`super::fields`] reads and writes payloads by it.
//!
//! # Sources
//! `all.xml` and `ardupilotmega.xml` of the MAVLink project with everything that they include (upstream commit 19795337), and
//! `posebridge.xml`; seeds, lengths and order by pymavlink 2.4.50's `mavparse` (`protocol/definitions/make_message_table.py`).

use std::sync::LazyLock;

use mavlink::dialects::common;

use super::generated::posebridge;

/// A line for each message, by rising id: `id,crc_extra,max_len_v1,max_len_v2,NAME` and its fields, each behind a semicolon:
/// `name type unit`, the unit where there is one. A `+` before the type marks an extension field.
const TABLE: &str = include_str!("message_table.txt");
static DEFINITIONS: LazyLock<Vec<MessageDefinition>> =
    LazyLock::new(|| TABLE.lines().filter_map(MessageDefinition::parse).collect());

/// Every definition, by rising id.
pub fn definitions() -> &'static [MessageDefinition] {
    &DEFINITIONS
}

/// The id of the message with this name; case-sensitive.
pub fn message_id_named(name: &str) -> Option<u32> {
    definitions().iter().find(|message| message.name == name).map(|message| message.id)
}

/// A message as its definition in XML gives it.
#[derive(Clone, Debug)]
pub struct MessageDefinition {
    pub id: u32,
    /// As in the XML, such as `HEARTBEAT`.
    pub name: &'static str,
    pub(crate) layout: MessageLayout,
    /// In the order of the wire; extension fields last.
    pub fields: Vec<FieldDefinition>,
}

/// The checksum seed and the lengths of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MessageLayout {
    /// Seed of the checksum, from the message's definition.
    pub(crate) crc_extra: u8,
    /// Payload length without extension fields.
    pub(crate) max_len_v1: u8,
    /// Payload length with extension fields.
    pub(crate) max_len_v2: u8,
    /// Whether it belongs to neither common.xml nor our own dialect.
    pub(crate) is_foreign: bool,
}

/// A field of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldDefinition {
    pub name: &'static str,
    pub scalar: Scalar,
    /// Number of elements; `None` if it is no array.
    pub array: Option<u8>,
    /// As in the XML, such as `cdegC`.
    pub unit: Option<&'static str>,
    pub is_extension: bool,
    /// Of its first byte in the payload.
    pub(crate) offset: usize,
}

impl MessageDefinition {
    fn parse(line: &'static str) -> Option<Self> {
        let mut parts = line.split(';');
        let [id, crc_extra, max_len_v1, max_len_v2, name] = parts.next()?.split(',').collect::<Vec<_>>()[..] else {
            return None;
        };
        let id = id.parse().ok()?;
        let layout = MessageLayout {
            crc_extra: crc_extra.parse().ok()?,
            max_len_v1: max_len_v1.parse().ok()?,
            max_len_v2: max_len_v2.parse().ok()?,
            is_foreign: !common::MavMessage::all_ids().contains(&id)
                && !posebridge::MavMessage::all_ids().contains(&id),
        };
        let mut offset = 0;
        let fields = parts.map(|part| {
            let field = FieldDefinition::parse(part, offset)?;
            offset += field.size();
            Some(field)
        });
        Some(Self { id, name, layout, fields: fields.collect::<Option<_>>()? })
    }
}

impl FieldDefinition {
    fn parse(text: &'static str, offset: usize) -> Option<Self> {
        let mut words = text.split(' ');
        let (name, kind, unit) = (words.next()?, words.next()?, words.next());
        let (kind, is_extension) = kind.strip_prefix('+').map_or((kind, false), |kind| (kind, true));
        let (scalar, array) = match kind.split_once('[') {
            Some((scalar, length)) => (scalar, Some(length.strip_suffix(']')?.parse().ok()?)),
            None => (kind, None),
        };
        let (_, scalar) = Scalar::NAMES.into_iter().find(|(name, _)| *name == scalar)?;
        Some(Self { name, scalar, array, unit, is_extension, offset })
    }

    /// Number of bytes in the payload.
    pub fn size(&self) -> usize {
        self.scalar.size() * usize::from(self.array.unwrap_or(1))
    }

    /// Whether it is text: characters.
    pub fn is_text(&self) -> bool {
        self.scalar == Scalar::Char
    }
}

/// The type of a field's elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    Char,
    U8,
    U16,
    U32,
    U64,
    I8,
    I16,
    I32,
    I64,
    F32,
    F64,
}

impl Scalar {
    const NAMES: [(&'static str, Self); 11] = [
        ("char", Self::Char),
        ("u8", Self::U8),
        ("u16", Self::U16),
        ("u32", Self::U32),
        ("u64", Self::U64),
        ("i8", Self::I8),
        ("i16", Self::I16),
        ("i32", Self::I32),
        ("i64", Self::I64),
        ("f32", Self::F32),
        ("f64", Self::F64),
    ];

    /// The type in the XML and in C; text is an array of `char`.
    pub(crate) const fn c_type(self) -> &'static str {
        match self {
            Self::Char => "char",
            Self::U8 => "uint8_t",
            Self::U16 => "uint16_t",
            Self::U32 => "uint32_t",
            Self::U64 => "uint64_t",
            Self::I8 => "int8_t",
            Self::I16 => "int16_t",
            Self::I32 => "int32_t",
            Self::I64 => "int64_t",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Number of bytes.
    pub const fn size(self) -> usize {
        match self {
            Self::Char | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::framing::checksum;

    /// CRC_EXTRA as the MAVLink guide computes it: over name and type in C of the fields that are no extensions, in the order of the wire.
    fn computed_seed(message: &MessageDefinition) -> u8 {
        let mut text = format!("{} ", message.name).into_bytes();
        for field in message.fields.iter().filter(|field| !field.is_extension) {
            let kind = field.scalar.c_type();
            text.extend(format!("{kind} {} ", field.name).into_bytes());
            text.extend(field.array);
        }
        let (last, rest) = text.split_last().unwrap();
        let [low, high] = checksum(rest, *last).to_le_bytes();
        low ^ high
    }

    #[test]
    fn seeds_and_lengths_are_those_of_the_fields() {
        assert_eq!(definitions().len(), TABLE.lines().count(), "a line that does not parse is left out");
        assert!(definitions().is_sorted_by(|one, next| one.id < next.id));
        for message in definitions() {
            assert_eq!(message.layout.crc_extra, computed_seed(message), "{}", message.name);
            let size = |extensions: bool| {
                let counted = message.fields.iter().filter(|field| extensions || !field.is_extension);
                counted.map(FieldDefinition::size).sum::<usize>()
            };
            assert_eq!(usize::from(message.layout.max_len_v1), size(false), "{}", message.name);
            assert_eq!(usize::from(message.layout.max_len_v2), size(true), "{}", message.name);
            assert!(message.fields.is_sorted_by_key(|field| field.is_extension), "{}", message.name);
        }
    }

    #[test]
    fn a_definition_has_the_fields_of_its_message() {
        let status = definitions().iter().find(|message| message.id == 1).unwrap();
        assert_eq!(status.name, "SYS_STATUS");
        let battery = status.fields.iter().find(|field| field.name == "voltage_battery").unwrap();
        assert_eq!((battery.unit, battery.scalar, battery.offset), (Some("mV"), Scalar::U16, 14));
    }
}
