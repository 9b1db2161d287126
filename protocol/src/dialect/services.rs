//! Messages of the services: heartbeat, time, commands, parameters, status texts.
//!
//! Most have enumerations and are read field by field in wire order (largest type first, extensions last). Source:
//! MAVLink minimal.xml, standard.xml and common.xml.

use mavlink::dialects::common::{PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, SYSTEM_TIME_DATA, TIMESYNC_DATA};
use posebridge_telemetry::Address;

use super::error::Decoded;
use super::ids;
use super::ids::COMMAND_SET_MESSAGE_INTERVAL;
use super::payload::{
    Payload, PayloadReader, PayloadWriter, decode_generated, millis32, specific_address, text_from, text_to,
};
use crate::framing::WireVersion;
use crate::message::{
    CommandAck, CommandInt, CommandLong, Heartbeat, Message, STOP_INTERVAL, SetMessageInterval, TextPart, TimeSync,
    WireStamp,
};

/// MAVLink's own minor version, in every heartbeat.
const MAVLINK_VERSION: u8 = 3;
/// MAV_PARAM_TYPE_REAL32.
const PARAM_TYPE_REAL32: u8 = 9;
/// The values of MAV_PARAM_TYPE that fit into the slot and are whole numbers.
mod whole {
    pub(super) const UINT8: u8 = 1;
    pub(super) const INT8: u8 = 2;
    pub(super) const UINT16: u8 = 3;
    pub(super) const INT16: u8 = 4;
    pub(super) const UINT32: u8 = 5;
    pub(super) const INT32: u8 = 6;
}
/// Length of a parameter's name.
const PARAM_NAME: usize = 16;
/// Length of one chunk of text.
pub(super) const STATUS_TEXT: usize = 50;

pub(super) fn heartbeat(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let _custom_mode = reader.u32();
    Message::Heartbeat(Heartbeat {
        vehicle_type: reader.u8(),
        autopilot: reader.u8(),
        base_mode: reader.u8(),
        system_status: reader.u8(),
    })
}

fn write_heartbeat(version: WireVersion, heartbeat: Heartbeat) -> Payload {
    PayloadWriter::new()
        .u32(0)
        .u8(heartbeat.vehicle_type)
        .u8(heartbeat.autopilot)
        .u8(heartbeat.base_mode)
        .u8(heartbeat.system_status)
        .u8(MAVLINK_VERSION)
        .finish(version)
}

pub(super) fn system_time(payload: &[u8]) -> Decoded {
    let data: SYSTEM_TIME_DATA = decode_generated(payload)?;
    Ok(Some(Message::SystemTime {
        unix_micros: data.time_unix_usec,
        since_boot: WireStamp::Millis32(data.time_boot_ms),
    }))
}

pub(super) fn time_sync(payload: &[u8]) -> Decoded {
    let data: TIMESYNC_DATA = decode_generated(payload)?;
    Ok(Some(Message::TimeSync(TimeSync {
        answer_nanos: data.tc1,
        request_nanos: data.ts1,
        target: specific_address(Address::new(data.target_system, data.target_component)),
    })))
}

fn write_time_sync(version: WireVersion, sync: &TimeSync) -> Payload {
    let target = sync.target.unwrap_or_default();
    let data = TIMESYNC_DATA {
        tc1: sync.answer_nanos,
        ts1: sync.request_nanos,
        target_system: target.system.0,
        target_component: target.component.0,
    };
    Payload::encode(version, &data)
}

pub(super) fn command_long(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let params: [f32; 7] = reader.f32s();
    let command = reader.u16();
    let target = reader.address();
    let command = CommandLong { target, command, params };
    SetMessageInterval::from_command(&command).map_or(Message::Command(command), Message::SetMessageInterval)
}

pub(super) fn command_int(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let params: [f32; 4] = reader.f32s();
    let (x, y, z) = (reader.i32(), reader.i32(), reader.f32());
    let command = reader.u16();
    let target = reader.address();
    Message::CommandInt(CommandInt { target, frame: reader.u8(), command, params, x, y, z })
}

fn write_command_int(version: WireVersion, command: &CommandInt) -> Payload {
    let (current, autocontinue) = (0, 0);
    PayloadWriter::new()
        .f32s(&command.params)
        .i32(command.x)
        .i32(command.y)
        .f32(command.z)
        .u16(command.command)
        .address(command.target)
        .u8(command.frame)
        .u8(current)
        .u8(autocontinue)
        .finish(version)
}

fn write_command(version: WireVersion, command: &CommandLong) -> Payload {
    let confirmation = 0;
    PayloadWriter::new()
        .f32s(&command.params)
        .u16(command.command)
        .address(command.target)
        .u8(confirmation)
        .finish(version)
}

fn write_interval(version: WireVersion, wanted: &SetMessageInterval) -> Payload {
    let micros = wanted.interval.map_or(STOP_INTERVAL, |span| (span.as_nanos().max(0) as f64 * 1e-3) as f32);
    let mut params = [0.0; 7];
    params[0] = wanted.message_id as f32;
    params[1] = micros;
    let command = CommandLong { target: wanted.target, command: COMMAND_SET_MESSAGE_INTERVAL, params };
    write_command(version, &command)
}

pub(super) fn command_ack(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let command = reader.u16();
    let result = reader.u8();
    let _progress = reader.u8();
    let _detail = reader.u32();
    Message::CommandAck(CommandAck { command, result, target: specific_address(reader.address()) })
}

