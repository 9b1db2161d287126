//! Writes the messages of a bag to an MCAP file as rosbag2 does.

use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Write};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use posebridge_telemetry::{Event, HostClock, Timestamp};

use super::encoder::{RosEncoder, RosMessage};
use super::metadata::{BagContents, QOS_PROFILES};

/// The last start of a session whose stamps fit into the 32 bits of `builtin_interfaces/Time`: 2038-01-19.
const LATEST_START_MICROS: u64 = i32::MAX as u64 * 1_000_000;

/// Why a bag could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RosBagError {
    #[error("the bag could not be written")]
    Mcap(#[from] mcap::McapError),
    #[error("the bag could not be written out")]
    Flush(#[from] std::io::Error),
    /// MCAP has no negative times.
    #[error("{0:?} lies before the start of the session and cannot be written")]
    NegativeTime(Timestamp<HostClock>),
    #[error("a session that starts {0} µs after 1970, beyond the year 2038, does not fit into the time of ROS 2")]
    StartTime(u64),
}

/// Writes the events of one session to `W` as a bag.
///
/// Dropping the writer ends the file as [`RosBagWriter::finish`] does, but hides errors.
pub struct RosBagWriter<W: Write> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
    /// UTC of the host clock's zero.
    zero_nanos: u64,
    encoder: RosEncoder,
    /// By topic; each is created with its first message.
    channels: BTreeMap<String, u16>,
    contents: BagContents,
}

impl<W: Write> RosBagWriter<W> {
    /// `utc_start_micros` is the Unix time of the host clock's zero.
    ///
    /// # Errors
    /// Writing failed, or the session starts after the year 2038.
    pub fn create(w: W, utc_start_micros: u64) -> Result<Self, RosBagError> {
        if utc_start_micros > LATEST_START_MICROS {
            return Err(RosBagError::StartTime(utc_start_micros));
        }
        let mcap = mcap::WriteOptions::new()
            .compression(None)
            .disable_seeking(true)
            .profile("ros2")
            .library(concat!("posebridge ", env!("CARGO_PKG_VERSION")))
            .create(NoSeek::new(BufWriter::new(w)))?;
        let zero_nanos = utc_start_micros * 1_000;
        Ok(Self {
            mcap,
            zero_nanos,
            encoder: RosEncoder::new(zero_nanos),
            channels: BTreeMap::new(),
            contents: BagContents::default(),
        })
    }

    /// Writes what the event means to ROS, if anything; `now` is its arrival.
    ///
    /// # Errors
    /// Writing failed, or `now` is negative.
    pub fn record(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<(), RosBagError> {
        let since = u64::try_from(now.as_nanos()).ok().ok_or(RosBagError::NegativeTime(now))?;
        let time = self.zero_nanos + since;
        for message in self.encoder.encode(now, event) {
            let channel_id = self.channel(&message)?;
            // rosbag2 counts nothing here.
            let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
            self.mcap.write_to_known_channel(&header, &message.data)?;
            self.contents.count(time, &message.topic, message.message_type.name);
        }
        Ok(())
    }

    /// Ends the chunk, writes everything to `W` and flushes it: all messages until here survive a crash of the program.
    ///
    /// # Errors
    /// Writing failed, now or before.
    pub fn flush(&mut self) -> Result<(), RosBagError> {
        Ok(self.mcap.flush()?)
    }

    /// Messages written so far.
    pub fn messages(&self) -> u64 {
        self.contents.messages()
    }

    /// The text of `metadata.yaml`, which the players of rosbag2 want beside the file: of the messages so far, in one file of this name.
    pub fn metadata(&self, file: &str) -> String {
        self.contents.to_yaml(file)
    }

    /// Ends the file with its summary; returns `W` and the number of messages.
    ///
    /// # Errors
    /// Writing failed, now or before.
    pub fn finish(mut self) -> Result<(W, u64), RosBagError> {
        self.mcap.finish()?;
        let messages = self.messages();
        let buffered = self.mcap.into_inner().into_inner();
        Ok((buffered.into_inner().map_err(IntoInnerError::into_error)?, messages))
    }

    fn channel(&mut self, message: &RosMessage) -> Result<u16, RosBagError> {
        if let Some(id) = self.channels.get(&message.topic) {
            return Ok(*id);
        }
        let message_type = message.message_type;
        let schema_id = self.mcap.add_schema(message_type.name, "ros2msg", message_type.schema().as_bytes())?;
        let metadata = [("offered_qos_profiles", QOS_PROFILES), ("topic_type_hash", message_type.hash)];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let id = self.mcap.add_channel(schema_id, &message.topic, "cdr", &metadata)?;
        self.channels.insert(message.topic.clone(), id);
        Ok(id)
    }
}
