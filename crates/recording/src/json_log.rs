//! Logs of JSON messages in MCAP, with a JSON Schema for each kind, which Foxglove and PlotJuggler read.
//!
//! The caller gives the texts; this module knows the container only. [`is_json_log`] tells such a file from a recording by the profile in its
//! header.

use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Write};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;

/// Of the MCAP header.
const PROFILE: &str = "posebridge.messages";
/// Magic of the file, then the header record: its opcode, its length (u64), the length of the profile (u32).
const PROFILE_AT: usize = 8 + 1 + 8 + 4;

/// Whether the bytes begin as a log of [`JsonLogWriter`] does.
pub fn is_json_log(beginning: &[u8]) -> bool {
    beginning.get(PROFILE_AT..).is_some_and(|rest| rest.starts_with(PROFILE.as_bytes()))
}

/// Why a log could not be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JsonLogError {
    #[error("the log of messages is damaged or could not be written")]
    Mcap(#[from] mcap::McapError),
    #[error("the log of messages could not be written out")]
    Flush(#[from] std::io::Error),
}

/// What the messages of a channel have in common.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JsonChannel {
    pub topic: String,
    /// Name of the schema.
    pub kind: String,
    pub schema: String,
    pub metadata: BTreeMap<String, String>,
}

/// Number of a channel in its log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JsonChannelId(u16);

/// Writes messages to `W`.
///
/// Dropping the writer ends the file as [`JsonLogWriter::finish`] does, but hides errors.
pub struct JsonLogWriter<W: Write> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
}

impl<W: Write> JsonLogWriter<W> {
    /// # Errors
    /// Writing failed.
    pub fn create(w: W) -> Result<Self, JsonLogError> {
        let mcap = mcap::WriteOptions::new()
            .compression(None)
            .disable_seeking(true)
            .profile(PROFILE)
            .library(concat!("posebridge ", env!("CARGO_PKG_VERSION")))
            .create(NoSeek::new(BufWriter::new(w)))?;
        Ok(Self { mcap })
    }

    /// Channels of one kind share its schema.
    ///
    /// # Errors
    /// Writing failed.
    pub fn add_channel(&mut self, channel: &JsonChannel) -> Result<JsonChannelId, JsonLogError> {
        let schema = self.mcap.add_schema(&channel.kind, "jsonschema", channel.schema.as_bytes())?;
        Ok(JsonChannelId(self.mcap.add_channel(schema, &channel.topic, "json", &channel.metadata)?))
    }

    /// # Errors
    /// Writing failed.
    pub fn write(
        &mut self,
        channel: JsonChannelId,
        log_nanos: u64,
        sequence: u32,
        json: &str,
    ) -> Result<(), JsonLogError> {
        let header = MessageHeader { channel_id: channel.0, sequence, log_time: log_nanos, publish_time: log_nanos };
        Ok(self.mcap.write_to_known_channel(&header, json.as_bytes())?)
    }

    /// Ends the file with its summary.
    ///
    /// # Errors
    /// Writing failed, now or before.
    pub fn finish(mut self) -> Result<W, JsonLogError> {
        self.mcap.finish()?;
        let buffered = self.mcap.into_inner().into_inner();
        Ok(buffered.into_inner().map_err(IntoInnerError::into_error)?)
    }
}

/// A message of a log, with what its channel says.
#[derive(Clone, Copy, Debug)]
pub struct JsonMessage<'a> {
    pub topic: &'a str,
    pub metadata: &'a BTreeMap<String, String>,
    pub log_nanos: u64,
    pub json: &'a [u8],
}

/// Passes the messages in the order of the file until `take` fails.
///
/// # Errors
/// The file is damaged, or that of `take`.
pub fn read_json_log<E: From<JsonLogError>>(
    bytes: &[u8],
    mut take: impl FnMut(JsonMessage<'_>) -> Result<(), E>,
) -> Result<(), E> {
    for message in mcap::MessageStream::new(bytes).map_err(JsonLogError::Mcap)? {
        let message = message.map_err(JsonLogError::Mcap)?;
        take(JsonMessage {
            topic: &message.channel.topic,
            metadata: &message.channel.metadata,
            log_nanos: message.log_time,
            json: &message.data,
        })?;
    }
    Ok(())
}
