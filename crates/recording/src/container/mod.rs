//! Recordings of posebridge: the station's inputs with their times.
//!
//! The file is MCAP in small chunks without compression. The writer ends a chunk with every flush, so that any reader
//! can read the flushed data after a crash; a torn tail is a [`RecordingEnd`] and not an error. Each input has its own
//! checksum besides that of its chunk, so that damage costs one input and not a whole chunk. docs/recording-format.md
//! describes the bytes. This module interprets nothing: the station replays the inputs.
//!
//! The outputs are stored beside the inputs ([`crate::foxglove`]), for viewers and notebooks. They are not read back,
//! with one exception: the truth of a simulated run ([`read_truth()`]).

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

/// Version of the recording's layout that this program writes, and the newest that it reads.
pub const FORMAT: u32 = 4;

/// The newest layout without chunks, whose messages have the time of the host clock and not UTC.
const LAST_UNCHUNKED_FORMAT: u32 = 2;

/// Topic of the one channel that holds the pipeline's inputs.
pub const INPUT_TOPIC: &str = "posebridge/input";

/// Topic of the truth of a simulated run.
pub const TRUTH_TOPIC: &str = "posebridge/truth";

/// Id of the channel on [`INPUT_TOPIC`]: the first that is written. Known so that inputs can be read where its record is damaged.
const INPUT_CHANNEL: u16 = 1;

/// Name of the schema and of the message encoding on [`INPUT_TOPIC`].
pub const INPUT_ENCODING: &str = "posebridge.input.v1";

/// A recording's description of itself, before its first input.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingHeader {
    /// Version of the layout; [`FORMAT`] when written by this program.
    pub format: u32,
    /// Version of the program that wrote it.
    pub program_version: String,
    /// Unix time of the host clock's zero, in microseconds.
    pub utc_start_micros: u64,
    /// The whole configuration of the session, as TOML.
    pub config_toml: String,
    /// The URLs of the links, in the order of their `LinkId`.
    pub links: Vec<String>,
}

/// Where in its session a recording begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartHeader {
    /// Number of this part of the recording, from 1.
    pub part: u32,
    /// How many inputs the pipeline had been given before the first one here. Only from 0 a replay is that of the session: a later
    /// part lacks what was learned before.
    pub inputs_before: u64,
    /// Name of the file that holds what came before, without its folder; `None` if nothing holds it.
    pub continues: Option<String>,
}

impl Default for PartHeader {
    /// With the session.
    fn default() -> Self {
        Self { part: 1, inputs_before: 0, continues: None }
    }
}

/// Inputs that were given to the pipeline but are not in the recording: the disk was too slow for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordingGap {
    /// How many.
    pub inputs: u64,
    /// When the last input before them was given.
    pub from: Timestamp<HostClock>,
    /// When the next input behind them was given, or again `from` at the end of the recording.
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
    /// Another program packed the messages anew.
    #[error("byte {offset}: the messages are compressed ({compression}): write the file again without compression")]
    Compressed { offset: u64, compression: String },
    /// A chunk is damaged; what is whole in it and behind it follows.
    #[error("byte {offset}: a chunk of the recording is damaged: {what}")]
    Chunk { offset: u64, what: String },
    #[error("byte {offset}: a recorded sample of the truth is damaged: {what}")]
    Truth { offset: u64, what: String },
    #[error("byte {offset}: {what}; the recording cannot be read any further")]
    Damaged { offset: u64, what: String },
    /// One message is destroyed; the iteration goes on behind it.
    #[error("byte {offset}: a recorded input is damaged: {why}")]
    Message {
        offset: u64,
        #[source]
        why: DecodeError,
    },
    #[error("byte {offset}: input number {expected} should stand here, but number {found} does")]
    Gap { offset: u64, expected: u32, found: u32 },
}
