//! Messages of the services that ground stations expect of a vehicle: plans, files, logs, modes, metadata.
//!
//! Read and written field by field in wire order (largest type first, extensions last). Source: MAVLink common.xml.

use super::ids;
use super::payload::{Payload, PayloadReader};
use crate::message::{
    AvailableMode, ComponentMetadata, FileTransfer, ItemPosition, LogMessage, Message, MetadataForm, MissionCurrent,
    MissionItem, PlanContent, PlanMessage, plan,
};

/// Bytes of a file in one FILE_TRANSFER_PROTOCOL.
pub(crate) const FILE_DATA: usize = 239;
/// Bytes of a log in one LOG_DATA.
const LOG_DATA: usize = 90;
const MODE_NAME: usize = 35;
const URI: usize = 100;

/// MISSION_REQUEST_LIST, MISSION_CLEAR_ALL: a target and the plan.
pub(super) fn plan_of_target(payload: &[u8], content: PlanContent) -> Message {
    let mut reader = PayloadReader::new(payload);
    let target = reader.address();
    Message::Plan(PlanMessage { target, plan: reader.number::<u8>(), content })
}

/// MISSION_REQUEST, MISSION_REQUEST_INT, MISSION_COUNT: a number, a target and the plan.
pub(super) fn plan_with_number(payload: &[u8], content: impl FnOnce(u16) -> PlanContent) -> Message {
    let mut reader = PayloadReader::new(payload);
    let content = content(reader.number::<u16>());
    let target = reader.address();
    Message::Plan(PlanMessage { target, plan: reader.number::<u8>(), content })
}

/// MISSION_REQUEST_PARTIAL_LIST, MISSION_WRITE_PARTIAL_LIST.
pub(super) fn plan_with_range(payload: &[u8], content: impl FnOnce(i16, i16) -> PlanContent) -> Message {
    let mut reader = PayloadReader::new(payload);
    let first = reader.number::<i16>();
    let content = content(first, reader.number::<i16>());
    let target = reader.address();
    Message::Plan(PlanMessage { target, plan: reader.number::<u8>(), content })
}

pub(super) fn mission_set_current(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let sequence = reader.number::<u16>();
    Message::Plan(PlanMessage {
        target: reader.address(),
        plan: plan::MISSION,
        content: PlanContent::SetCurrent { sequence },
    })
}

pub(super) fn mission_ack(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let target = reader.address();
    let result = reader.number::<u8>();
    Message::Plan(PlanMessage { target, plan: reader.number::<u8>(), content: PlanContent::Ack { result } })
}

pub(super) fn write_plan(message: &PlanMessage) -> Payload {
    let PlanMessage { target, plan, content } = *message;
    let numbered = |id: u32, number: u16| Payload::new(id).number::<u16>(number).address(target).number::<u8>(plan);
    let ranged = |id: u32, first: i16, last: i16| {
        Payload::new(id).number::<i16>(first).number::<i16>(last).address(target).number::<u8>(plan)
    };
    match content {
        PlanContent::RequestList => Payload::new(ids::MISSION_REQUEST_LIST).address(target).number::<u8>(plan),
        PlanContent::ClearAll => Payload::new(ids::MISSION_CLEAR_ALL).address(target).number::<u8>(plan),
        PlanContent::RequestPartialList { first, last } => ranged(ids::MISSION_REQUEST_PARTIAL_LIST, first, last),
        PlanContent::WritePartialList { first, last } => ranged(ids::MISSION_WRITE_PARTIAL_LIST, first, last),
        PlanContent::Request { sequence } => numbered(ids::MISSION_REQUEST, sequence),
        PlanContent::RequestInt { sequence } => numbered(ids::MISSION_REQUEST_INT, sequence),
        PlanContent::Count { items } => numbered(ids::MISSION_COUNT, items),
        PlanContent::SetCurrent { sequence } => {
            Payload::new(ids::MISSION_SET_CURRENT).number::<u16>(sequence).address(target)
        }
        PlanContent::Ack { result } => {
            Payload::new(ids::MISSION_ACK).address(target).number::<u8>(result).number::<u8>(plan)
        }
    }
}

