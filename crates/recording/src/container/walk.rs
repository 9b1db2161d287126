//! Walks the records of a recording in order, those inside chunks included, and reports damage on the way.
//!
//! A chunk with a wrong checksum or broken framing costs only the records that cannot be separated; the next chunk is
//! found by the file's own framing.

use flate2::Crc;
use mcap::records::op;

use super::error::ReadError;
use super::fields;
use super::records::{RawRecord, RecordScanner, RecordsEnd};

/// Where the walk stops.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum WalkEnd {
    /// Something is damaged; the walk can go on behind it.
    Error(ReadError),
    /// Nothing more can be found.
    End(RecordsEnd),
}

/// A walk over all records of a file.
#[derive(Clone, Debug)]
pub(super) struct RecordWalker<'a> {
    file: RecordScanner<'a>,
    chunk: Option<OpenChunk<'a>>,
}

/// The chunk that the walk is in.
#[derive(Clone, Debug)]
struct OpenChunk<'a> {
    records: RecordScanner<'a>,
    is_complete: bool,
}

impl<'a> RecordWalker<'a> {
    /// Goes on from where a walk over the file's own records stands.
    pub(super) const fn new(file: RecordScanner<'a>) -> Self {
        Self { file, chunk: None }
    }

    /// How far the walk has come, as an offset from the start of the file.
    pub(super) fn offset(&self) -> usize {
        let chunk = self.chunk.as_ref().map(|chunk| chunk.records.offset());
        chunk.unwrap_or_else(|| self.file.offset())
    }

    /// How the file ends.
    pub(super) fn end(&self) -> RecordsEnd {
        self.file.clone().end()
    }

    /// The next record that is no chunk; after an end the same end again.
    pub(super) fn next(&mut self) -> Result<RawRecord<'a>, WalkEnd> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.records.next() {
                    Ok(record) => return Ok(record),
                    Err(end) => {
                        // Where a chunk that was cut off stops is reported at the file's end.
                        let is_told = matches!(end, RecordsEnd::Truncated { .. }) && !chunk.is_complete;
                        self.chunk = None;
                        if let Some(defect) = error_of(end).filter(|_| !is_told) {
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

    /// Goes into a chunk. With a wrong checksum the walk is in it all the same: its inputs have checksums of their own.
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

/// What is wrong with a chunk whose records end like this.
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
