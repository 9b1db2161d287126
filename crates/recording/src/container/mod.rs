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
pub(crate) mod fields;
mod reader;
mod unpack;
pub(crate) mod walk;
mod writer;

pub use encoding::DecodeError;
pub use reader::{RecordingEnd, RecordingReader, TruthSample, read_truth};
pub use unpack::{UnpackedTooLarge, unpack_recording};
pub use writer::{OutputHandover, RecordingWriter, WriteError};

use std::collections::BTreeMap;

use mcap::records::Metadata;
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
    #[error(
        "it holds messages that `posebridge export --messages` wrote, and no inputs: make a telemetry log of it, with \
         `posebridge import FILE --out LOG.tlog`"
    )]
    Messages,
    #[error(
        "the recording has format {found}, this program reads up to {FORMAT}: read it with the program that wrote it"
    )]
    Format { found: u32 },
    /// Another program rewrote the file with a compression other than those that [`unpack_recording`] undoes.
    #[error(
        "byte {offset}: the messages are compressed ({compression}), which is neither zstd nor lz4: write the file again with one \
         of these, or without compression"
    )]
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

const METADATA_NAME: &str = "posebridge.recording";

/// Latest start of a session, in the year 2262: nanoseconds of later ones overflow.
const LATEST_START_MICROS: u64 = i64::MAX as u64 / 1_000;

/// The log time of the host clock's zero, in nanoseconds: UTC since format 3.
const fn zero_nanos(header: &RecordingHeader) -> u64 {
    if header.format > LAST_UNCHUNKED_FORMAT { header.utc_start_micros * 1_000 } else { 0 }
}

fn metadata_record(header: &RecordingHeader, beginning: &PartHeader) -> Metadata {
    let links = serde_json::Value::from(header.links.clone()).to_string();
    let mut entries = BTreeMap::from([
        ("config_toml", header.config_toml.clone()),
        ("format", header.format.to_string()),
        ("links", links),
        ("program_version", header.program_version.clone()),
        ("utc_start_micros", header.utc_start_micros.to_string()),
        ("part", beginning.part.to_string()),
        ("inputs_before", beginning.inputs_before.to_string()),
    ]);
    if let Some(name) = &beginning.continues {
        entries.insert("continues", name.clone());
    }
    Metadata {
        name: METADATA_NAME.to_owned(),
        metadata: entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    }
}

/// Parses the body of the metadata record at `offset`; `None` for another one.
///
/// # Errors
/// It is damaged, lacks a key or was written by a newer program.
fn parse_header(offset: u64, record: &[u8]) -> Result<Option<(RecordingHeader, PartHeader)>, ReadError> {
    let entries = HeaderEntries {
        offset,
        values: match fields::metadata(record) {
            Some(found) if found.name == METADATA_NAME => found.entries,
            Some(_) => return Ok(None),
            None => return Err(header_error(offset, "a damaged metadata record")),
        },
    };
    let format = entries.number("format")?;
    if format > FORMAT {
        return Err(ReadError::Format { found: format });
    }
    let header = RecordingHeader {
        format,
        program_version: entries.text("program_version")?.to_owned(),
        utc_start_micros: entries.number("utc_start_micros")?,
        config_toml: entries.text("config_toml")?.to_owned(),
        links: serde_json::from_str(entries.text("links")?)
            .ok()
            .ok_or_else(|| entries.header_error("a header whose links are not a list"))?,
    };
    if header.utc_start_micros > LATEST_START_MICROS {
        return Err(entries.header_error("a header whose start lies beyond the year 2262"));
    }
    Ok(Some((header, entries.part_header()?)))
}

struct HeaderEntries<'a> {
    offset: u64,
    values: BTreeMap<&'a str, &'a str>,
}

impl<'a> HeaderEntries<'a> {
    fn text(&self, key: &str) -> Result<&'a str, ReadError> {
        let value = self.values.get(key).copied();
        value.ok_or_else(|| self.header_error(&format!("a header without the key `{key}`")))
    }

    fn number<N: std::str::FromStr>(&self, key: &str) -> Result<N, ReadError> {
        let parsed = self.text(key)?.parse().ok();
        parsed.ok_or_else(|| self.header_error(&format!("a header whose `{key}` is not a number")))
    }

    /// Recordings up to format 2 have no parts.
    fn part_header(&self) -> Result<PartHeader, ReadError> {
        if !self.values.contains_key("part") {
            return Ok(PartHeader::default());
        }
        Ok(PartHeader {
            part: self.number("part")?,
            inputs_before: self.number("inputs_before")?,
            continues: self.values.get("continues").map(|name| (*name).to_owned()),
        })
    }

    fn header_error(&self, what: &str) -> ReadError {
        header_error(self.offset, what)
    }
}

fn header_error(offset: u64, what: &str) -> ReadError {
    ReadError::NoHeader { offset, what: what.to_owned() }
}