pub(super) fn mission_item(payload: &[u8]) -> Message {
    read_item(payload, |reader| {
        let [x, y] = reader.f32s();
        ItemPosition::Float { x, y }
    })
}

pub(super) fn mission_item_int(payload: &[u8]) -> Message {
    read_item(payload, |reader| ItemPosition::Integer { x: reader.number::<i32>(), y: reader.number::<i32>() })
}

/// The layout of both messages, which differ in the position alone.
fn read_item(payload: &[u8], position: impl FnOnce(&mut PayloadReader<'_>) -> ItemPosition) -> Message {
    let mut reader = PayloadReader::new(payload);
    let params: [f32; 4] = reader.f32s();
    let position = position(&mut reader);
    let z = reader.number::<f32>();
    let (sequence, command) = (reader.number::<u16>(), reader.number::<u16>());
    let target = reader.address();
    let [frame, current, autocontinue, plan] = reader.bytes();
    Message::MissionItem(MissionItem {
        target,
        plan,
        sequence,
        frame,
        command,
        current,
        autocontinue,
        params,
        position,
        z,
    })
}

pub(super) fn write_item(item: &MissionItem) -> Payload {
    let head = |id: u32| Payload::new(id).f32s(&item.params);
    let payload = match item.position {
        ItemPosition::Float { x, y } => head(ids::MISSION_ITEM).f32s(&[x, y]),
        ItemPosition::Integer { x, y } => head(ids::MISSION_ITEM_INT).number::<i32>(x).number::<i32>(y),
    };
    payload.number::<f32>(item.z).number::<u16>(item.sequence).number::<u16>(item.command).address(item.target).raw(&[
        item.frame,
        item.current,
        item.autocontinue,
        item.plan,
    ])
}

pub(super) fn mission_item_reached(payload: &[u8]) -> Message {
    Message::MissionItemReached { sequence: PayloadReader::new(payload).number::<u16>() }
}

pub(super) fn write_item_reached(sequence: u16) -> Payload {
    Payload::new(ids::MISSION_ITEM_REACHED).number::<u16>(sequence)
}

pub(super) fn mission_current(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let sequence = reader.number::<u16>();
    let items = reader.number::<u16>();
    Message::MissionCurrent(MissionCurrent { sequence, items, state: reader.number::<u8>() })
}

pub(super) fn write_mission_current(current: MissionCurrent) -> Payload {
    Payload::new(ids::MISSION_CURRENT)
        .number::<u16>(current.sequence)
        .number::<u16>(current.items)
        .number::<u8>(current.state)
}

pub(super) fn file_transfer(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let _network = reader.number::<u8>();
    let target = reader.address();
    let sequence = reader.number::<u16>();
    let [session, opcode, size, requested_opcode, burst_complete, _padding] = reader.bytes();
    let offset = reader.number::<u32>();
    let data = without_zeros(&reader.bytes::<FILE_DATA>());
    Message::FileTransfer(FileTransfer {
        target,
        sequence,
        session,
        opcode,
        size,
        requested_opcode,
        burst_complete,
        offset,
        data,
    })
}

pub(super) fn write_file_transfer(message: &FileTransfer) -> Payload {
    let (network, padding) = (0, 0);
    let held = message.data.len().min(FILE_DATA);
    Payload::new(ids::FILE_TRANSFER_PROTOCOL)
        .number::<u8>(network)
        .address(message.target)
        .number::<u16>(message.sequence)
        .raw(&[
            message.session,
            message.opcode,
            message.size,
            message.requested_opcode,
            message.burst_complete,
            padding,
        ])
        .number::<u32>(message.offset)
        .raw(&message.data[..held])
}

pub(super) fn log_request_list(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let (first, last) = (reader.number::<u16>(), reader.number::<u16>());
    Message::Log(LogMessage::RequestList { target: reader.address(), first, last })
}

pub(super) fn log_entry(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    Message::Log(LogMessage::Entry {
        unix_s: reader.number::<u32>(),
        bytes: reader.number::<u32>(),
        id: reader.number::<u16>(),
        logs: reader.number::<u16>(),
        last: reader.number::<u16>(),
    })
}

pub(super) fn log_request_data(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let (offset, bytes) = (reader.number::<u32>(), reader.number::<u32>());
    let id = reader.number::<u16>();
    Message::Log(LogMessage::RequestData { target: reader.address(), id, offset, bytes })
}

pub(super) fn log_data(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let offset = reader.number::<u32>();
    let id = reader.number::<u16>();
    let held = usize::from(reader.number::<u8>()).min(LOG_DATA);
    let bytes = reader.bytes::<LOG_DATA>();
    Message::Log(LogMessage::Data { id, offset, data: bytes[..held].to_vec() })
}

pub(super) fn write_log(message: &LogMessage) -> Payload {
    match message {
        LogMessage::RequestList { target, first, last } => {
            Payload::new(ids::LOG_REQUEST_LIST).number::<u16>(*first).number::<u16>(*last).address(*target)
        }
        LogMessage::Entry { unix_s, bytes, id, logs, last } => Payload::new(ids::LOG_ENTRY)
            .number::<u32>(*unix_s)
            .number::<u32>(*bytes)
            .number::<u16>(*id)
            .number::<u16>(*logs)
            .number::<u16>(*last),
        LogMessage::RequestData { target, id, offset, bytes } => Payload::new(ids::LOG_REQUEST_DATA)
            .number::<u32>(*offset)
            .number::<u32>(*bytes)
            .number::<u16>(*id)
            .address(*target),
        LogMessage::Data { id, offset, data } => {
            let held = data.len().min(LOG_DATA);
            let payload = Payload::new(ids::LOG_DATA).number::<u32>(*offset).number::<u16>(*id);
            payload.number::<u8>(held as u8).raw(&data[..held])
        }
    }
}

pub(super) fn available_mode(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let (custom_mode, properties) = (reader.number::<u32>(), reader.number::<u32>());
    let [modes, index, standard_mode] = reader.bytes();
    Message::AvailableMode(AvailableMode {
        custom_mode,
        properties,
        modes,
        index,
        standard_mode,
        name: reader.text::<MODE_NAME>(),
    })
}

/// Its name must end with a zero.
pub(super) fn write_available_mode(mode: &AvailableMode) -> Payload {
    Payload::new(ids::AVAILABLE_MODES)
        .number::<u32>(mode.custom_mode)
        .number::<u32>(mode.properties)
        .raw(&[mode.modes, mode.index, mode.standard_mode])
        .text::<{ MODE_NAME - 1 }>(&mode.name)
}

pub(super) fn component_metadata(payload: &[u8], form: MetadataForm) -> Message {
    let mut reader = PayloadReader::new(payload);
    let boot_millis = reader.number::<u32>();
    let file_crc = reader.number::<u32>();
    if form == MetadataForm::Deprecated {
        let _peripherals_crc = reader.number::<u32>();
    }
    Message::ComponentMetadata(ComponentMetadata { form, boot_millis, file_crc, uri: reader.text::<URI>() })
}

/// Its address must end with a zero. There are no peripherals.
pub(super) fn write_component_metadata(message: &ComponentMetadata) -> Payload {
    let ComponentMetadata { form, boot_millis, file_crc, uri } = message;
    let payload = match form {
        MetadataForm::Current => {
            Payload::new(ids::COMPONENT_METADATA).number::<u32>(*boot_millis).number::<u32>(*file_crc)
        }
        MetadataForm::Deprecated => Payload::new(ids::COMPONENT_INFORMATION)
            .number::<u32>(*boot_millis)
            .number::<u32>(*file_crc)
            .number::<u32>(0),
    };
    payload.text::<{ URI - 1 }>(uri)
}

fn without_zeros(bytes: &[u8]) -> Vec<u8> {
    let held = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    bytes[..held].to_vec()
}
