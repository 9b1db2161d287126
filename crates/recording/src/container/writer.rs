//! Writes a recording so that flushed data stays readable after any failure.

use std::collections::BTreeMap;
use std::io::{BufWriter, IntoInnerError, Write};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use posebridge_telemetry::{Calibration, Event, HostClock, Input, RobotId, StationInput, TimeDelta, Timestamp};

use super::encoding::{self, RecordPosition};
use super::{
    INPUT_ENCODING, INPUT_TOPIC, LATEST_START_MICROS, PartHeader, RecordingGap, RecordingHeader, TruthSample,
    metadata_record, zero_nanos,
};
use crate::foxglove::{self, ChannelKey, EncodedMessage, OutputEncoder};

/// Limit of the bytes of one input. A read from a link returns at most some kilobytes.
pub(super) const MAX_INPUT_BYTES: usize = 16 << 20;

/// Size at which a chunk is written, in bytes: more than a second of a typical session. Allocated at the start; during a change of
/// parts there are two such buffers.
const CHUNK_BYTES: u64 = 96 << 10;

/// Default minimum interval between stored estimates: ten a second suffice for viewers, and an hour of all estimates takes some hundred
/// megabytes.
const OUTPUT_SPACING: TimeDelta = TimeDelta::from_millis(100);

/// Schema text for readers of the file with other programs.
const SCHEMA_TEXT: &str = "posebridge.input.v1, little-endian: u8 version; \
    u8 tag (0 bytes, 1 link state, 2 observation, 3 set pose, 4 tick, 5 bytes of a peer, 6 counts of a port); the tag's fields; \
    u32 CRC-32 over sequence (u32), time since the start of the session in nanoseconds (u64) and all bytes before. \
    See docs/recording-format.md of posebridge.";

/// Why recording failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// Writing failed, now or before.
    #[error("the recording could not be written")]
    Mcap(#[from] mcap::McapError),
    #[error("the recording could not be written out")]
    Flush(#[from] std::io::Error),
    /// MCAP has no negative times.
    #[error("{0:?} lies before the start of the session and cannot be recorded")]
    NegativeTime(Timestamp<HostClock>),
    /// More bytes than a link can return.
    #[error("a chunk of {0} bytes is more than the 16 MiB that one input may hold")]
    TooLarge(usize),
    #[error("a session that starts {0} µs after 1970, beyond the year 2262, cannot be recorded")]
    StartTime(u64),
}

/// Writes the inputs of one session to `W`, and the outputs beside them.
///
/// Bytes are buffered; [`RecordingWriter::flush`] ends the chunk, writes everything to `W` and flushes `W`. Dropping the writer ends
/// the file as [`RecordingWriter::finish`] does, but hides errors.
pub struct RecordingWriter<W: Write> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
    /// UTC of the host clock's zero.
    zero_nanos: u64,
    input_channel: u16,
    sequence: u32,
    /// Output channels; each is created with its first message.
    output_channels: BTreeMap<ChannelKey, OutputChannel>,
    outputs: OutputEncoder,
    scratch: Vec<u8>,
}

/// State that the writer of one part passes to that of the next: topics of the robots, clock alignments, paths, and the interval
/// between estimates.
pub struct OutputHandover(Box<OutputEncoder>);

#[derive(Clone, Copy)]
struct OutputChannel {
    id: u16,
    sequence: u32,
}

impl<W: Write> RecordingWriter<W> {
    /// Starts the recording of a session and flushes its header, so that a session without inputs leaves a readable file.
    pub fn create(w: W, header: &RecordingHeader) -> Result<Self, WriteError> {
        Self::create_part(w, header, &PartHeader::default())
    }

