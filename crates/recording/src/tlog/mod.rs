//! Telemetry logs: reads and writes the `.tlog` files of ground stations.
//!
//! QGroundControl, Mission Planner, MAVProxy and pymavlink write and read them. [`TlogReader`] splits a file of any length into records
//! within a fixed memory; [`TlogWriter`] writes one. The caller verifies frames ([`FrameCheck`]): this module parses only the length of
//! a frame from its header.
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

mod reader;

pub use reader::{FrameCheck, TlogCounts, TlogReader, TlogRecord};

use std::io::Write;

/// Timestamp before each frame.
pub const TIME_BYTES: usize = 8;

/// The two lowest bits of a timestamp, in which some writers store the number of the link.
pub const LINK_BITS: u64 = 0b11;

/// 1 January 2000: there were no telemetry logs before.
pub const OLDEST_MICROS: u64 = 946_684_800_000_000;
/// 1 January 2100: no present log has later times.
pub const NEWEST_MICROS: u64 = 4_102_444_800_000_000;

/// Byte order of the timestamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ByteOrder {
    /// The format's order.
    #[default]
    Big,
    /// Written by old programs that copied their memory.
    Little,
}

impl ByteOrder {
    /// The byte order of a file with this first timestamp: little only if it lies in the far future as big-endian, and in this century
    /// as little-endian.
    pub fn of_first(time: [u8; TIME_BYTES]) -> Self {
        let is_future = u64::from_be_bytes(time) > NEWEST_MICROS;
        let is_sound_swapped = (OLDEST_MICROS..NEWEST_MICROS).contains(&u64::from_le_bytes(time));
        if is_future && is_sound_swapped { Self::Little } else { Self::Big }
    }

    /// Microseconds since 1970.
    pub const fn micros(self, time: [u8; TIME_BYTES]) -> u64 {
        match self {
            Self::Big => u64::from_be_bytes(time),
            Self::Little => u64::from_le_bytes(time),
        }
    }
}

/// Writes records to `W`; flushed data is always readable, because the format has no footer.
#[derive(Debug)]
pub struct TlogWriter<W: Write> {
    out: W,
    latest_micros: u64,
    scratch: Vec<u8>,
}

impl<W: Write> TlogWriter<W> {
    /// Writes nothing before the first record.
    pub const fn new(out: W) -> Self {
        Self { out, latest_micros: 0, scratch: Vec::new() }
    }

    /// Records one whole frame, received or sent at `micros` since 1970 UTC. Times in the file never decrease, because players treat a
    /// decrease as the end: an earlier time is replaced by the latest.
    pub fn record(&mut self, micros: u64, frame: &[u8]) -> std::io::Result<()> {
        self.latest_micros = self.latest_micros.max(micros);
        // One call for both, so that a file that is cut off by a full disk ends between two records if it can.
        self.scratch.clear();
        self.scratch.extend(self.latest_micros.to_be_bytes());
        self.scratch.extend_from_slice(frame);
        self.out.write_all(&self.scratch)
    }

    pub fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }

    pub fn finish(mut self) -> std::io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_a_big_endian_time_and_the_frame_and_times_never_step_back() {
        let mut writer = TlogWriter::new(Vec::new());
        writer.record(0x0006_60BE_9038_02CB, &[0xFD, 1]).unwrap();
        writer.record(5, &[0xFE]).unwrap();
        let time = [0x00, 0x06, 0x60, 0xBE, 0x90, 0x38, 0x02, 0xCB];
        let expected = [&time[..], &[0xFD, 1], &time, &[0xFE]].concat();
        assert_eq!(writer.finish().unwrap(), expected);
    }
}
