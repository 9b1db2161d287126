//! Telemetry logs: reads and writes the `.tlog` files of ground stations.
//!
//! QGroundControl, Mission Planner, MAVProxy and pymavlink write and read them. [`TlogReader`] splits a file of any
//! length into records within a fixed memory; [`TlogWriter`] writes one. The caller verifies frames ([`FrameCheck`]):
//! this module knows the length of a frame from its header and nothing else of MAVLink.
//!
//! # Model
//! ```text
//! file   = record*                       no header, no footer, no index
//! record = time (8 bytes) frame
//! time   = microseconds since 1970 UTC, unsigned, big-endian
//! frame  = one MAVLink 1 or 2 frame as it was on the wire, with its signature if it has one
//! ```
//! Some writers (MAVProxy, and pymavlink's `mavlogfile`) store the number of the link in the two lowest bits of the
//! time. Old ones wrote the time in the byte order of their processor, which was little-endian ([`ByteOrder`]).
//!
//! # Sources
//! MAVLink guide, "Telemetry logs"; pymavlink 2.4.50, `mavutil.mavlogfile`; MAVLink guide, "Packet Serialization", for
//! the lengths.

mod framing;
mod reader;
mod writer;

pub use reader::{FrameCheck, TlogCounts, TlogReader, TlogRecord};
pub use writer::TlogWriter;

/// Bytes of the time before each frame.
pub const TIME_BYTES: usize = 8;

/// The two lowest bits of a time, in which some writers keep the number of the link.
pub const LINK_BITS: u64 = 0b11;

/// 1 January 2000, microseconds since 1970: there were no telemetry logs before.
pub const OLDEST_MICROS: u64 = 946_684_800_000_000;
/// 1 January 2100, microseconds since 1970: no log of today holds later times.
pub const NEWEST_MICROS: u64 = 4_102_444_800_000_000;

/// In which order the bytes of the times stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ByteOrder {
    /// The most significant first, as the format wants it.
    #[default]
    Big,
    /// The least significant first: what a writer left that copied its memory.
    Little,
}

impl ByteOrder {
    /// The order of a file whose first time this is: little only if the time lies in the far future the right way round, and in
    /// this century the wrong way round.
    pub fn of_first(time: [u8; TIME_BYTES]) -> Self {
        let is_future = u64::from_be_bytes(time) > NEWEST_MICROS;
        let is_sound_swapped = (OLDEST_MICROS..NEWEST_MICROS).contains(&u64::from_le_bytes(time));
        if is_future && is_sound_swapped { Self::Little } else { Self::Big }
    }

    /// The time that these bytes mean, in microseconds since 1970.
    pub const fn micros(self, time: [u8; TIME_BYTES]) -> u64 {
        match self {
            Self::Big => u64::from_be_bytes(time),
            Self::Little => u64::from_le_bytes(time),
        }
    }
}