fn write_ack(version: WireVersion, ack: CommandAck) -> Payload {
    let (progress, detail) = (0, 0);
    PayloadWriter::new()
        .u16(ack.command)
        .u8(ack.result)
        .extensions()
        .u8(progress)
        .u32(detail)
        .address(ack.target.unwrap_or_default())
        .finish(version)
}

pub(super) fn status_text(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    Message::StatusText {
        severity: reader.u8(),
        text: reader.text::<STATUS_TEXT>(),
        part: TextPart { text_id: reader.u16(), index: reader.u8() },
    }
}

pub(super) fn param_request_list(payload: &[u8]) -> Decoded {
    let data: PARAM_REQUEST_LIST_DATA = decode_generated(payload)?;
    Ok(Some(Message::ParamRequestList { target: Address::new(data.target_system, data.target_component) }))
}

pub(super) fn param_request_read(payload: &[u8]) -> Decoded {
    let data: PARAM_REQUEST_READ_DATA = decode_generated(payload)?;
    Ok(Some(Message::ParamRequestRead {
        target: Address::new(data.target_system, data.target_component),
        name: text_from(&*data.param_id),
        index: data.param_index,
    }))
}

pub(super) fn param_set(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let slot = reader.f32();
    let target = reader.address();
    let name = reader.text::<PARAM_NAME>();
    let kind = reader.u8();
    match param_number(slot, kind) {
        Some(value) => Message::ParamSet { target, name, value },
        None => Message::ParamSetUnsupported { target, name, kind },
    }
}

/// The number in the slot of a parameter, bytewise: the slot of an integer holds its bits, and taking these for a float would be a
/// wrong number, not a rounded one. `None` for what does not fit into 32 bits.
fn param_number(slot: f32, kind: u8) -> Option<f32> {
    let bits = slot.to_bits();
    Some(match kind {
        PARAM_TYPE_REAL32 => slot,
        whole::UINT8 => f32::from(bits as u8),
        whole::INT8 => f32::from(bits as u8 as i8),
        whole::UINT16 => f32::from(bits as u16),
        whole::INT16 => f32::from(bits as u16 as i16),
        whole::UINT32 => bits as f32,
        whole::INT32 => bits as i32 as f32,
        _ => return None,
    })
}

/// A foreign autopilot has integers among its parameters; those are of no use here.
pub(super) fn param_value(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    let value = reader.f32();
    let count = reader.u16();
    let index = reader.u16();
    let name = reader.text::<PARAM_NAME>();
    let is_float = reader.u8() == PARAM_TYPE_REAL32;
    is_float.then_some(Message::ParamValue { name, value, count, index })
}

/// Writes the messages of this module; `None` for all others.
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "the encoder's match is the exhaustive one and sends only these here"
)]
pub(super) fn write(version: WireVersion, message: &Message) -> Option<(u32, Payload)> {
    let written = match message {
        Message::Heartbeat(heartbeat) => (ids::HEARTBEAT, write_heartbeat(version, *heartbeat)),
        Message::TimeSync(sync) => (ids::TIMESYNC, write_time_sync(version, sync)),
        Message::SetMessageInterval(wanted) => (ids::COMMAND_LONG, write_interval(version, wanted)),
        Message::Command(command) => (ids::COMMAND_LONG, write_command(version, command)),
        Message::CommandInt(command) => (ids::COMMAND_INT, write_command_int(version, command)),
        Message::CommandAck(ack) => (ids::COMMAND_ACK, write_ack(version, *ack)),
        Message::SystemTime { unix_micros, since_boot } => {
            let data = SYSTEM_TIME_DATA { time_unix_usec: *unix_micros, time_boot_ms: millis32(*since_boot) };
            (ids::SYSTEM_TIME, Payload::encode(version, &data))
        }
        Message::StatusText { severity, text, part } => {
            let writer = PayloadWriter::new().u8(*severity).text::<STATUS_TEXT>(text);
            let writer = writer.extensions().u16(part.text_id).u8(part.index);
            (ids::STATUSTEXT, writer.finish(version))
        }
        _ => return write_parameter(version, message),
    };
    Some(written)
}

#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "the encoder's match is the exhaustive one and sends only these here"
)]
fn write_parameter(version: WireVersion, message: &Message) -> Option<(u32, Payload)> {
    let written = match message {
        Message::ParamRequestList { target } => {
            let data = PARAM_REQUEST_LIST_DATA { target_system: target.system.0, target_component: target.component.0 };
            (ids::PARAM_REQUEST_LIST, Payload::encode(version, &data))
        }
        Message::ParamRequestRead { target, name, index } => {
            let data = PARAM_REQUEST_READ_DATA {
                param_index: *index,
                target_system: target.system.0,
                target_component: target.component.0,
                param_id: text_to::<PARAM_NAME>(name).into(),
            };
            (ids::PARAM_REQUEST_READ, Payload::encode(version, &data))
        }
        Message::ParamSetUnsupported { target, name, kind } => {
            let writer = PayloadWriter::new().f32(0.0).address(*target).text::<PARAM_NAME>(name).u8(*kind);
            (ids::PARAM_SET, writer.finish(version))
        }
        Message::ParamSet { target, name, value } => {
            let writer =
                PayloadWriter::new().f32(*value).address(*target).text::<PARAM_NAME>(name).u8(PARAM_TYPE_REAL32);
            (ids::PARAM_SET, writer.finish(version))
        }
        Message::ParamValue { name, value, count, index } => {
            let writer =
                PayloadWriter::new().f32(*value).u16(*count).u16(*index).text::<PARAM_NAME>(name).u8(PARAM_TYPE_REAL32);
            (ids::PARAM_VALUE, writer.finish(version))
        }
        _ => return None,
    };
    Some(written)
}
