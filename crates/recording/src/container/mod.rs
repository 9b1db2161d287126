//! Recordings of posebridge: the station's inputs with their times.
//!
//! The file is MCAP in small chunks without compression. The writer ends a chunk with every flush, so that any reader can read the
//! flushed data after a crash; a truncated end is a [`RecordingEnd`] and not an error. Each input has its own checksum besides that of
//! its chunk, so that damage loses one input and not a whole chunk. docs/recording-format.md describes the bytes. This module
//! interprets nothing: the station replays the inputs.
//!
//! The outputs are stored beside the inputs ([`crate::foxglove`]), for viewers and notebooks. They are not read back, except the ground
//! truth of a simulated run ([`read_truth()`]).

mod encoding;
mod fields;
mod header;
mod reader;
mod truth;
mod walk;
mod writer;

pub use encoding::DecodeError;
pub use reader::{RecordingEnd, RecordingReader};
pub use truth::{TruthSample, read_truth};
pub use writer::{OutputHandover, RecordingWriter, WriteError};

use posebridge_telemetry::{HostClock, Timestamp};

/// The layout version that this program writes, and the newest that it reads.
pub const FORMAT: u32 = 4;

/// The newest layout without chunks; its messages have host clock times instead of UTC.
const LAST_UNCHUNKED_FORMAT: u32 = 2;

/// Topic of the only channel with inputs.
pub const INPUT_TOPIC: &str = "posebridge/input";

/// Topic of the ground truth of a simulated run.
pub const TRUTH_TOPIC: &str = "posebridge/truth";

/// Id of the channel on [`INPUT_TOPIC`], the first one written. Fixed, so that inputs are readable when the channel record is damaged.
const INPUT_CHANNEL: u16 = 1;

/// Name of the schema and of the message encoding on [`INPUT_TOPIC`].
pub const INPUT_ENCODING: &str = "posebridge.input.v1";

/// The description of a recording, before its first input.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingHeader {
    /// Layout version; [`FORMAT`] when written by this program.
    pub format: u32,
    pub program_version: String,
    /// Unix time of the host clock's zero, in microseconds.
    pub utc_start_micros: u64,
    pub config_toml: String,
    /// URLs in the order of `LinkId`.
    pub links: Vec<String>,
}

/// Position of a recording in its session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartHeader {
    /// From 1.
    pub part: u32,
    /// Number of inputs of the session before this part. A replay reproduces the session only from 0: a later part lacks the state
    /// learned before.
    pub inputs_before: u64,
    /// File name of the previous part, without folder; `None` if there is none.
    pub continues: Option<String>,
}

impl Default for PartHeader {
    fn default() -> Self {
        Self { part: 1, inputs_before: 0, continues: None }
    }
}

/// Inputs of the session that are missing in the recording because the disk was too slow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordingGap {
    pub inputs: u64,
    /// Time of the last input before the gap.
    pub from: Timestamp<HostClock>,
    /// Time of the next input after the gap, or `from` at the end of the recording.
    pub to: Timestamp<HostClock>,
}

/// Why a recording, or a part of it, cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    #[error("this is not an MCAP file: it does not begin with the MCAP magic")]
    NotMcap,
    #[error("byte {offset}: the file ends or goes on without a posebridge header: {what}")]
    NoHeader { offset: u64, what: String },
    /// Written by a newer program.
    #[error(
        "the recording has format {found}, this program reads up to {FORMAT}: read it with the program that wrote it"
    )]
    Format { found: u32 },
    /// Another program rewrote the file with compression.
    #[error("byte {offset}: the messages are compressed ({compression}): write the file again without compression")]
    Compressed { offset: u64, compression: String },
    /// A chunk is damaged; the iteration continues with the intact messages in it and after it.
    #[error("byte {offset}: a chunk of the recording is damaged: {what}")]
    Chunk { offset: u64, what: String },
    #[error("byte {offset}: a recorded sample of the truth is damaged: {what}")]
    Truth { offset: u64, what: String },
    #[error("byte {offset}: {what}; the recording cannot be read any further")]
    Damaged { offset: u64, what: String },
    /// One message is damaged; the iteration continues after it.
    #[error("byte {offset}: a recorded input is damaged: {why}")]
    Message {
        offset: u64,
        #[source]
        why: DecodeError,
    },
    #[error("byte {offset}: input number {expected} should stand here, but number {found} does")]
    Gap { offset: u64, expected: u32, found: u32 },
}
