//! Messages of the services: heartbeat, time, commands, parameters, status texts, descriptions of a component, numbers to plot.
//!
//! Most have enumerations and are read field by field in wire order (largest type first, extensions last). Source:
//! MAVLink minimal.xml, standard.xml and common.xml.

use mavlink::dialects::common::{SYSTEM_TIME_DATA, TIMESYNC_DATA};
use posebridge_telemetry::{Address, ChannelName};

use super::ids;
use super::payload::{Decoded, Payload, PayloadReader, decode_generated, micros64, millis32, specific_address};
use crate::message::{
    AutopilotVersion, CommandAck, CommandInt, CommandLong, ComponentInformation, FloatArray, Heartbeat, Message,
    MessageInterval, NamedValue, ProtocolVersion, SetMessageInterval, TextPart, TimeSync, WireStamp,
};

/// MAVLink's own minor version, in every heartbeat.
const MAVLINK_VERSION: u8 = 3;
/// MAV_PARAM_TYPE_REAL32.
pub(super) const PARAM_TYPE_REAL32: u8 = 9;
/// The values of MAV_PARAM_TYPE that fit into the slot and are whole numbers.
mod integer_type {
    pub(super) const UINT8: u8 = 1;
    pub(super) const INT8: u8 = 2;
    pub(super) const UINT16: u8 = 3;
    pub(super) const INT16: u8 = 4;
    pub(super) const UINT32: u8 = 5;
    pub(super) const INT32: u8 = 6;
}
const PARAM_NAME: usize = 16;
/// The name under which a vehicle tells the checksum over its parameters: no parameter.
pub(crate) const PARAM_HASH_NAME: &str = "_HASH_CHECK";
/// Length of the names in NAMED_VALUE_FLOAT and DEBUG_FLOAT_ARRAY.
pub(super) const NAME_BYTES: usize = 10;
pub(super) const STATUS_TEXT: usize = 50;

pub(super) fn heartbeat(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let _custom_mode = reader.number::<u32>();
    Message::Heartbeat(Heartbeat {
        vehicle_type: reader.number::<u8>(),
        autopilot: reader.number::<u8>(),
        base_mode: reader.number::<u8>(),
        system_status: reader.number::<u8>(),
    })
}

