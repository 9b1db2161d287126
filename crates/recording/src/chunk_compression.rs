//! Unpacks the chunks of MCAP files of other programs, whatever their heads claim, within a limit.
//!
//! The `mcap` crate does this with the C libraries of Zstandard and LZ4; the default build has no C tool chain.
//!
//! Source: MCAP specification, "Well-known compression formats": `zstd`, one or more frames of RFC 8878, and `lz4`, the LZ4 frame format.

use std::io::Read;

use lz4_flex::frame::FrameDecoder;
use ruzstd::decoding::StreamingDecoder;

use crate::container::fields::Chunk;

/// Limit of an unpacked chunk. rosbag2 ends one after 768 KiB, with its last message whole; a picture of a large camera has 50 MB.
pub(crate) const MAX_CHUNK_BYTES: u64 = 128 << 20;

/// The records of a chunk, as far as they could be unpacked.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct UnpackedChunk {
    pub(crate) records: Vec<u8>,
    /// Why some are missing.
    pub(crate) fault: Option<String>,
}

/// `None` for a compression that is not known.
pub(crate) fn unpack(chunk: &Chunk<'_>) -> Option<UnpackedChunk> {
    let (packed, mut records) = (chunk.records, Vec::new());
    let result = match chunk.compression {
        "" => {
            records.extend_from_slice(packed);
            Ok(())
        }
        "zstd" => unpack_zstd(packed, &mut records),
        "lz4" => read_limited(FrameDecoder::new(packed), &mut records),
        _ => return None,
    };
    let (found, expected) = (records.len() as u64, chunk.unpacked_bytes);
    // An LZ4 frame may be cut where nobody notices.
    let result = result.and_then(|()| {
        let fault = || format!("{found} bytes where its head claims {expected}");
        (found == expected).then_some(()).ok_or_else(fault)
    });
    Some(UnpackedChunk { records, fault: result.err() })
}

fn unpack_zstd(mut packed: &[u8], records: &mut Vec<u8>) -> Result<(), String> {
    while !packed.is_empty() {
        let frame = StreamingDecoder::new(&mut packed).map_err(|error| format!("not Zstandard: {error}"))?;
        read_limited(frame, records)?;
    }
    Ok(())
}

/// Appends until the end, the limit or the first error; what was read before stays.
fn read_limited(unpacked: impl Read, records: &mut Vec<u8>) -> Result<(), String> {
    let room = MAX_CHUNK_BYTES.saturating_sub(records.len() as u64);
    let read = unpacked.take(room + 1).read_to_end(records).map_err(|error| error.to_string())?;
    if read as u64 > room {
        records.truncate(MAX_CHUNK_BYTES as usize);
        return Err(format!("it unpacks to more than {} MiB", MAX_CHUNK_BYTES >> 20));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the Python packages zstandard and lz4, see `make_bags.py` beside them.
    const ZSTD: &[u8] = include_bytes!("../tests/data/ros2/text.zst");
    const LZ4: &[u8] = include_bytes!("../tests/data/ros2/text.lz4");
    const TEXT: &[u8] = include_bytes!("../tests/data/ros2/text.txt");

    fn unpack_text(compression: &str, packed: &[u8], repeats: usize) -> Option<UnpackedChunk> {
        let unpacked_bytes = (repeats * TEXT.len()) as u64;
        unpack(&Chunk { unpacked_bytes, crc: 0, compression, head_bytes: 0, records: packed })
    }

    #[test]
    fn both_compressions_of_the_specification_are_unpacked() {
        for (name, packed) in [("zstd", ZSTD), ("lz4", LZ4), ("", TEXT)] {
            assert_eq!(
                unpack_text(name, packed, 1),
                Some(UnpackedChunk { records: TEXT.to_vec(), fault: None }),
                "{name}"
            );
        }
        let two_frames = [ZSTD, ZSTD].concat();
        assert_eq!(unpack_text("zstd", &two_frames, 2).unwrap().records, [TEXT, TEXT].concat());
        assert_eq!(unpack_text("brotli", ZSTD, 1), None);
    }

    #[test]
    fn what_is_cut_or_damaged_gives_a_beginning_and_says_so() {
        for (name, packed) in [("zstd", ZSTD), ("lz4", LZ4)] {
            for length in 1..packed.len() {
                let found = unpack_text(name, &packed[..length], 1).unwrap();
                // The mark and the checksum at the end may be missing.
                let is_whole = found.records == TEXT;
                assert!(is_whole || TEXT.starts_with(&found.records) && found.fault.is_some(), "{name} {length}");
            }
            for at in 0..packed.len() {
                let mut damaged = packed.to_vec();
                damaged[at] ^= 0xFF;
                let found = unpack_text(name, &damaged, 1).unwrap();
                // The checksum of the chunk finds the rest.
                assert!(found.fault.is_some() || found.records.len() == TEXT.len(), "{name} {at}");
            }
        }
    }

    #[test]
    fn a_chunk_that_grows_without_end_is_stopped() {
        let mut records = Vec::new();
        let error = read_limited(std::io::repeat(7), &mut records).unwrap_err();
        assert!(error.contains("128 MiB"), "{error}");
        assert_eq!(records.len() as u64, MAX_CHUNK_BYTES);
    }
}
