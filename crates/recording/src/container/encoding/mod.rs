//! The encoding of the station's inputs, bit for bit, as in docs/recording-format.md.
//!
//! Little-endian, no padding, every `f64` by its bits. The last four bytes are a CRC-32 over the message's sequence number, its time
//! and the bytes before, so that damage is detected and reported instead of replayed.

mod decode;
mod encode;
#[cfg(test)]
mod tests;

use flate2::Crc;

pub(super) use decode::decode;
pub(super) use encode::encode;

/// First byte of every message; incremented by a change of layout.
const ENCODING_VERSION: u8 = 4;
/// First bytes of messages whose tag is new in their layout, so that an older program reports a newer file.
const ROBOT_COMMAND_VERSION: u8 = 5;
const PEER_ADDRESS_VERSION: u8 = 6;
/// The counts of a port where datagrams were dropped.
const DROPPED_DATAGRAMS_VERSION: u8 = 7;
const OWNERSHIP_VERSION: u8 = 8;
/// Fixes from outside, and speeds for robots.
const OUTSIDE_FIX_VERSION: u8 = 9;
const OF_STATION_VERSION: u8 = 10;
const NEWEST_VERSION: u8 = OF_STATION_VERSION;
/// The oldest readable layout. It has the same tags, except later additions.
const OLDEST_VERSION: u8 = 1;
const CHECKSUM_BYTES: usize = 4;

/// The kind of input: the second byte of a message.
mod tag {
    pub(super) const BYTES: u8 = 0;
    pub(super) const LINK: u8 = 1;
    pub(super) const OBSERVATION: u8 = 2;
    pub(super) const SET_POSE: u8 = 3;
    pub(super) const TICK: u8 = 4;
    /// Bytes from a peer other than the first of its link.
    pub(super) const PEER_BYTES: u8 = 5;
    pub(super) const PORT: u8 = 6;
    /// A command other than the oldest one, which has a separate tag.
    pub(super) const COMMAND: u8 = 7;
    pub(super) const REPORT: u8 = 8;
    pub(super) const SIMULATOR: u8 = 9;
    /// A robot id and a command for it under one of the command tags.
    pub(super) const ROBOT_COMMAND: u8 = 10;
    pub(super) const PEER_ADDRESS: u8 = 11;
    pub(super) const OWNERSHIP: u8 = 12;
    pub(super) const OUTSIDE_FIX: u8 = 13;
    /// The number of a station, and a command, a report or a tick under its own tag.
    pub(super) const OF_STATION: u8 = 14;
}

/// Whether the station owns the robot.
mod ownership {
    pub(super) const STANDBY: u8 = 0;
    pub(super) const OWNER: u8 = 1;
    pub(super) const OWNER_WITH_STATE: u8 = 2;
}

/// The command that follows.
mod command {
    pub(super) const RESET_POSE: u8 = 0;
    pub(super) const SET_PARAMETER: u8 = 1;
    pub(super) const SAVE_PARAMETERS: u8 = 2;
    pub(super) const RELOAD_PARAMETERS: u8 = 3;
    pub(super) const DEFAULT_PARAMETERS: u8 = 4;
    pub(super) const FREEZE: u8 = 5;
    pub(super) const LEARN: u8 = 6;
    pub(super) const RESET_CALIBRATION: u8 = 7;
    pub(super) const SOURCE_OFF: u8 = 8;
    pub(super) const SOURCE_ON: u8 = 9;
    pub(super) const START_RECORDING: u8 = 10;
    pub(super) const STOP_RECORDING: u8 = 11;
    pub(super) const COMPARE_OFF: u8 = 12;
    pub(super) const COMPARE_ON: u8 = 13;
    pub(super) const DRIVE: u8 = 14;
}

/// The command for the simulated brick that follows.
mod simulator {
    pub(super) const KIDNAP: u8 = 0;
    pub(super) const SLIP: u8 = 1;
    pub(super) const CAMERA_OFF: u8 = 2;
    pub(super) const CAMERA_ON: u8 = 3;
    pub(super) const CAMERA_DELAY: u8 = 4;
    pub(super) const GYRO_BIAS_STEP: u8 = 5;
    pub(super) const LINK_PROFILE: u8 = 6;
    pub(super) const NO_LINK_PROFILE: u8 = 7;
    pub(super) const PULL_CABLE: u8 = 8;
    pub(super) const STEERING: u8 = 9;
    pub(super) const DRIVE: u8 = 10;
    pub(super) const PATH: u8 = 11;
}

/// The kind of observation that follows.
mod kind {
    pub(super) const WHEEL_ANGLES: u8 = 0;
    pub(super) const ODOMETER_POSE: u8 = 1;
    pub(super) const BODY_VELOCITY: u8 = 2;
    pub(super) const TURN_RATE: u8 = 3;
    pub(super) const WHEEL_ACCELERATIONS: u8 = 4;
    pub(super) const FIX: u8 = 5;
    pub(super) const LANDMARK: u8 = 6;
    pub(super) const BEACON_RANGE: u8 = 7;
    pub(super) const WALL_RANGE: u8 = 8;
    pub(super) const COMPASS_HEADING: u8 = 9;
    pub(super) const TEMPERATURE: u8 = 10;
}

/// Flags of a fix: the optional parts that follow.
mod fix_flag {
    pub(super) const HEADING: u8 = 1;
    pub(super) const COVARIANCE: u8 = 2;
    pub(super) const ALL: u8 = HEADING | COVARIANCE;
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    #[error("the message is too short: {wanted} more bytes wanted, {left} left")]
    TooShort { wanted: usize, left: usize },
    #[error("{0} bytes too many at the end of the message")]
    TooLong(usize),
    #[error("checksum {found:#010x} where {expected:#010x} was expected")]
    Checksum { found: u32, expected: u32 },
    #[error("message layout {0} is unknown: read the file with the program version in its header")]
    Version(u8),
    #[error("{field} {value} is not one of this layout")]
    Unknown { field: &'static str, value: u8 },
    /// Invalid UTF-8, or an invalid name.
    #[error("{0} is not the text of a layout of this program")]
    Text(&'static str),
    #[error("heading {0} rad is outside (-pi, pi]")]
    Heading(f64),
    /// A time outside the range of the host clock; as a signed number it would be before the session.
    #[error("time {0} ns is beyond the range of the host clock")]
    Time(u64),
}

/// The position of a message in the recording; included in its checksum.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordPosition {
    pub(super) sequence: u32,
    /// Host nanoseconds.
    pub(super) log_time: u64,
}

impl RecordPosition {
    fn checksum(self, bytes: &[u8]) -> u32 {
        let mut crc = Crc::new();
        crc.update(&self.sequence.to_le_bytes());
        crc.update(&self.log_time.to_le_bytes());
        crc.update(bytes);
        crc.sum()
    }
}

fn put_numbers(values: &[f64], bytes: &mut Vec<u8>) {
    for value in values {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
}
