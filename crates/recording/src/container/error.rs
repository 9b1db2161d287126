//! Why a recording cannot be read.

use super::FORMAT;
use super::encoding::DecodeError;

/// Why a recording, or a part of it, cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The bytes are not an MCAP file.
    #[error("this is not an MCAP file: it does not begin with the MCAP magic")]
    NotMcap,
    /// The header is missing.
    #[error("byte {offset}: the file ends or goes on without a posebridge header: {what}")]
    NoHeader {
        /// Where it should have been.
        offset: u64,
        /// What stands there.
        what: String,
    },
    /// Written by a newer program.
    #[error(
        "the recording has format {found}, this program reads up to {FORMAT}: read it with the program that wrote it"
    )]
    Format {
        /// The format that it claims.
        found: u32,
    },
    /// Another program packed the messages anew.
    #[error("byte {offset}: the messages are compressed ({compression}): write the file again without compression")]
    Compressed {
        /// Where the chunk begins.
        offset: u64,
        /// How it is compressed.
        compression: String,
    },
    /// A chunk is damaged; what is whole in it and behind it follows.
    #[error("byte {offset}: a chunk of the recording is damaged: {what}")]
    Chunk {
        /// Where the damage, or the chunk, begins.
        offset: u64,
        /// What is wrong there.
        what: String,
    },
    /// A sample of the truth is destroyed.
    #[error("byte {offset}: a recorded sample of the truth is damaged: {what}")]
    Truth {
        /// Where its record begins.
        offset: u64,
        /// What is wrong with it.
        what: String,
    },
    /// The framing is destroyed; nothing behind it can be found.
    #[error("byte {offset}: {what}; the recording cannot be read any further")]
    Damaged {
        /// Where.
        offset: u64,
        /// What stands there.
        what: String,
    },
    /// One message is destroyed; the iteration goes on behind it.
    #[error("byte {offset}: a recorded input is damaged: {why}")]
    Message {
        /// Where its record begins.
        offset: u64,
        /// What is wrong with it.
        #[source]
        why: DecodeError,
    },
    /// Messages are missing between the one before and the one at the offset.
    #[error("byte {offset}: input number {expected} should stand here, but number {found} does")]
    Gap {
        /// Where the message behind the gap begins.
        offset: u64,
        /// The number that should have come.
        expected: u32,
        /// The number that came.
        found: u32,
    },
}