pub(super) fn write_heartbeat(heartbeat: Heartbeat) -> Payload {
    Payload::new(ids::HEARTBEAT)
        .number::<u32>(0)
        .number::<u8>(heartbeat.vehicle_type)
        .number::<u8>(heartbeat.autopilot)
        .number::<u8>(heartbeat.base_mode)
        .number::<u8>(heartbeat.system_status)
        .number::<u8>(MAVLINK_VERSION)
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

pub(super) fn write_time_sync(sync: &TimeSync) -> Payload {
    let target = sync.target.unwrap_or_default();
    let data = TIMESYNC_DATA {
        tc1: sync.answer_nanos,
        ts1: sync.request_nanos,
        target_system: target.system.0,
        target_component: target.component.0,
    };
    Payload::encode(&data)
}

pub(super) fn command_long(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let params: [f32; 7] = reader.f32s();
    let command = reader.number::<u16>();
    let target = reader.address();
    let command = CommandLong { target, command, params };
    SetMessageInterval::from_command(&command).map_or(Message::Command(command), Message::SetMessageInterval)
}

/// The command that took its place, to any component of the system. The mode is laid out as PX4's: reserved (2 bytes), main and sub mode.
pub(super) fn set_mode(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let [_, _, main, sub] = reader.number::<u32>().to_le_bytes();
    let [system, flags] = reader.bytes();
    let params = [f32::from(flags), f32::from(main), f32::from(sub), 0.0, 0.0, 0.0, 0.0];
    Message::Command(CommandLong { target: Address::new(system, 0), command: ids::COMMAND_SET_MODE, params })
}

pub(super) fn command_int(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let params: [f32; 4] = reader.f32s();
    let (x, y, z) = (reader.number::<i32>(), reader.number::<i32>(), reader.number::<f32>());
    let command = reader.number::<u16>();
    let target = reader.address();
    Message::CommandInt(CommandInt { target, frame: reader.number::<u8>(), command, params, x, y, z })
}

pub(super) fn write_command_int(command: &CommandInt) -> Payload {
    Payload::new(ids::COMMAND_INT)
        .f32s(&command.params)
        .number::<i32>(command.x)
        .number::<i32>(command.y)
        .number::<f32>(command.z)
        .number::<u16>(command.command)
        .address(command.target)
        .number::<u8>(command.frame)
}

pub(super) fn write_command(command: &CommandLong) -> Payload {
    Payload::new(ids::COMMAND_LONG).f32s(&command.params).number::<u16>(command.command).address(command.target)
}

pub(super) fn write_interval(request: &SetMessageInterval) -> Payload {
    write_command(&request.to_command())
}

pub(super) fn command_ack(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let command = reader.number::<u16>();
    let result = reader.number::<u8>();
    let _progress = reader.number::<u8>();
    let _detail = reader.number::<u32>();
    Message::CommandAck(CommandAck { command, result, target: specific_address(reader.address()) })
}

pub(super) fn write_ack(ack: CommandAck) -> Payload {
    let (progress, detail) = (0, 0);
    Payload::new(ids::COMMAND_ACK)
        .number::<u16>(ack.command)
        .number::<u8>(ack.result)
        .number::<u8>(progress)
        .number::<u32>(detail)
        .address(ack.target.unwrap_or_default())
}

pub(super) fn status_text(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    Message::StatusText {
        severity: reader.number::<u8>(),
        text: reader.text::<STATUS_TEXT>(),
        part: TextPart { text_id: reader.number::<u16>(), index: reader.number::<u8>() },
    }
}

pub(super) fn param_request_list(payload: &[u8]) -> Message {
    Message::ParamRequestList { target: PayloadReader::new(payload).address() }
}

pub(super) fn param_request_read(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let index = reader.number::<i16>();
    let target = reader.address();
    Message::ParamRequestRead { target, name: reader.text::<PARAM_NAME>(), index }
}

pub(super) fn param_set(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let slot = reader.number::<f32>();
    let target = reader.address();
    let name = reader.text::<PARAM_NAME>();
    let kind = reader.number::<u8>();
    match param_number(slot, kind) {
        Some(value) => Message::ParamSet { target, name, value },
        None => Message::ParamSetUnsupported { target, name, kind },
    }
}

/// The number in the slot of a parameter, bytewise: the slot of an integer holds its bits, which as a float would be a
/// wrong number. `None` for types that do not fit into 32 bits.
fn param_number(slot: f32, kind: u8) -> Option<f32> {
    let bits = slot.to_bits();
    Some(match kind {
        PARAM_TYPE_REAL32 => slot,
        integer_type::UINT8 => f32::from(bits as u8),
        integer_type::INT8 => f32::from(bits as u8 as i8),
        integer_type::UINT16 => f32::from(bits as u16),
        integer_type::INT16 => f32::from(bits as u16 as i16),
        integer_type::UINT32 => bits as f32,
        integer_type::INT32 => bits as i32 as f32,
        _ => return None,
    })
}

/// A foreign autopilot has integer parameters, which are not used.
pub(super) fn param_value(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    let value = reader.number::<f32>();
    let count = reader.number::<u16>();
    let index = reader.number::<u16>();
    let name = reader.text::<PARAM_NAME>();
    match reader.number::<u8>() {
        PARAM_TYPE_REAL32 => Some(Message::ParamValue { name, value, count, index }),
        integer_type::UINT32 if name == PARAM_HASH_NAME => Some(Message::ParamHash { hash: value.to_bits(), count }),
        _ => None,
    }
}

/// The index of a value that is none of the list.
const NO_INDEX: u16 = u16::MAX;

pub(super) fn write_param_hash(hash: u32, count: u16) -> Payload {
    let writer = Payload::new(ids::PARAM_VALUE).number::<u32>(hash).number::<u16>(count).number::<u16>(NO_INDEX);
    writer.text::<PARAM_NAME>(PARAM_HASH_NAME).number::<u8>(integer_type::UINT32)
}

pub(super) fn write_system_time(unix_micros: u64, since_boot: WireStamp) -> Payload {
    let data = SYSTEM_TIME_DATA { time_unix_usec: unix_micros, time_boot_ms: millis32(since_boot) };
    Payload::encode(&data)
}

pub(super) fn write_status_text(severity: u8, text: &str, part: TextPart) -> Payload {
    let writer = Payload::new(ids::STATUSTEXT).number::<u8>(severity).text::<STATUS_TEXT>(text);
    writer.number::<u16>(part.text_id).number::<u8>(part.index)
}

pub(super) fn write_param_request_list(target: Address) -> Payload {
    Payload::new(ids::PARAM_REQUEST_LIST).address(target)
}

pub(super) fn write_param_request_read(target: Address, name: &str, index: i16) -> Payload {
    Payload::new(ids::PARAM_REQUEST_READ).number::<i16>(index).address(target).text::<PARAM_NAME>(name)
}

pub(super) fn write_param_set(target: Address, name: &str, value: f32, kind: u8) -> Payload {
    Payload::new(ids::PARAM_SET).number::<f32>(value).address(target).text::<PARAM_NAME>(name).number::<u8>(kind)
}

pub(super) fn write_param_value(name: &str, value: f32, count: u16, index: u16) -> Payload {
    let writer = Payload::new(ids::PARAM_VALUE).number::<f32>(value).number::<u16>(count).number::<u16>(index);
    writer.text::<PARAM_NAME>(name).number::<u8>(PARAM_TYPE_REAL32)
}

/// Length of DEBUG_FLOAT_ARRAY.data.
const ARRAY: usize = 58;
/// Length of COMPONENT_INFORMATION_BASIC's names, a terminator included.
const LONG_NAME: usize = 32;
/// Length of its versions, a terminator included.
const SHORT_NAME: usize = 24;

pub(super) fn autopilot_version(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let capabilities = reader.number::<u64>();
    let _uid = reader.number::<u64>();
    Message::AutopilotVersion(AutopilotVersion { capabilities, software: reader.number::<u32>().to_be_bytes() })
}

pub(super) fn write_autopilot_version(message: AutopilotVersion) -> Payload {
    let no_uid = 0;
    Payload::new(ids::AUTOPILOT_VERSION)
        .number::<u64>(message.capabilities)
        .number::<u64>(no_uid)
        .number::<u32>(u32::from_be_bytes(message.software))
}

pub(super) fn protocol_version(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    Message::ProtocolVersion(ProtocolVersion {
        version: reader.number::<u16>(),
        min_version: reader.number::<u16>(),
        max_version: reader.number::<u16>(),
    })
}

pub(super) fn write_protocol_version(message: ProtocolVersion) -> Payload {
    Payload::new(ids::PROTOCOL_VERSION)
        .number::<u16>(message.version)
        .number::<u16>(message.min_version)
        .number::<u16>(message.max_version)
}

pub(super) fn component_information(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let capabilities = reader.number::<u64>();
    let stamp = WireStamp::Millis32(reader.number::<u32>());
    let _manufactured = reader.number::<u32>();
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

/// Its texts must end with a zero, so each is one byte shorter than its field.
pub(super) fn write_component_information(message: &ComponentInformation) -> Payload {
    let unknown_date = 0;
    Payload::new(ids::COMPONENT_INFORMATION_BASIC)
        .number::<u64>(message.capabilities)
        .number::<u32>(millis32(message.stamp))
        .number::<u32>(unknown_date)
        .text::<{ LONG_NAME - 1 }>(&message.vendor)
        .number::<u8>(0)
        .text::<{ LONG_NAME - 1 }>(&message.model)
        .number::<u8>(0)
        .text::<{ SHORT_NAME - 1 }>(&message.software_version)
}

pub(super) fn message_interval(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let interval_micros = reader.number::<i32>();
    Message::MessageInterval(MessageInterval { message_id: reader.number::<u16>(), interval_micros })
}

pub(super) fn write_named_value(message: &NamedValue) -> Payload {
    Payload::new(ids::NAMED_VALUE_FLOAT)
        .number::<u32>(millis32(message.stamp))
        .number::<f32>(message.value)
        .text::<NAME_BYTES>(message.name.as_str())
}

pub(super) fn float_array(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    let id = reader.number::<u16>();
    let name = ChannelName::from_bytes(&reader.bytes::<NAME_BYTES>());
    let mut values = reader.f32s::<ARRAY>().to_vec();
    while values.last().is_some_and(|value| value.to_bits() == 0) {
        values.pop();
    }
    Message::FloatArray(FloatArray { stamp, name, id, values })
}

pub(super) fn write_float_array(message: &FloatArray) -> Payload {
    let held = message.values.len().min(ARRAY);
    Payload::new(ids::DEBUG_FLOAT_ARRAY)
        .number::<u64>(micros64(message.stamp))
        .number::<u16>(message.id)
        .text::<NAME_BYTES>(message.name.as_str())
        .f32s(&message.values[..held])
}

pub(super) fn write_message_interval(message: MessageInterval) -> Payload {
    Payload::new(ids::MESSAGE_INTERVAL).number::<i32>(message.interval_micros).number::<u16>(message.message_id)
}
