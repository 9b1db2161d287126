//! Walks the records of a recording in their order, those inside chunks as well, and names what is damaged on the way.
//!
//! A chunk whose checksum is wrong or whose framing breaks costs only what cannot be told apart in it: the chunk behind it
//! is found by the file's own framing.

use flate2::Crc;
use mcap::records::op;

use super::fields;
use super::reader::ReadError;
use super::records::{End, RawRecord, Records};

/// Where the walk stops.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Stop {
    /// Something is damaged; the walk can go on behind it.
    Defect(ReadError),
    /// Nothing more can be found.
    End(End),
}

/// A walk over all records of a file.
#[derive(Clone, Debug)]
pub(super) struct Walk<'a> {
    file: Records<'a>,
    chunk: Option<OpenChunk<'a>>,
}

/// The chunk that the walk is in.
#[derive(Clone, Debug)]
struct OpenChunk<'a> {
    records: Records<'a>,
    is_whole: bool,
}

impl<'a> Walk<'a> {
    /// Goes on from where a walk over the file's own records stands.
    pub(super) const fn from(file: Records<'a>) -> Self {
        Self { file, chunk: None }
    }

    /// How far the walk has come, as an offset from the start of the file.
    pub(super) fn offset(&self) -> usize {
        let chunk = self.chunk.as_ref().map(|chunk| chunk.records.offset());
        chunk.unwrap_or_else(|| self.file.offset())
    }

    /// How the file ends.
    pub(super) fn end(&self) -> End {
        self.file.clone().end()
    }

    /// The next record that is no chunk; after an end the same end again.
    pub(super) fn next(&mut self) -> Result<RawRecord<'a>, Stop> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.records.next() {
                    Ok(record) => return Ok(record),
                    Err(end) => {
                        // Where a chunk that was cut off stops is the file's end to tell.
                        let is_told = matches!(end, End::Torn { .. }) && !chunk.is_whole;
                        self.chunk = None;
                        if let Some(defect) = defect_of(end).filter(|_| !is_told) {
                            return Err(Stop::Defect(defect));
                        }
                    }
                }
            }
            let record = self.file.next().map_err(Stop::End)?;
            if record.opcode != op::CHUNK {
                return Ok(record);
            }
            if let Err(defect) = self.enter(&record) {
                return Err(Stop::Defect(defect));
            }
        }
    }

    /// Goes into a chunk. With a wrong checksum the walk is in it all the same: its inputs have checksums of their own.
    fn enter(&mut self, record: &RawRecord<'a>) -> Result<(), ReadError> {
        let offset = record.offset as u64;
        let Some(chunk) = fields::chunk(record.body) else {
            if !record.is_whole {
                return Ok(());
            }
            let what = "the head of this chunk is damaged".to_owned();
            return Err(ReadError::Chunk { offset, what });
        };
        if !chunk.compression.is_empty() {
            let compression = chunk.compression.escape_default().to_string();
            return Err(ReadError::Compressed { offset, compression });
        }
        self.chunk = Some(OpenChunk {
            records: Records::inside(record, chunk.head_bytes, chunk.records.len()),
            is_whole: record.is_whole,
        });
        let found = checksum(chunk.records);
        if record.is_whole && chunk.crc != 0 && chunk.crc != found {
            let what = format!("its checksum is {found:#010x} where {:#010x} was expected", chunk.crc);
            return Err(ReadError::Chunk { offset, what });
        }
        Ok(())
    }
}

/// What is wrong with a chunk whose records end like this.
fn defect_of(end: End) -> Option<ReadError> {
    let (offset, what) = match end {
        End::Complete => return None,
        End::Torn { offset, what } | End::Damaged { offset, what } => (offset as u64, what),
    };
    let what = format!("{what}; the rest of this chunk cannot be read");
    Some(ReadError::Chunk { offset, what })
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}
