//! What ground stations ask of a vehicle beside telemetry, parameters and commands: plans, files, logs, modes, metadata.

use posebridge_telemetry::Address;

use super::commands::integer_unit;

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

/// An item of a plan, as it was sent: MISSION_ITEM (39) or MISSION_ITEM_INT (73).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissionItem {
    pub target: Address,
    /// One of [`plan`], or any other number.
    pub plan: u8,
    /// Its place in the plan, from 0.
    pub sequence: u16,
    /// MAV_FRAME of the position.
    pub frame: u8,
    /// MAV_CMD.
    pub command: u16,
    /// 1 for the item that is driven to.
    pub current: u8,
    /// 0 to pause after the item.
    pub autocontinue: u8,
    pub params: [f32; 4],
    pub position: ItemPosition,
    pub z: f32,
}

/// The fifth and sixth parameter of an item: metres or degrees, north or latitude first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ItemPosition {
    /// MISSION_ITEM: the unit itself.
    Float { x: f32, y: f32 },
    /// MISSION_ITEM_INT: metres times 10^4 or degrees times 10^7, as in COMMAND_INT.
    Integer { x: i32, y: i32 },
}

impl ItemPosition {
    /// In metres or degrees; NaN where there is none.
    pub fn coordinates(self, frame: u8) -> [f64; 2] {
        match self {
            Self::Float { x, y } => [x, y].map(f64::from),
            Self::Integer { x, y } => [x, y].map(|value| integer_coordinate(value, frame)),
        }
    }

    /// For MISSION_ITEM.
    #[must_use]
    pub fn to_float(self, frame: u8) -> Self {
        match self {
            Self::Float { .. } => self,
            Self::Integer { .. } => {
                let [x, y] = self.coordinates(frame).map(|value| value as f32);
                Self::Float { x, y }
            }
        }
    }

    /// For MISSION_ITEM_INT.
    #[must_use]
    pub fn to_integer(self, frame: u8) -> Self {
        match self {
            Self::Integer { .. } => self,
            Self::Float { .. } => {
                let scaled =
                    |value: f64| if value.is_nan() { i32::MAX } else { (value / integer_unit(frame)).round() as i32 };
                let [x, y] = self.coordinates(frame).map(scaled);
                Self::Integer { x, y }
            }
        }
    }
}

/// A coordinate of a message with integers, in metres or degrees. The largest number stands for NaN (MAVLink guide, "Mission Protocol").
pub(crate) fn integer_coordinate(value: i32, frame: u8) -> f64 {
    if value == i32::MAX { f64::NAN } else { f64::from(value) * integer_unit(frame) }
}

/// MAV_MISSION_RESULT of common.xml: the results that are sent here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum MissionResult {
    Accepted = 0,
    Error = 1,
    UnsupportedFrame = 2,
    Unsupported = 3,
    NoSpace = 4,
    InvalidParam1 = 6,
    InvalidParam2 = 7,
    InvalidParam3 = 8,
    InvalidParam4 = 9,
    InvalidParam5X = 10,
    InvalidParam6Y = 11,
    InvalidParam7 = 12,
    InvalidSequence = 13,
    Denied = 14,
    OperationCancelled = 15,
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