    /// Starts a recording within a session, or one of its parts; flushes its header.
    pub fn create_part(w: W, header: &RecordingHeader, part_header: &PartHeader) -> Result<Self, WriteError> {
        if header.utc_start_micros > LATEST_START_MICROS {
            return Err(WriteError::StartTime(header.utc_start_micros));
        }
        let mut mcap = mcap::WriteOptions::new()
            .chunk_size(Some(CHUNK_BYTES))
            .compression(None)
            // A chunk is written in one go: a killed program leaves no half of one that was not flushed.
            .disable_seeking(true)
            .profile("")
            .library(format!("posebridge {}", header.program_version))
            .create(NoSeek::new(BufWriter::new(w)))?;
        mcap.write_metadata(&metadata_record(header, part_header))?;
        let schema_id = mcap.add_schema(INPUT_ENCODING, INPUT_ENCODING, SCHEMA_TEXT.as_bytes())?;
        let input_channel = mcap.add_channel(schema_id, INPUT_TOPIC, INPUT_ENCODING, &BTreeMap::new())?;
        mcap.flush()?;
        let zero_nanos = zero_nanos(header);
        Ok(Self {
            mcap,
            zero_nanos,
            input_channel,
            // The number of an input is that of a session, cut to 32 bits.
            sequence: part_header.inputs_before as u32,
            output_channels: BTreeMap::new(),
            outputs: OutputEncoder::new(zero_nanos, OUTPUT_SPACING),
            scratch: Vec::new(),
        })
    }

    /// Sets the minimum interval between stored estimates of a robot, and between fusions of one sensor and kind; zero stores all.
    pub fn set_output_spacing(&mut self, spacing: TimeDelta) {
        self.outputs.set_spacing(spacing);
    }

    /// Number of dropped events, calibrations and true poses, in this and earlier parts: only 64 robots have topics.
    pub const fn skipped_outputs(&self) -> u64 {
        self.outputs.skipped()
    }

    /// Ends the file as [`Self::finish`] does and returns the state for the next part.
    pub fn finish_part(mut self) -> Result<OutputHandover, WriteError> {
        let fresh = OutputEncoder::new(self.zero_nanos, OUTPUT_SPACING);
        let outputs = std::mem::replace(&mut self.outputs, fresh);
        self.finish()?;
        Ok(OutputHandover(Box::new(outputs)))
    }

    /// Continues with the state of the previous part.
    pub fn restore_outputs(&mut self, state: OutputHandover) {
        self.outputs = *state.0;
    }

