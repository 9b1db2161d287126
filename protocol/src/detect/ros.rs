//! Frames of boards that speak ROS. They are recognised, so that people are told what to do, and not decoded.
//!
//! ```text
//! rosserial   FF FE, length lo hi, check of the length, topic lo hi, data, check of topic and data
//!             a check and the sum of the bytes that it covers make FF
//! micro-ROS   7E, source, destination, length lo hi, payload, CRC-16/ARC lo hi
//!             between 7E and the end 7D x stands for the byte x ^ 20
//! ```
//!
//! # Sources
//! rosserial: wiki.ros.org/rosserial/Overview/Protocol; a second byte of FF was protocol version 1. micro-ROS: eProsima Micro XRCE-DDS,
//! serial transport.

use crc::{CRC_16_ARC, Crc, Table};

use super::unit_counts::UnitCounts;

const SYNC: u8 = 0xFF;
const VERSIONS: [u8; 2] = [0xFE, 0xFF];
/// Longest data of a message: four times the largest buffer of the Arduino library.
const MAX_DATA_BYTES: usize = 8_192;

/// Whole messages of rosserial.
pub(super) fn rosserial(bytes: &[u8]) -> UnitCounts {
    count_frames(bytes, SYNC, rosserial_length)
}

/// The length of the message at the beginning of `bytes`.
fn rosserial_length(bytes: &[u8]) -> Option<usize> {
    let [SYNC, version, low, high, check, rest @ ..] = bytes else {
        return None;
    };
    let is_header = VERSIONS.contains(version) && sum(&[*low, *high, *check]) == 0xFF;
    let data_bytes = usize::from(u16::from_le_bytes([*low, *high]));
    // Topic, data, check.
    let behind = rest.get(..data_bytes + 3)?;
    (is_header && data_bytes <= MAX_DATA_BYTES && sum(behind) == 0xFF).then_some(5 + behind.len())
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

const BEGIN: u8 = 0x7E;
const ESCAPE: u8 = 0x7D;
const ESCAPE_MASK: u8 = 0x20;
/// Source, destination, length.
const HEADER_BYTES: usize = 4;
const CRC_BYTES: usize = 2;
/// Longest payload: the largest unit that the client libraries can be built for.
const MAX_PAYLOAD_BYTES: usize = 4_096;
static CRC_ARC: Crc<u16, Table<1>> = Crc::<u16, Table<1>>::new(&CRC_16_ARC);

/// Whole frames of micro-ROS.
pub(super) fn micro_ros(bytes: &[u8]) -> UnitCounts {
    count_frames(bytes, BEGIN, micro_ros_length)
}

fn micro_ros_length(bytes: &[u8]) -> Option<usize> {
    let [BEGIN, stuffed @ ..] = bytes else {
        return None;
    };
    let mut frame = Vec::new();
    let mut needed = HEADER_BYTES;
    let mut is_escaped = false;
    for (index, byte) in stuffed.iter().enumerate() {
        match *byte {
            BEGIN => return None,
            ESCAPE if !is_escaped => {
                is_escaped = true;
                continue;
            }
            byte => frame.push(if is_escaped { byte ^ ESCAPE_MASK } else { byte }),
        }
        is_escaped = false;
        if let [_, _, low, high] = frame[..] {
            let payload_bytes = usize::from(u16::from_le_bytes([low, high]));
            if payload_bytes == 0 || payload_bytes > MAX_PAYLOAD_BYTES {
                return None;
            }
            needed = HEADER_BYTES + payload_bytes + CRC_BYTES;
        }
        if frame.len() == needed {
            let (payload, crc) = frame.get(HEADER_BYTES..)?.split_last_chunk::<CRC_BYTES>()?;
            return (CRC_ARC.checksum(payload) == u16::from_le_bytes(*crc)).then_some(index + 2);
        }
    }
    None
}

/// Frames that begin with `first`, one after the other, whatever stands between.
fn count_frames(bytes: &[u8], first: u8, length_of: fn(&[u8]) -> Option<usize>) -> UnitCounts {
    let mut counts = UnitCounts::default();
    let mut rest = bytes;
    while let Some(at) = memchr::memchr(first, rest) {
        let candidate = rest.get(at..).unwrap_or_default();
        let length = length_of(candidate);
        if let Some(length) = length {
            counts.add(length);
        }
        rest = candidate.get(length.unwrap_or(1)..).unwrap_or_default();
    }
    counts
}
