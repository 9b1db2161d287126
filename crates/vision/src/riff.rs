//! The chunks of a RIFF file, in the order of their bytes.

use std::io::{BufReader, Read, Result, copy, sink};

/// Why a file may have fewer pictures than were recorded: a loss of power, or a full disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AviCutOff {
    #[error("the file ends at byte {offset}, {missing} bytes before the end of a chunk")]
    InChunk { offset: u64, missing: u64 },
    #[error("the file ends at byte {offset}; by its header it ends at {declared}")]
    BetweenChunks { offset: u64, declared: u64 },
    #[error("the header has no size: its writer did not finish, or wrote to a pipe")]
    Unfinished,
    #[error("no chunk begins at byte {offset}; nothing is read from there on")]
    NoChunk { offset: u64 },
}

/// Lists whose chunks are walked as if they stood in the file itself; others are chunks like any other. So it does not matter whether
/// the writer of the file ever filled in the sizes of these.
const WALKED_LISTS: [&[u8; 4]; 4] = [b"hdrl", b"strl", b"movi", b"rec "];

/// Reads forward only.
#[derive(Debug)]
pub(crate) struct RiffReader<R> {
    input: BufReader<R>,
    /// Bytes that were read.
    offset: u64,
    /// Where the RIFF chunk ends by its header; `None` if that has no size.
    declared_end: Option<u64>,
}

pub(crate) enum RiffItem {
    /// The chunks of a RIFF chunk or a list of this kind follow.
    Begin([u8; 4]),
    /// The content follows; it must be read or skipped.
    Chunk {
        id: [u8; 4],
        bytes: u32,
    },
    End(Option<AviCutOff>),
}

impl<R: Read> RiffReader<R> {
    pub(crate) fn new(input: R) -> Self {
        Self { input: BufReader::new(input), offset: 0, declared_end: None }
    }

    pub(crate) const fn offset(&self) -> u64 {
        self.offset
    }

    pub(crate) fn next_item(&mut self) -> Result<RiffItem> {
        let start = self.offset;
        let mut header = [0; 8];
        let missing = self.fill(&mut header)?;
        if missing == header.len() {
            return Ok(RiffItem::End(self.end_between_chunks()));
        }
        if missing > 0 {
            return Ok(RiffItem::End(Some(self.end_in_chunk(missing as u64))));
        }
        let [a, b, c, d, size @ ..] = header;
        let (id, bytes) = ([a, b, c, d], u32::from_le_bytes(size));
        if !id.iter().all(|byte| (b' '..=b'~').contains(byte)) {
            // Behind the end there may be anything.
            let is_behind = self.declared_end.is_some_and(|end| start >= end);
            return Ok(RiffItem::End((!is_behind).then_some(AviCutOff::NoChunk { offset: start })));
        }
        let is_riff = &id == b"RIFF";
        if !is_riff && &id != b"LIST" {
            return Ok(RiffItem::Chunk { id, bytes });
        }
        let mut kind = [0; 4];
        let missing = self.fill(&mut kind)?;
        if missing > 0 {
            return Ok(RiffItem::End(Some(self.end_in_chunk(missing as u64))));
        }
        if is_riff {
            self.declared_end = (bytes != 0 && bytes != u32::MAX).then(|| start + 8 + u64::from(bytes));
        }
        if is_riff || WALKED_LISTS.contains(&&kind) {
            Ok(RiffItem::Begin(kind))
        } else {
            Ok(RiffItem::Chunk { id, bytes: bytes.saturating_sub(4) })
        }
    }

    /// Replaces `content` by that of a chunk. Says if the file ends too early.
    pub(crate) fn read_content(&mut self, bytes: u32, content: &mut Vec<u8>) -> Result<Option<AviCutOff>> {
        content.clear();
        // Memory grows with what comes, not with what was announced.
        let read = self.input.by_ref().take(u64::from(bytes)).read_to_end(content)?;
        self.finish_chunk(bytes, read as u64)
    }

    pub(crate) fn skip_content(&mut self, bytes: u32) -> Result<Option<AviCutOff>> {
        let read = copy(&mut self.input.by_ref().take(u64::from(bytes)), &mut sink())?;
        self.finish_chunk(bytes, read)
    }

    fn finish_chunk(&mut self, bytes: u32, read: u64) -> Result<Option<AviCutOff>> {
        self.offset += read;
        if read < u64::from(bytes) {
            return Ok(Some(self.end_in_chunk(u64::from(bytes) - read)));
        }
        // An odd count is rounded up; at the end of a file, the byte for that may be absent.
        self.fill(&mut [0; 1][..(bytes % 2) as usize])?;
        Ok(None)
    }

    /// How many bytes are missing at the end of the file.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let mut rest = &mut *buffer;
        let read = copy(&mut self.input.by_ref().take(rest.len() as u64), &mut rest)?;
        self.offset += read;
        Ok(buffer.len() - read as usize)
    }

    const fn end_in_chunk(&self, missing: u64) -> AviCutOff {
        AviCutOff::InChunk { offset: self.offset, missing }
    }

    fn end_between_chunks(&self) -> Option<AviCutOff> {
        match self.declared_end {
            None => Some(AviCutOff::Unfinished),
            Some(declared) => {
                (self.offset < declared).then_some(AviCutOff::BetweenChunks { offset: self.offset, declared })
            }
        }
    }
}
