//! Walks the records of an MCAP file, or of one of its chunks, by their framing, and reports where and how they end.
//!
//! The `mcap` crate's readers stop with an error without an offset; a truncated recording needs the offset, and all records before it.
//! The content of the records is not read here, except the header of chunks. A chunk with a wrong checksum or broken framing loses only
//! the records that cannot be separated; the next chunk is found by the file's own framing.
//!
//! Source: MCAP specification 0, "Records": opcode (one byte), length of the content (u64, little-endian), content.

use flate2::Crc;
use mcap::MAGIC;
use mcap::records::op;

use super::{ReadError, fields};
use crate::chunk_compression::MAX_CHUNK_BYTES;

const RECORD_HEADER_BYTES: usize = 9;

/// A longer record is damage: the writer limits an input to [`MAX_INPUT_BYTES`](super::writer::MAX_INPUT_BYTES), a whole configuration is
/// smaller, and of a chunk that another program has compressed no more is unpacked.
const MAX_RECORD_BYTES: u64 = MAX_CHUNK_BYTES + MAX_CHUNK_HEAD_BYTES;
const MAX_CHUNK_HEAD_BYTES: u64 = 1 << 10;

#[derive(Clone, Copy, Debug)]
pub(crate) struct RawRecord<'a> {
    /// Offset of its opcode from the start of the file.
    pub(crate) offset: usize,
    pub(crate) opcode: u8,
    pub(crate) body: &'a [u8],
    /// Whether all of its content is present; only a chunk is returned truncated.
    pub(super) is_complete: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RecordsEnd {
    /// In a file: only the end magic follows the footer. In a chunk: the last record ends at its end.
    Complete,
    /// The file was truncated: what is missing, and where.
    Truncated { offset: usize, what: &'static str },
    /// Bytes that no MCAP writer writes; nothing after them can be found.
    Damaged { offset: usize, what: &'static str },
}

impl RecordsEnd {
    const fn truncated(offset: usize, what: &'static str) -> Self {
        Self::Truncated { offset, what }
    }

    const fn damaged(offset: usize, what: &'static str) -> Self {
        Self::Damaged { offset, what }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct RecordScanner<'a> {
    bytes: &'a [u8],
    /// Offset of `bytes` in the file.
    base: usize,
    /// Within `bytes`.
    offset: usize,
    state: ScanState,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ScanState {
    File,
    AfterFooter,
    /// After a truncated chunk that begins at this offset.
    AfterTruncatedChunk(usize),
    Chunk,
}

impl<'a> RecordScanner<'a> {
    /// Starts after the start magic; `None` without it.
    pub(crate) fn new(bytes: &'a [u8]) -> Option<Self> {
        bytes.starts_with(MAGIC).then_some(Self { bytes, base: 0, offset: MAGIC.len(), state: ScanState::File })
    }

    /// Walks `length` bytes of records, `start` bytes after the beginning of the chunk's content.
    fn within_chunk(chunk: &RawRecord<'a>, start: usize, length: usize) -> Self {
        let inner = chunk.body.get(start..).unwrap_or_default();
        Self {
            bytes: inner.get(..length).unwrap_or(inner),
            base: chunk.offset + RECORD_HEADER_BYTES + start,
            offset: 0,
            state: ScanState::Chunk,
        }
    }

    /// The next record, or the end; the end repeats.
    pub(super) fn next(&mut self) -> Result<RawRecord<'a>, RecordsEnd> {
        let offset = self.base + self.offset;
        let rest = self.bytes.get(self.offset..).unwrap_or_default();
        match self.state {
            ScanState::AfterFooter => return Err(end_after_footer(offset, rest)),
            ScanState::AfterTruncatedChunk(offset) => {
                return Err(RecordsEnd::truncated(offset, "the rest of a chunk"));
            }
            ScanState::Chunk if rest.is_empty() => return Err(RecordsEnd::Complete),
            ScanState::File | ScanState::Chunk => {}
        }
        if rest.iter().all(|byte| *byte == 0) {
            // Nothing, or the zeros that a file system leaves behind when the power fails.
            return Err(RecordsEnd::truncated(offset, "no record and no end magic"));
        }
        let Some((header, content)) = rest.split_first_chunk::<RECORD_HEADER_BYTES>() else {
            return Err(RecordsEnd::truncated(offset, "the rest of a record's header"));
        };
        let [opcode, length @ ..] = *header;
        let length = u64::from_le_bytes(length);
        if opcode == 0 {
            return Err(RecordsEnd::damaged(offset, "a record with opcode 0, which no writer makes"));
        }
        if length > MAX_RECORD_BYTES {
            return Err(RecordsEnd::damaged(offset, "a record that claims more than 128 MiB"));
        }
        let is_complete = content.len() >= length as usize;
        if !is_complete && (opcode != op::CHUNK || self.state == ScanState::Chunk) {
            return Err(RecordsEnd::truncated(offset, "the rest of a record"));
        }
        let body = content.get(..length as usize).unwrap_or(content);
        self.offset += RECORD_HEADER_BYTES + body.len();
        if !is_complete {
            self.state = ScanState::AfterTruncatedChunk(offset);
        } else if opcode == op::FOOTER && self.state == ScanState::File {
            self.state = ScanState::AfterFooter;
        }
        Ok(RawRecord { offset, opcode, body, is_complete })
    }

    /// Offset from the start of the file.
    pub(super) const fn offset(&self) -> usize {
        self.base + self.offset
    }

    pub(super) fn end(mut self) -> RecordsEnd {
        loop {
            if let Err(end) = self.next() {
                return end;
            }
        }
    }
}

fn end_after_footer(offset: usize, rest: &[u8]) -> RecordsEnd {
    if rest == MAGIC {
        RecordsEnd::Complete
    } else if MAGIC.starts_with(rest) {
        RecordsEnd::truncated(offset, "the end magic")
    } else {
        RecordsEnd::damaged(offset, "something else than the end magic behind the footer")
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum WalkEnd {
    /// Damage; the walk can continue after it.
    Error(ReadError),
    /// No further record can be found.
    End(RecordsEnd),
}

/// Walks all records of a file, those within chunks included.
#[derive(Clone, Debug)]
pub(crate) struct RecordWalker<'a> {
    file: RecordScanner<'a>,
    chunk: Option<OpenChunk<'a>>,
}

#[derive(Clone, Debug)]
struct OpenChunk<'a> {
    records: RecordScanner<'a>,
    is_complete: bool,
}

impl<'a> RecordWalker<'a> {
    /// Continues a walk over the file's own records.
    pub(crate) const fn new(file: RecordScanner<'a>) -> Self {
        Self { file, chunk: None }
    }

    pub(super) const fn size(&self) -> usize {
        self.file.bytes.len()
    }

    /// Offset from the start of the file.
    pub(super) fn offset(&self) -> usize {
        let chunk = self.chunk.as_ref().map(|chunk| chunk.records.offset());
        chunk.unwrap_or_else(|| self.file.offset())
    }

    pub(super) fn end(&self) -> RecordsEnd {
        self.file.clone().end()
    }

    /// The next record that is not a chunk; the end repeats.
    pub(crate) fn next(&mut self) -> Result<RawRecord<'a>, WalkEnd> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.records.next() {
                    Ok(record) => return Ok(record),
                    Err(end) => {
                        // Where a chunk that was cut off stops is reported at the file's end.
                        let is_reported = matches!(end, RecordsEnd::Truncated { .. }) && !chunk.is_complete;
                        self.chunk = None;
                        if let Some(defect) = error_of(end).filter(|_| !is_reported) {
                            return Err(WalkEnd::Error(defect));
                        }
                    }
                }
            }
            let record = self.file.next().map_err(WalkEnd::End)?;
            if record.opcode != op::CHUNK {
                return Ok(record);
            }
            if let Err(defect) = self.enter(&record) {
                return Err(WalkEnd::Error(defect));
            }
        }
    }

    /// Enters a chunk, even with a wrong checksum: its inputs have checksums of their own.
    fn enter(&mut self, record: &RawRecord<'a>) -> Result<(), ReadError> {
        let offset = record.offset as u64;
        let Some(chunk) = fields::chunk(record.body) else {
            if !record.is_complete {
                return Ok(());
            }
            return Err(ReadError::Chunk { offset, what: "the head of this chunk is damaged".to_owned() });
        };
        if !chunk.compression.is_empty() {
            return Err(ReadError::Compressed { offset, compression: chunk.compression.escape_default().to_string() });
        }
        self.chunk = Some(OpenChunk {
            records: RecordScanner::within_chunk(record, chunk.head_bytes, chunk.records.len()),
            is_complete: record.is_complete,
        });
        let found = checksum(chunk.records);
        if record.is_complete && chunk.crc != 0 && chunk.crc != found {
            let what = format!("its checksum is {found:#010x} where {:#010x} was expected", chunk.crc);
            return Err(ReadError::Chunk { offset, what });
        }
        Ok(())
    }
}

fn error_of(end: RecordsEnd) -> Option<ReadError> {
    let (offset, what) = match end {
        RecordsEnd::Complete => return None,
        RecordsEnd::Truncated { offset, what } | RecordsEnd::Damaged { offset, what } => (offset as u64, what),
    };
    Some(ReadError::Chunk { offset, what: format!("{what}; the rest of this chunk cannot be read") })
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}
