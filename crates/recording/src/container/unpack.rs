//! Rewrites a recording that another program has compressed, so that it can be read like our own.

use mcap::MAGIC;
use mcap::records::op;

use super::fields;
use super::walk::{RawRecord, RecordScanner, RecordsEnd};
use crate::chunk_compression::unpack;

/// A recording that unpacks to more than the caller's limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the chunks of the recording unpack to more than {0} MiB")]
pub struct UnpackedTooLarge(u64);

/// The recording with its compressed chunks unpacked; unchanged if there are none. Damage stays damage: of a chunk that cannot be
/// unpacked whole, the beginning is kept with a checksum that does not fit it, and the end is cut off where it was. Indexes are left out.
///
/// # Errors
/// The result would exceed `max_bytes`.
pub fn unpack_recording(bytes: Vec<u8>, max_bytes: u64) -> Result<Vec<u8>, UnpackedTooLarge> {
    if !is_compressed(&bytes) {
        return Ok(bytes);
    }
    let Some(mut records) = RecordScanner::new(&bytes) else {
        return Ok(bytes);
    };
    let mut out = MAGIC.to_vec();
    loop {
        match records.next() {
            Ok(record) => push_record(&mut out, &record),
            Err(RecordsEnd::Complete) => {
                push(&mut out, op::DATA_END, &[0; 4]);
                push(&mut out, op::FOOTER, &[0; 20]);
                out.extend_from_slice(MAGIC);
                return Ok(out);
            }
            Err(RecordsEnd::Truncated { .. }) => return Ok(out),
            Err(RecordsEnd::Damaged { offset, .. }) => {
                out.extend_from_slice(bytes.get(offset..).unwrap_or_default());
                return Ok(out);
            }
        }
        if out.len() as u64 > max_bytes {
            return Err(UnpackedTooLarge(max_bytes >> 20));
        }
    }
}

fn is_compressed(bytes: &[u8]) -> bool {
    let mut records = RecordScanner::new(bytes);
    let mut chunks = std::iter::from_fn(|| records.as_mut()?.next().ok()).filter(|record| record.opcode == op::CHUNK);
    chunks.any(|record| fields::chunk(record.body).is_some_and(|chunk| !chunk.compression.is_empty()))
}

fn push_record(out: &mut Vec<u8>, record: &RawRecord<'_>) {
    match record.opcode {
        op::CHUNK => push_chunk(out, record),
        op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => push(out, record.opcode, record.body),
        // They hold offsets of the packed file, or end it.
        _ => {}
    }
}

/// A chunk whose head is damaged, or whose compression is unknown, is copied for the reader to report.
fn push_chunk(out: &mut Vec<u8>, record: &RawRecord<'_>) {
    let chunk = fields::chunk(record.body);
    let Some((chunk, unpacked)) = chunk.and_then(|chunk| Some((chunk, unpack(&chunk)?))) else {
        push(out, op::CHUNK, record.body);
        return;
    };
    let mut crc = flate2::Crc::new();
    crc.update(&unpacked.records);
    let is_whole = unpacked.fault.is_none() && record.is_complete;
    let crc = if is_whole || chunk.crc != 0 { chunk.crc } else { !crc.sum() };
    let times = record.body.get(..16).unwrap_or_default();
    let length = (unpacked.records.len() as u64).to_le_bytes();
    let parts = [times, &length, &crc.to_le_bytes(), &[0; 4], &length, &unpacked.records];
    push(out, op::CHUNK, &parts.concat());
}

fn push(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend_from_slice(&(body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}
