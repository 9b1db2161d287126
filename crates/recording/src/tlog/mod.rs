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

mod reader;

pub use reader::{FrameCheck, TlogCounts, TlogReader, TlogRecord};

use std::io::Write;

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

/// Writes records to `W`; what was flushed is readable whatever follows, because the format has no end.
#[derive(Debug)]
pub struct TlogWriter<W: Write> {
    out: W,
    latest_micros: u64,
    scratch: Vec<u8>,
}

impl<W: Write> TlogWriter<W> {
    /// Begins a file; nothing is written before the first record.
    pub const fn new(out: W) -> Self {
        Self { out, latest_micros: 0, scratch: Vec::new() }
    }

    /// Writes that `frame`, one whole frame, was received or sent at `micros` since 1970 UTC. Times never step back in the file, because
    /// players take a step back for the end: an earlier one is written as the latest before it.
    pub fn record(&mut self, micros: u64, frame: &[u8]) -> std::io::Result<()> {
        self.latest_micros = self.latest_micros.max(micros);
        // One call for both, so that a file that is cut off by a full disk ends between two records if it can.
        self.scratch.clear();
        self.scratch.extend(self.latest_micros.to_be_bytes());
        self.scratch.extend_from_slice(frame);
        self.out.write_all(&self.scratch)
    }

    /// Hands everything on to the system.
    pub fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }

    /// Ends the file and gives `W` back.
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
