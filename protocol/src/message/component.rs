//! The description of a component, and numbers that a ground station plots.

use posebridge_telemetry::ChannelName;

use super::stamp::WireStamp;

/// AUTOPILOT_VERSION (148), the parts that a component without hardware of its own has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AutopilotVersion {
    /// MAV_PROTOCOL_CAPABILITY bits.
    pub capabilities: u64,
    /// Major, minor and patch number, and FIRMWARE_VERSION_TYPE (0 development, 255 release).
    pub software: [u8; 4],
}

/// PROTOCOL_VERSION (300), in hundredths: MAVLink 2 is 200.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProtocolVersion {
    /// What is spoken.
    pub version: u16,
    /// The oldest that is understood.
    pub min_version: u16,
    /// The newest that is understood.
    pub max_version: u16,
}

/// COMPONENT_INFORMATION_BASIC (396).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComponentInformation {
    /// MAV_PROTOCOL_CAPABILITY bits.
    pub capabilities: u64,
    /// Time since the sender's boot.
    pub stamp: WireStamp,
    /// At most 31 bytes.
    pub vendor: String,
    /// At most 31 bytes.
    pub model: String,
    /// At most 23 bytes, as major.minor.patch.
    pub software_version: String,
}

/// MESSAGE_INTERVAL (244).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInterval {
    /// The message; the wire has room for 16 bits of its id.
    pub message_id: u16,
    /// Microseconds between two of them; -1 when it is not sent, 0 when the sender has no such message.
    pub interval_micros: i32,
}

/// NAMED_VALUE_FLOAT (251) that is no temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NamedValue {
    /// Time since the sender's boot.
    pub stamp: WireStamp,
    /// At most ten bytes on the wire.
    pub name: ChannelName,
    /// The number, in whatever unit its name stands for.
    pub value: f32,
}

/// DEBUG_FLOAT_ARRAY (350).
#[derive(Clone, Debug, PartialEq)]
pub struct FloatArray {
    /// Time since the sender's boot.
    pub stamp: WireStamp,
    /// At most ten bytes on the wire.
    pub name: ChannelName,
    /// Distinguishes arrays of one sender.
    pub id: u16,
    /// At most 58 numbers; zeros at the end are not distinguished from none.
    pub values: Vec<f32>,
}

/// Which part of a text a STATUSTEXT is. The default is the whole of it.
///
/// Source: common.xml, STATUSTEXT (extension fields id and chunk_seq).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TextPart {
    /// The text that it is a part of; 0 for a text of one part.
    pub text_id: u16,
    /// Which of its parts, from 0.
    pub index: u8,
}
