//! Our own recordings: the sequence of everything that was given to the pipeline, with the instants at which it was.
//!
//! The file is MCAP without chunks, so that every message written before the last flush can be read after a crash; a
//! torn tail is an [`Ending`] and not an error. Each message carries a checksum of its own, because MCAP has none
//! outside chunks. The bytes are described in docs/recording-format.md. This module interprets nothing: replaying is
//! the pipeline's work.

mod encoding;
mod fields;
mod reader;
mod records;
mod writer;

pub use encoding::DecodeError;
pub use reader::{Ending, ReadError, Reader};
pub use writer::{WriteError, Writer};

/// Version of the recording's layout that this program writes, and the newest that it reads.
pub const FORMAT: u32 = 2;

/// Topic of the one channel that holds the pipeline's inputs.
pub const INPUT_TOPIC: &str = "posebridge/input";

/// Name of the schema and of the message encoding on [`INPUT_TOPIC`].
pub const INPUT_ENCODING: &str = "posebridge.input.v1";

/// Name of the metadata record that holds the [`Header`].
const HEADER_RECORD: &str = "posebridge.recording";

/// What a recording says about itself before its first input.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
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
