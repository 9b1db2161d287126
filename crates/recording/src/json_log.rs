//! Logs of JSON messages in MCAP, with a JSON Schema for each kind, which Foxglove and PlotJuggler read.
//!
//! The caller gives the texts; this module knows the container only. [`is_json_log`] tells such a file from a recording by the profile in its
//! header.

use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Write};

use mcap::records::{MessageHeader, op};
use mcap::write::NoSeek;

use crate::container::fields;
use crate::container::walk::{RecordScanner, RecordWalker, RecordsEnd, WalkEnd};

const PROFILE: &str = "posebridge.messages";

/// Whether the bytes begin as a log of [`JsonLogWriter`] does.
pub fn is_json_log(beginning: &[u8]) -> bool {
    fields::profile(beginning) == Some(PROFILE)
}

/// Why a log could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JsonLogError {
    #[error("the log of messages could not be written")]
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

/// What of a log could not be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JsonLogDamage {
    /// The first damaged places, with their offsets.
    pub listed: Vec<String>,
    pub count: u64,
}

const MAX_LISTED: usize = 10;

impl JsonLogDamage {
    fn push(&mut self, what: String) {
        self.count += 1;
        if self.listed.len() < MAX_LISTED {
            self.listed.push(what);
        }
    }
}

/// Passes the intact messages in the order of the file until `take` fails. The chunks must have been unpacked
/// ([`unpack_recording`](crate::container::unpack_recording)).
///
/// # Errors
/// That of `take`.
pub fn read_json_log<E>(
    bytes: &[u8],
    mut take: impl FnMut(JsonMessage<'_>) -> Result<(), E>,
) -> Result<JsonLogDamage, E> {
    let mut damage = JsonLogDamage::default();
    let mut channels: BTreeMap<u16, (String, BTreeMap<String, String>)> = BTreeMap::new();
    let Some(records) = RecordScanner::new(bytes) else {
        damage.push("byte 0: this is not an MCAP file".to_owned());
        return Ok(damage);
    };
    let mut walker = RecordWalker::new(records);
    loop {
        let record = match walker.next() {
            Ok(record) => record,
            Err(WalkEnd::Error(error)) => {
                damage.push(error.to_string());
                continue;
            }
            Err(WalkEnd::End(RecordsEnd::Complete)) => return Ok(damage),
            Err(WalkEnd::End(RecordsEnd::Truncated { offset, what })) => {
                damage.push(format!("byte {offset}: the file is cut off here: {what}"));
                return Ok(damage);
            }
            Err(WalkEnd::End(RecordsEnd::Damaged { offset, what })) => {
                damage.push(format!("byte {offset}: {what}; nothing behind it can be read"));
                return Ok(damage);
            }
        };
        let what = match record.opcode {
            op::CHANNEL => {
                let Some(channel) = fields::channel(record.body) else {
                    damage.push(format!("byte {}: a damaged channel", record.offset));
                    continue;
                };
                let metadata = channel.metadata.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
                channels.insert(channel.id, (channel.topic.to_owned(), metadata.collect()));
                continue;
            }
            op::MESSAGE => fields::message(record.body).and_then(|message| {
                let (topic, metadata) = channels.get(&message.channel_id)?;
                Some(JsonMessage { topic, metadata, log_nanos: message.log_time, json: message.data })
            }),
            _ => continue,
        };
        match what {
            Some(message) => take(message)?,
            None => damage.push(format!("byte {}: a message without its channel", record.offset)),
        }
    }
}
