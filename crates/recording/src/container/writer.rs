//! Writes a recording as it happens, so that what was flushed stays readable whatever follows.

use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use posebridge_telemetry::{HostClock, Input, Stamp};

use super::encoding::{self, Place};
use super::{HEADER_RECORD, Header, INPUT_ENCODING, INPUT_TOPIC};

/// The largest chunk of bytes that one input may hold. A read from a link returns at most some kilobytes.
pub(super) const MAX_INPUT_BYTES: usize = 16 << 20;

/// What the schema record says to people who open the file with another program.
const SCHEMA_TEXT: &str = "posebridge.input.v1, little-endian: u8 version = 1; \
    u8 tag (0 bytes, 1 link state, 2 observation, 3 set pose, 4 tick); the tag's fields; \
    u32 CRC-32 over sequence (u32), log time (u64) and all bytes before. See docs/recording-format.md of posebridge.";

/// Why something could not be recorded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The file could not be written, or a write before this one failed.
    #[error("the recording could not be written")]
    Mcap(#[from] mcap::McapError),
    /// What was buffered could not be written out.
    #[error("the recording could not be written out")]
    Flush(#[from] std::io::Error),
    /// An instant before the host clock's zero: MCAP has no negative times.
    #[error("{0:?} lies before the start of the session and cannot be recorded")]
    NegativeTime(Stamp<HostClock>),
    /// A chunk that no link can have returned.
    #[error("a chunk of {0} bytes is more than the 16 MiB that one input may hold")]
    TooLarge(usize),
}

/// Writes the inputs of one session to `W`.
///
/// Bytes are buffered here; [`Writer::flush`] hands them to `W` and flushes `W`. Dropping the writer ends the file as
/// [`Writer::finish`] does, but hides errors.
pub struct Writer<W: Write + Seek> {
    mcap: mcap::Writer<BufWriter<W>>,
    channel_id: u16,
    sequence: u32,
    scratch: Vec<u8>,
}

impl<W: Write + Seek> Writer<W> {
    /// Starts a recording and flushes its header, so that even a session of no inputs leaves a readable file.
    ///
    /// # Errors
    /// When `w` cannot be written.
    pub fn create(w: W, header: &Header) -> Result<Self, WriteError> {
        let mut mcap = mcap::WriteOptions::new()
            .use_chunks(false)
            .profile("")
            .library(format!("posebridge {}", header.program_version))
            .create(BufWriter::new(w))?;
        mcap.write_metadata(&header_record(header))?;
        let schema_id = mcap.add_schema(INPUT_ENCODING, INPUT_ENCODING, SCHEMA_TEXT.as_bytes())?;
        let channel_id =
            mcap.add_channel(schema_id, INPUT_TOPIC, INPUT_ENCODING, &BTreeMap::new())?;
        mcap.flush()?;
        Ok(Self {
            mcap,
            channel_id,
            sequence: 0,
            scratch: Vec::new(),
        })
    }

    /// Records that `input` was given to the pipeline at `now`.
    ///
    /// # Errors
    /// When the file cannot be written, `now` is negative, or a chunk of bytes is longer than 16 MiB. After the first
    /// kind nothing more can be recorded; after the other two only this input is missing.
    pub fn record(&mut self, now: Stamp<HostClock>, input: &Input) -> Result<(), WriteError> {
        let Ok(log_time) = u64::try_from(now.as_nanos()) else {
            return Err(WriteError::NegativeTime(now));
        };
        if let Input::Bytes { bytes, .. } = input
            && bytes.len() > MAX_INPUT_BYTES
        {
            return Err(WriteError::TooLarge(bytes.len()));
        }
        let place = Place {
            sequence: self.sequence,
            log_time,
        };
        self.scratch.clear();
        encoding::encode(input, place, &mut self.scratch);
        let header = MessageHeader {
            channel_id: self.channel_id,
            sequence: self.sequence,
            log_time,
            publish_time: log_time,
        };
        self.mcap.write_to_known_channel(&header, &self.scratch)?;
        self.sequence = self.sequence.wrapping_add(1);
        Ok(())
    }

    /// Hands everything recorded so far to `W` and flushes it: this much survives a crash of the program.
    ///
    /// # Errors
    /// When `W` cannot be written.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        Ok(self.mcap.flush()?)
    }

    /// Ends the file with its summary and gives `W` back.
    ///
    /// # Errors
    /// When `W` cannot be written.
    pub fn finish(mut self) -> Result<W, WriteError> {
        self.mcap.finish()?;
        Ok(self
            .mcap
            .into_inner()
            .into_inner()
            .map_err(IntoInnerError::into_error)?)
    }
}

fn header_record(header: &Header) -> Metadata {
    let links = serde_json::Value::from(header.links.clone()).to_string();
    let entries = [
        ("config_toml", header.config_toml.clone()),
        ("format", header.format.to_string()),
        ("links", links),
        ("program_version", header.program_version.clone()),
        ("utc_start_micros", header.utc_start_micros.to_string()),
    ];
    Metadata {
        name: HEADER_RECORD.to_owned(),
        metadata: entries
            .into_iter()
            .map(|(key, value)| (key.to_owned(), value))
            .collect(),
    }
}
