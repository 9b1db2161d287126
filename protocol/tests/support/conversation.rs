//! Any message of the conversation: who is there, what it is told to do, and what it says of itself.

use posebridge_protocol::message::{
    AutopilotVersion, CommandAck, CommandInt, CommandLong, ComponentInformation, FloatArray, Heartbeat, Message,
    MessageInterval, NamedValue, ProtocolVersion, SetMessageInterval, TextPart, TimeSync,
};
use posebridge_telemetry::{ChannelName, TimeDelta};
use proptest::prelude::*;

use crate::{address, stamp_millis, stamp64};

pub(crate) fn conversation() -> BoxedStrategy<Message> {
    let heartbeat = any::<[u8; 4]>().prop_map(|[kind, autopilot, mode, status]| {
        Message::Heartbeat(Heartbeat { vehicle_type: kind, autopilot, base_mode: mode, system_status: status })
    });
    let time = (any::<u64>(), stamp_millis())
        .prop_map(|(unix_micros, since_boot)| Message::SystemTime { unix_micros, since_boot });
    let sync =
        (any::<i64>(), any::<i64>(), prop::option::of(address())).prop_map(|(answer_nanos, request_nanos, target)| {
            Message::TimeSync(TimeSync { answer_nanos, request_nanos, target })
        });
    let interval =
        (address(), 0..1_u32 << 24, prop::option::of(0..1_i64 << 24)).prop_map(|(target, message_id, micros)| {
            Message::SetMessageInterval(SetMessageInterval {
                target,
                message_id,
                interval: micros.map(TimeDelta::from_micros),
            })
        });
    let ack = (any::<u16>(), any::<u8>(), prop::option::of(address()))
        .prop_map(|(command, result, target)| Message::CommandAck(CommandAck { command, result, target }));
    prop_oneof![heartbeat, time, sync, interval, commands(), ack, texts(), components()].boxed()
}

fn commands() -> impl Strategy<Value = Message> {
    // 511 with parameters that make no interval is a command like any other; with sensible ones it is an interval.
    let other_command = any::<u16>().prop_filter("an interval", |&command| command != 511);
    let command = (address(), other_command, prop::array::uniform7(-1e6_f32..1e6))
        .prop_map(|(target, command, params)| Message::Command(CommandLong { target, command, params }));
    let whole = (address(), any::<(u8, u16, i32, i32)>(), prop::array::uniform4(-1e6_f32..1e6)).prop_map(
        |(target, (frame, command, x, y), params)| {
            Message::CommandInt(CommandInt { target, frame, command, params, x, y, z: params[0] })
        },
    );
    prop_oneof![command, whole]
}

fn components() -> impl Strategy<Value = Message> {
    let version = any::<(u64, [u8; 4])>()
        .prop_map(|(capabilities, software)| Message::AutopilotVersion(AutopilotVersion { capabilities, software }));
    let protocol = any::<[u16; 3]>().prop_map(|[version, min_version, max_version]| {
        Message::ProtocolVersion(ProtocolVersion { version, min_version, max_version })
    });
    let names = (any::<u64>(), stamp_millis(), "[ -~]{0,31}", "[ -~]{0,31}", "[ -~]{0,23}");
    let information = names.prop_map(|(capabilities, stamp, vendor, model, software_version)| {
        Message::ComponentInformation(ComponentInformation { capabilities, stamp, vendor, model, software_version })
    });
    let interval = any::<(u16, i32)>().prop_map(|(message_id, interval_micros)| {
        Message::MessageInterval(MessageInterval { message_id, interval_micros })
    });
    let name = || "[a-s_]{0,10}".prop_map(|name| ChannelName::from_bytes(name.as_bytes()));
    let value = (stamp_millis(), name(), -1e6_f32..1e6)
        .prop_map(|(stamp, name, value)| Message::NamedValue(NamedValue { stamp, name, value }));
    // The last is not zero, or it could not be told from none.
    let values = prop::collection::vec(1.0_f32..1e6, 0..=58);
    let array = (stamp64(), name(), any::<u16>(), values)
        .prop_map(|(stamp, name, id, values)| Message::FloatArray(FloatArray { stamp, name, id, values }));
    prop_oneof![version, protocol, information, interval, value, array]
}

fn texts() -> impl Strategy<Value = Message> {
    let text = (any::<(u8, u16, u8)>(), "[ -~]{0,50}").prop_map(|((severity, text_id, index), text)| {
        Message::StatusText { severity, text, part: TextPart { text_id, index } }
    });
    let list = address().prop_map(|target| Message::ParamRequestList { target });
    let read = (address(), "[A-Z_]{0,16}", any::<i16>()).prop_map(|(target, name, index)| Message::ParamRequestRead {
        target,
        name,
        index,
    });
    let set = (address(), "[A-Z_]{0,16}", any::<i16>()).prop_map(|(target, name, value)| Message::ParamSet {
        target,
        name,
        value: f32::from(value),
    });
    // 7, 8 and 10 are types of 64 bits, the others are none.
    let kind = prop_oneof![Just(0_u8), 7..=8_u8, 10..=u8::MAX];
    let unsupported = (address(), "[A-Z_]{0,16}", kind).prop_map(|(target, name, kind)| Message::ParamSetUnsupported {
        target,
        name,
        kind,
    });
    let value = ("[A-Z_]{0,16}", any::<(i16, u16, u16)>())
        .prop_map(|(name, (value, count, index))| Message::ParamValue { name, value: f32::from(value), count, index });
    prop_oneof![text, list, read, set, unsupported, value]
}
