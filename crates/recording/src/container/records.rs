//! Walks the records of an MCAP file, or of one of its chunks, by their framing, and reports where and how they end.
//!
//! The `mcap` crate's readers stop with an error without an offset; a recording that was cut off needs the offset, and
//! all records before it. The content of the records is not read here.
//!
//! Source: MCAP specification 0, "Records": opcode (one byte), length of the content (u64, little-endian), content.

use mcap::MAGIC;
use mcap::records::op;

/// Opcode and length.
const RECORD_HEADER_BYTES: usize = 9;

/// A record longer than this is damage: the writer takes no input of more than
/// [`MAX_INPUT_BYTES`](super::writer::MAX_INPUT_BYTES), and a whole configuration is smaller.
const MAX_RECORD_BYTES: u64 = 64 << 20;

/// One record as it lies in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct RawRecord<'a> {
    /// Offset of its opcode from the start of the file.
    pub(super) offset: usize,
    /// What it is.
    pub(super) opcode: u8,
    /// Its content.
    pub(super) body: &'a [u8],
    /// Whether all of its content is there; only of a chunk is given what is left.
    pub(super) is_complete: bool,
}

/// Where the walk ended, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RecordsEnd {
    /// The footer is followed by the end magic and nothing else; of a chunk, its last record ends where it ends.
    Complete,
    /// The file stops before its end was written.
    Truncated {
        /// Offset of what is missing.
        offset: usize,
        /// What is missing there.
        what: &'static str,
    },
    /// What stands here was never written by an MCAP writer; nothing behind it can be found.
    Damaged {
        /// Offset of the damage.
        offset: usize,
        /// What is wrong there.
        what: &'static str,
    },
}

impl RecordsEnd {
    const fn truncated(offset: usize, what: &'static str) -> Self {
        Self::Truncated { offset, what }
    }

    const fn damaged(offset: usize, what: &'static str) -> Self {
        Self::Damaged { offset, what }
    }
}

/// A walk over the records of a file or of a chunk.
#[derive(Clone, Debug)]
pub(super) struct RecordScanner<'a> {
    bytes: &'a [u8],
    /// Where `bytes` begin in the file.
    base: usize,
    /// In `bytes`.
    offset: usize,
    state: ScanState,
}

/// What a walk goes through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ScanState {
    /// The file, before its footer.
    File,
    /// The file, behind its footer.
    AfterFooter,
    /// The file, behind a chunk that was cut off and begins at this offset.
    AfterTruncatedChunk(usize),
    /// A chunk.
    Chunk,
}

impl<'a> RecordScanner<'a> {
    /// Starts behind the start magic; `None` when the bytes do not begin with it.
    pub(super) fn new(bytes: &'a [u8]) -> Option<Self> {
        bytes.starts_with(MAGIC).then_some(Self { bytes, base: 0, offset: MAGIC.len(), state: ScanState::File })
    }

    /// A walk over the `length` bytes of records that begin `start` bytes behind the head of a chunk.
    pub(super) fn within_chunk(chunk: &RawRecord<'a>, start: usize, length: usize) -> Self {
        let inner = chunk.body.get(start..).unwrap_or_default();
        Self {
            bytes: inner.get(..length).unwrap_or(inner),
            base: chunk.offset + RECORD_HEADER_BYTES + start,
            offset: 0,
            state: ScanState::Chunk,
        }
    }

    /// The next record, or the end; after an end the same end again.
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
            return Err(RecordsEnd::damaged(offset, "a record that claims more than 64 MiB"));
        }
        let is_whole = content.len() >= length as usize;
        if !is_whole && (opcode != op::CHUNK || self.state == ScanState::Chunk) {
            return Err(RecordsEnd::truncated(offset, "the rest of a record"));
        }
        let body = content.get(..length as usize).unwrap_or(content);
        self.offset += RECORD_HEADER_BYTES + body.len();
        if !is_whole {
            self.state = ScanState::AfterTruncatedChunk(offset);
        } else if opcode == op::FOOTER && self.state == ScanState::File {
            self.state = ScanState::AfterFooter;
        }
        Ok(RawRecord { offset, opcode, body, is_complete: is_whole })
    }

    /// How far the walk has come, as an offset from the start of the file.
    pub(super) const fn offset(&self) -> usize {
        self.base + self.offset
    }

    /// Where the walk will end when it goes on from here.
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
