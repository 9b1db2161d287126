//! Messages that describe a component, and numbers to be plotted.
//!
//! Written field by field in wire order (largest type first, extensions last). Source: MAVLink standard.xml and
//! common.xml.

use posebridge_telemetry::ChannelName;

use super::ids;
use super::payload::{Payload, PayloadReader, PayloadWriter, micros64, millis32};
use super::sensors::NAME_BYTES;
use crate::framing::WireVersion;
use crate::message::{
    AutopilotVersion, ComponentInformation, FloatArray, Message, MessageInterval, NamedValue, ProtocolVersion,
    WireStamp,
};

/// Length of DEBUG_FLOAT_ARRAY.data.
const ARRAY: usize = 58;
/// Length of COMPONENT_INFORMATION_BASIC's names, a terminator included.
const LONG_NAME: usize = 32;
/// Length of its versions, a terminator included.
const SHORT_NAME: usize = 24;
/// Bytes of AUTOPILOT_VERSION's uid, versions of other software and of the board, and of vendor and product, which nothing here has.
const NO_HARDWARE: [u8; 44] = [0; 44];

pub(super) fn autopilot_version(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let capabilities = reader.u64();
    let _uid = reader.u64();
    Message::AutopilotVersion(AutopilotVersion { capabilities, software: reader.u32().to_be_bytes() })
}

fn write_autopilot_version(version: WireVersion, said: AutopilotVersion) -> Payload {
    let no_uid = 0;
    let writer = PayloadWriter::new().u64(said.capabilities).u64(no_uid);
    let writer = writer.u32(u32::from_be_bytes(said.software));
    let writer = writer.raw(&NO_HARDWARE[..40]).extensions();
    writer.raw(&NO_HARDWARE[..18]).finish(version)
}

pub(super) fn protocol_version(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    Message::ProtocolVersion(ProtocolVersion {
        version: reader.u16(),
        min_version: reader.u16(),
        max_version: reader.u16(),
    })
}

fn write_protocol_version(version: WireVersion, said: ProtocolVersion) -> Payload {
    let no_hashes = [0; 16];
    PayloadWriter::new().u16(said.version).u16(said.min_version).u16(said.max_version).raw(&no_hashes).finish(version)
}

pub(super) fn component_information(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let capabilities = reader.u64();
    let stamp = WireStamp::Millis32(reader.u32());
    let _manufactured = reader.u32();
    let vendor = reader.text::<LONG_NAME>();
    let model = reader.text::<LONG_NAME>();
    Message::ComponentInformation(ComponentInformation {
        capabilities,
        stamp,
        vendor,
        model,
        software_version: reader.text::<SHORT_NAME>(),
    })
}

/// Its texts must end with a zero, so that one byte less than the field is taken of each.
fn write_component_information(version: WireVersion, said: &ComponentInformation) -> Payload {
    let unknown_date = 0;
    let no_hardware_version = [0; SHORT_NAME];
    let no_serial_number = [0; LONG_NAME];
    PayloadWriter::new()
        .u64(said.capabilities)
        .u32(millis32(said.stamp))
        .u32(unknown_date)
        .text::<{ LONG_NAME - 1 }>(&said.vendor)
        .u8(0)
        .text::<{ LONG_NAME - 1 }>(&said.model)
        .u8(0)
        .text::<{ SHORT_NAME - 1 }>(&said.software_version)
        .u8(0)
        .raw(&no_hardware_version)
        .raw(&no_serial_number)
        .finish(version)
}

pub(super) fn message_interval(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let interval_micros = reader.i32();
    Message::MessageInterval(MessageInterval { message_id: reader.u16(), interval_micros })
}

fn write_named_value(version: WireVersion, said: &NamedValue) -> Payload {
    PayloadWriter::new()
        .u32(millis32(said.stamp))
        .f32(said.value)
        .text::<NAME_BYTES>(said.name.as_str())
        .finish(version)
}

pub(super) fn float_array(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Micros64(reader.u64());
    let id = reader.u16();
    let name = ChannelName::from_bytes(&reader.bytes::<NAME_BYTES>());
    let mut values = reader.f32s::<ARRAY>().to_vec();
    while values.last().is_some_and(|value| value.to_bits() == 0) {
        values.pop();
    }
    Message::FloatArray(FloatArray { stamp, name, id, values })
}

fn write_float_array(version: WireVersion, said: &FloatArray) -> Payload {
    let held = said.values.len().min(ARRAY);
    PayloadWriter::new()
        .u64(micros64(said.stamp))
        .u16(said.id)
        .text::<NAME_BYTES>(said.name.as_str())
        .extensions()
        .f32s(&said.values[..held])
        .finish(version)
}

/// Writes the messages of this module; `None` for all others.
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "the encoder's match is the exhaustive one and sends only these here"
)]
pub(super) fn write(version: WireVersion, message: &Message) -> Option<(u32, Payload)> {
    let written = match message {
        Message::AutopilotVersion(said) => (ids::AUTOPILOT_VERSION, write_autopilot_version(version, *said)),
        Message::ProtocolVersion(said) => (ids::PROTOCOL_VERSION, write_protocol_version(version, *said)),
        Message::ComponentInformation(said) => {
            (ids::COMPONENT_INFORMATION_BASIC, write_component_information(version, said))
        }
        Message::MessageInterval(said) => {
            let writer = PayloadWriter::new().i32(said.interval_micros);
            let writer = writer.u16(said.message_id);
            (ids::MESSAGE_INTERVAL, writer.finish(version))
        }
        Message::NamedValue(said) => (ids::NAMED_VALUE_FLOAT, write_named_value(version, said)),
        Message::FloatArray(said) => (ids::DEBUG_FLOAT_ARRAY, write_float_array(version, said)),
        _ => return None,
    };
    Some(written)
}