    /// Records an input of the pipeline at `now`, and a command also as an output.
    ///
    /// # Errors
    /// Writing failed, `now` is negative, or the input has more than 16 MiB. After a write error recording is over; after the others
    /// only this input is missing.
    pub fn record(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<(), WriteError> {
        let log_time = log_time_nanos(now)?;
        if let Input::Bytes { bytes, .. } = input
            && bytes.len() > MAX_INPUT_BYTES
        {
            return Err(WriteError::TooLarge(bytes.len()));
        }
        let position = RecordPosition { sequence: self.sequence, log_time };
        self.scratch.clear();
        encoding::encode(input, position, &mut self.scratch);
        let header = MessageHeader {
            channel_id: self.input_channel,
            sequence: self.sequence,
            log_time: self.zero_nanos + log_time,
            publish_time: self.zero_nanos + log_time,
        };
        self.mcap.write_to_known_channel(&header, &self.scratch)?;
        self.sequence = self.sequence.wrapping_add(1);
        let message = match input {
            Input::Command(command) | Input::OfStation { input: StationInput::Command(command), .. } => {
                Some(foxglove::command_message(command, None))
            }
            Input::RobotCommand { robot, command } => Some(foxglove::command_message(command, Some(*robot))),
            Input::Bytes { .. }
            | Input::Port { .. }
            | Input::Link { .. }
            | Input::PeerAddress { .. }
            | Input::Observation(_)
            | Input::Ownership { .. }
            | Input::OutsideFix { .. }
            | Input::Report { .. }
            | Input::Tick
            | Input::OfStation { input: StationInput::Report { .. } | StationInput::Tick, .. } => None,
        };
        self.write_messages(now, message)
    }

    /// Records an output of the pipeline at `now`, for viewers; replays ignore it.
    pub fn record_event(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<(), WriteError> {
        let messages = self.outputs.encode_event(now, event);
        self.write_messages(now, messages)
    }

    /// Records the filter's estimated constants of a robot at `now`, for viewers; `None` is the first robot.
    pub fn record_calibration(
        &mut self,
        now: Timestamp<HostClock>,
        robot: Option<RobotId>,
        calibration: &Calibration,
    ) -> Result<(), WriteError> {
        let messages = self.outputs.calibration_messages(robot, calibration);
        self.write_messages(now, messages)
    }

    /// Records a log line with its MAVLink severity: 0 emergency to 7 debug.
    pub fn record_log_message(
        &mut self,
        now: Timestamp<HostClock>,
        severity: u8,
        text: &str,
    ) -> Result<(), WriteError> {
        let line = self.outputs.log_message(now, severity, "station", text);
        self.write_messages(now, [line])
    }

    /// Marks missing inputs. The next input gets the sequence number that it would have had.
    ///
    /// # Errors
    /// Writing failed, or the gap ends before the start of the session.
    pub fn record_gap(&mut self, gap: &RecordingGap) -> Result<(), WriteError> {
        self.write_messages(gap.to, [foxglove::gap_message(gap)])?;
        // Numbers are cut to 32 bits.
        self.sequence = self.sequence.wrapping_add(gap.inputs as u32);
        let text = format!(
            "{} inputs are missing: the disk was too slow; a replay is not that of the session any more",
            gap.inputs
        );
        self.record_log_message(gap.to, 3, &text)
    }

    /// Records true poses of simulated robots. A sample without a clock alignment is stored at `now`.
    pub fn record_truth(&mut self, now: Timestamp<HostClock>, samples: &[TruthSample]) -> Result<(), WriteError> {
        for sample in samples {
            let (at, messages) = self.outputs.truth_messages(now, sample);
            self.write_messages(at, messages)?;
        }
        Ok(())
    }

    /// Ends the chunk, writes everything to `W` and flushes it: all data until here survives a crash of the program.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        Ok(self.mcap.flush()?)
    }

    /// Ends the file with its summary and returns `W`.
    pub fn finish(mut self) -> Result<W, WriteError> {
        self.mcap.finish()?;
        let buffered = self.mcap.into_inner().into_inner();
        Ok(buffered.into_inner().map_err(IntoInnerError::into_error)?)
    }

    fn write_messages(
        &mut self,
        at: Timestamp<HostClock>,
        messages: impl IntoIterator<Item = EncodedMessage>,
    ) -> Result<(), WriteError> {
        let time = self.zero_nanos + log_time_nanos(at)?;
        for message in messages {
            let key = message.key();
            let beside = match self.output_channels.get(&key) {
                Some(beside) => *beside,
                None => self.open_channel(&message)?,
            };
            let header =
                MessageHeader { channel_id: beside.id, sequence: beside.sequence, log_time: time, publish_time: time };
            self.mcap.write_to_known_channel(&header, &message.data)?;
            let sequence = beside.sequence.wrapping_add(1);
            self.output_channels.insert(key, OutputChannel { sequence, ..beside });
        }
        Ok(())
    }

    fn open_channel(&mut self, message: &EncodedMessage) -> Result<OutputChannel, WriteError> {
        let channel = message.channel;
        let (encoding, schema_encoding, schema) = channel.encoding.parts();
        let schema_id = self.mcap.add_schema(channel.schema, schema_encoding, &schema)?;
        let id = self.mcap.add_channel(schema_id, &message.topic(), encoding, &BTreeMap::new())?;
        Ok(OutputChannel { id, sequence: 0 })
    }
}

fn log_time_nanos(at: Timestamp<HostClock>) -> Result<u64, WriteError> {
    u64::try_from(at.as_nanos()).ok().ok_or(WriteError::NegativeTime(at))
}
