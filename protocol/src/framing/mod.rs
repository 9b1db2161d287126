//! Bytes to frames: finds MAVLink frames in whatever a link delivers, and records everything else.
//!
//! It exists beside the `mavlink` crate's reader because that one cannot drop a truncated frame, counts nothing, drops
//! unknown messages, and spends most of its time in a bytewise checksum. Source: MAVLink guide, "Packet Serialization".

mod candidate;
mod checksum;
mod framer;
mod sequence;

pub(crate) use candidate::{FrameHeader, classify};
pub use candidate::{VerifiedFrame, parse_verified, verify};
pub use checksum::checksum;
pub(crate) use checksum::crc_extra_of;
pub use framer::Framer;
pub use sequence::{SequenceCounter, SequenceTracker};

use posebridge_telemetry::{Address, ReceiveError, TimeDelta};

pub const START_BYTE_V2: u8 = 0xFD;
pub const START_BYTE_V1: u8 = 0xFE;
/// Incompatibility flag of a MAVLink 2 frame: a signature follows. The only one in use.
pub const FLAG_SIGNED: u8 = 0x01;

/// The version of a frame's layout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WireVersion {
    /// MAVLink 1: 8-bit message ids, no extension fields.
    V1,
    /// MAVLink 2: 24-bit message ids, trailing zeros cut off.
    #[default]
    V2,
}

/// Whether a link delivers a stream or datagrams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TransportKind {
    /// A stream of bytes, cut anywhere.
    #[default]
    Stream,
    /// Datagrams that hold complete frames; each push is one datagram.
    Datagram,
}

/// The settings of a [`Framer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramerConfig {
    /// Accept MAVLink 1 frames as well. Off by default: with an 8-bit start and a 16-bit checksum as the only
    /// redundancy, noise yields a false frame every few megabytes.
    pub accept_v1: bool,
    /// Silence after which an incomplete frame is dropped.
    pub gap: TimeDelta,
    pub transport: TransportKind,
}

impl Default for FramerConfig {
    /// MAVLink 2 from a stream, with a gap of 50 ms: longer than the pauses of a Bluetooth serial link inside a frame,
    /// shorter than the period of the slowest telemetry that is used for steering.
    fn default() -> Self {
        Self { accept_v1: false, gap: TimeDelta::from_millis(50), transport: TransportKind::Stream }
    }
}

/// Counters of one framer. Every byte is in exactly one of: a frame, an unknown frame, garbage, or the framer's pending
/// bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FramerCounters {
    /// Those of foreign dialects included.
    pub frames: u64,
    /// Of a dialect that the station does not decode.
    pub foreign_frames: u64,
    pub checksum_errors: u64,
    /// Bytes outside every frame.
    pub garbage_bytes: u64,
    pub unknown_ids: u64,
    /// Interruptions of a frame for longer than the gap, whether or not its rest came later.
    pub stalls: u64,
    /// Candidates with a length or flags that their message cannot have.
    pub impossible_headers: u64,
}

impl FramerCounters {
    pub const fn merged(self, other: &Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            foreign_frames: self.foreign_frames + other.foreign_frames,
            checksum_errors: self.checksum_errors + other.checksum_errors,
            garbage_bytes: self.garbage_bytes + other.garbage_bytes,
            unknown_ids: self.unknown_ids + other.unknown_ids,
            stalls: self.stalls + other.stalls,
            impossible_headers: self.impossible_headers + other.impossible_headers,
        }
    }
}

/// One frame, borrowed from the framer's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRef<'a> {
    pub version: WireVersion,
    /// 24 bits.
    pub message_id: u32,
    pub source: Address,
    pub sequence: u8,
    /// As on the wire; trailing zeros may be truncated.
    pub payload: &'a [u8],
    /// The complete frame, start byte to checksum or signature.
    pub raw: &'a [u8],
}

impl FrameRef<'_> {
    /// Whether it has a signature, valid or not.
    pub fn is_signed(&self) -> bool {
        matches!(*self.raw, [START_BYTE_V2, _, flags, ..] if flags & FLAG_SIGNED != 0)
    }
}

/// A frame or a fault in the bytes of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FramerOutput<'a> {
    Frame(FrameRef<'a>),
    /// A frame that is complete by its length but has an unknown id, so that its checksum cannot be verified. Forward it
    /// unchanged; do not trust it.
    UnknownFrame(FrameRef<'a>),
    Error(ReceiveError),
}
