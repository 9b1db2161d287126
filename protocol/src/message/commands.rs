//! Commands, their acknowledgements, and the intervals that they set.

use posebridge_telemetry::{Address, TimeDelta};

use crate::dialect::ids::{COMMAND_GET_MESSAGE_INTERVAL, COMMAND_REQUEST_MESSAGE, COMMAND_SET_MESSAGE_INTERVAL};

/// The largest message id: 24 bits, exact in a 32-bit float.
const LARGEST_ID: f32 = 16_777_215.0;

/// The interval of MAV_CMD_SET_MESSAGE_INTERVAL that stops a message (common.xml).
const STOP_INTERVAL: f32 = -1.0;

/// A request to send a message at an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetMessageInterval {
    pub target: Address,
    pub message_id: u32,
    /// The interval; `None` stops the message, zero asks for the sender's default.
    pub interval: Option<TimeDelta>,
}

impl SetMessageInterval {
    /// `None` for another command, or if its parameters are no message id or no interval. The only valid negative
    /// interval is -1.
    pub fn from_command(command: &CommandLong) -> Option<Self> {
        let [_, interval_micros, ..] = command.params;
        let message_id = command.named_message()?;
        let is_request = command.command == COMMAND_SET_MESSAGE_INTERVAL;
        let stops = interval_micros.to_bits() == STOP_INTERVAL.to_bits();
        let is_interval = interval_micros.is_finite() && interval_micros >= 0.0;
        (is_request && (stops || is_interval)).then(|| Self {
            target: command.target,
            message_id,
            interval: is_interval.then(|| TimeDelta::from_micros(interval_micros.round() as i64)),
        })
    }

    /// The command that it is.
    pub fn to_command(self) -> CommandLong {
        let micros = self.interval.map_or(STOP_INTERVAL, |interval| (interval.as_nanos().max(0) as f64 * 1e-3) as f32);
        let params = [self.message_id as f32, micros, 0.0, 0.0, 0.0, 0.0, 0.0];
        CommandLong { target: self.target, command: COMMAND_SET_MESSAGE_INTERVAL, params }
    }
}

/// Any command except MAV_CMD_SET_MESSAGE_INTERVAL.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandLong {
    pub target: Address,
    /// MAV_CMD, supported or not.
    pub command: u16,
    pub params: [f32; 7],
}

impl CommandLong {
    /// The message id in the first parameter of a command about a message; `None` for other commands, and for an
    /// invalid id.
    pub fn named_message(&self) -> Option<u32> {
        let is_about_one = matches!(
            self.command,
            COMMAND_GET_MESSAGE_INTERVAL | COMMAND_SET_MESSAGE_INTERVAL | COMMAND_REQUEST_MESSAGE
        );
        let [first, ..] = self.params;
        (is_about_one && (0.0..=LARGEST_ID).contains(&first)).then_some(first as u32)
    }
}

/// Any command, with coordinates in integers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandInt {
    pub target: Address,
    /// MAV_FRAME of the coordinates.
    pub frame: u8,
    pub command: u16,
    pub params: [f32; 4],
    /// The fifth parameter: metres times 10^4 in a local frame, degrees of latitude times 10^7 in a global one,
    /// unscaled in other frames. `y` is the sixth, in the same way.
    pub x: i32,
    pub y: i32,
    pub z: f32,
}

impl CommandInt {
    /// The same command with seven parameters: coordinates in metres or degrees, to the 24 bits of a float.
    pub fn to_long(self) -> CommandLong {
        let unit = integer_unit(self.frame);
        let [p1, p2, p3, p4] = self.params;
        let scaled = |value: i32| (f64::from(value) * unit) as f32;
        CommandLong {
            target: self.target,
            command: self.command,
            params: [p1, p2, p3, p4, scaled(self.x), scaled(self.y), self.z],
        }
    }
}

/// The metres or degrees of one step of a coordinate that is an integer; 1 in frames without a scale.
///
/// Source: common.xml, COMMAND_INT and MISSION_ITEM_INT (fields x and y) and MAV_FRAME (which frames are local).
pub(super) const fn integer_unit(frame: u8) -> f64 {
    match frame {
        // LOCAL_NED, LOCAL_ENU, LOCAL_OFFSET_NED to BODY_OFFSET_NED, BODY_FRD to LOCAL_FLU.
        1 | 4 | 7..=9 | 12..=21 => 1e-4,
        // GLOBAL and its relatives, those with INT and those relative to the terrain among them.
        0 | 3 | 5 | 6 | 10 | 11 => 1e-7,
        _ => 1.0,
    }
}

/// MAV_RESULT of common.xml: the results that are sent or understood here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandResult {
    /// Valid, and carried out.
    Accepted = 0,
    /// Valid, but cannot be carried out now; the sender may try again.
    TemporarilyRejected = 1,
    /// Supported, but its parameters are invalid.
    Denied = 2,
    Unsupported = 3,
    /// Valid, but it failed.
    Failed = 4,
    /// Started; another reply follows.
    InProgress = 5,
    /// Valid as COMMAND_INT alone, whose coordinates are exact.
    IntOnly = 8,
    /// Its coordinates are in a frame that is not supported.
    UnsupportedFrame = 9,
}

/// The answer to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandAck {
    pub command: u16,
    /// MAV_RESULT: 0 accepted, 2 denied, 3 unsupported, 4 failed.
    pub result: u8,
    pub target: Option<Address>,
}

/// MESSAGE_INTERVAL (244).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInterval {
    /// The wire has only 16 bits of the id.
    pub message_id: u16,
    /// -1 when the message is not sent, 0 when the sender has no such message.
    pub interval_micros: i32,
}
