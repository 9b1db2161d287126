//! Walks the records of an MCAP file by their framing alone, and says where and how the file ends.
//!
//! The `mcap` crate's own readers stop with an error that names no place; a recording that was cut off needs the
//! offset, and must give everything before it. What is inside a record is not looked at here.
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
}

/// Where the walk ended, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The footer is followed by the end magic and nothing else.
    Complete,
    /// The file stops before its end was written.
    Torn {
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

/// A walk over the records of a file.
#[derive(Clone, Debug)]
pub(super) struct Records<'a> {
    bytes: &'a [u8],
    offset: usize,
    after_footer: bool,
}

impl<'a> Records<'a> {
    /// Starts behind the start magic; `None` when the bytes do not begin with it.
    pub(super) fn new(bytes: &'a [u8]) -> Option<Self> {
        bytes.starts_with(MAGIC).then_some(Self {
            bytes,
            offset: MAGIC.len(),
            after_footer: false,
        })
    }

    /// The next record, or the end; after an end the same end again.
    pub(super) fn next(&mut self) -> Result<RawRecord<'a>, End> {
        let offset = self.offset;
        let rest = self.bytes.get(offset..).unwrap_or_default();
        if self.after_footer {
            return Err(end_behind_footer(offset, rest));
        }
        if rest.iter().all(|byte| *byte == 0) {
            // Nothing, or the zeros that a file system leaves behind when the power fails.
            let what = "no record and no end magic";
            return Err(End::Torn { offset, what });
        }
        let Some((header, content)) = rest.split_first_chunk::<RECORD_HEADER_BYTES>() else {
            let what = "the rest of a record's header";
            return Err(End::Torn { offset, what });
        };
        let [opcode, length @ ..] = *header;
        let length = u64::from_le_bytes(length);
        if opcode == 0 {
            let what = "a record with opcode 0, which no writer makes";
            return Err(End::Damaged { offset, what });
        }
        if length > MAX_RECORD_BYTES {
            let what = "a record that claims more than 64 MiB";
            return Err(End::Damaged { offset, what });
        }
        let Some(body) = content.get(..length as usize) else {
            let what = "the rest of a record";
            return Err(End::Torn { offset, what });
        };
        self.offset = offset + RECORD_HEADER_BYTES + body.len();
        self.after_footer = opcode == op::FOOTER;
        Ok(RawRecord {
            offset,
            opcode,
            body,
        })
    }

    /// Where the walk will end when it goes on from here.
    pub(super) fn end(mut self) -> End {
        loop {
            if let Err(end) = self.next() {
                return end;
            }
        }
    }
}

fn end_behind_footer(offset: usize, rest: &[u8]) -> End {
    if rest == MAGIC {
        End::Complete
    } else if MAGIC.starts_with(rest) {
        let what = "the end magic";
        End::Torn { offset, what }
    } else {
        let what = "something else than the end magic behind the footer";
        End::Damaged { offset, what }
    }
}
