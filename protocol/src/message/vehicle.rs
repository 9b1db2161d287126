//! What ground stations ask of a vehicle beside telemetry, parameters and commands: plans, files, logs, modes, metadata.

use posebridge_telemetry::Address;

/// The plans that a vehicle may hold: MAV_MISSION_TYPE of common.xml.
pub mod plan {
    pub const MISSION: u8 = 0;
    pub const FENCE: u8 = 1;
    pub const RALLY: u8 = 2;
    /// All of them; only in MISSION_CLEAR_ALL.
    pub const ALL: u8 = 255;
}

/// A message of the mission protocol about a plan, without the items themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanMessage {
    pub target: Address,
    /// One of [`plan`], or any other number.
    pub plan: u8,
    pub content: PlanContent,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanContent {
    /// MISSION_REQUEST_LIST (43).
    RequestList,
    /// MISSION_REQUEST_PARTIAL_LIST (37); a last index of -1 is the end.
    RequestPartialList { first: i16, last: i16 },
    /// MISSION_WRITE_PARTIAL_LIST (38).
    WritePartialList { first: i16, last: i16 },
    /// MISSION_REQUEST (40).
    Request { sequence: u16 },
    /// MISSION_REQUEST_INT (51).
    RequestInt { sequence: u16 },
    /// MISSION_SET_CURRENT (41), of the mission.
    SetCurrent { sequence: u16 },
    /// MISSION_COUNT (44): an answer, or the begin of an upload.
    Count { items: u16 },
    /// MISSION_CLEAR_ALL (45).
    ClearAll,
    /// MISSION_ACK (47), with a MAV_MISSION_RESULT.
    Ack { result: u8 },
}

/// MISSION_CURRENT (42).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissionCurrent {
    pub sequence: u16,
    /// 65535 without a mission.
    pub items: u16,
    /// MISSION_STATE.
    pub state: u8,
}

/// FILE_TRANSFER_PROTOCOL (110), a request or its answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileTransfer {
    pub target: Address,
    pub sequence: u16,
    pub session: u8,
    pub opcode: u8,
    /// The number of valid bytes in `data`, or the number of bytes that are wanted.
    pub size: u8,
    /// In an answer, the opcode of its request.
    pub requested_opcode: u8,
    /// 1 in the last answer to a burst.
    pub burst_complete: u8,
    pub offset: u32,
    /// At most 239 bytes, without the zeros at their end.
    pub data: Vec<u8>,
}

/// A message of the log protocol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LogMessage {
    /// LOG_REQUEST_LIST (117).
    RequestList { target: Address, first: u16, last: u16 },
    /// LOG_ENTRY (118).
    Entry { unix_s: u32, bytes: u32, id: u16, logs: u16, last: u16 },
    /// LOG_REQUEST_DATA (119).
    RequestData { target: Address, id: u16, offset: u32, bytes: u32 },
    /// LOG_DATA (120): at most 90 bytes, fewer at the end of a log.
    Data { id: u16, offset: u32, data: Vec<u8> },
}

/// AVAILABLE_MODES (435): one mode.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AvailableMode {
    pub custom_mode: u32,
    /// MAV_MODE_PROPERTY bits.
    pub properties: u32,
    pub modes: u8,
    /// From 1.
    pub index: u8,
    /// MAV_STANDARD_MODE; 0 for none of them.
    pub standard_mode: u8,
    /// At most 34 bytes.
    pub name: String,
}

/// Where the description of a component is: COMPONENT_METADATA (397), or the older COMPONENT_INFORMATION (395).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComponentMetadata {
    pub form: MetadataForm,
    /// Of the sender's clock, since its start.
    pub boot_millis: u32,
    pub file_crc: u32,
    /// At most 99 bytes.
    pub uri: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MetadataForm {
    Current,
    /// COMPONENT_INFORMATION, which newer ground stations ask for only if the other is not answered.
    Deprecated,
}
