//! Reads a recording, up to its end or the first damage that cannot be skipped; and the true poses of simulated robots that are stored
//! beside the inputs, for scores and figures.

use mcap::records::op;
use posebridge_telemetry::{
    Address, Arena, BrickClock, Heading, HostClock, Input, LinkId, Meters, Pose, RobotId, Timestamp,
};
use serde::Deserialize;

use super::encoding::{self, DecodeError, RecordPosition};
use super::fields::{self, MESSAGE_HEADER_BYTES};
use super::walk::{RawRecord, RecordScanner, RecordWalker, RecordsEnd, WalkEnd};
use super::{
    INPUT_CHANNEL, INPUT_ENCODING, INPUT_TOPIC, LAST_UNCHUNKED_FORMAT, PartHeader, ReadError, RecordingHeader,
    TRUTH_TOPIC, parse_header, zero_nanos,
};
use crate::json_log::is_json_log;

/// How a recording ends: complete or truncated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RecordingEnd {
    Complete,
    /// Truncated by a crash or a full disk; everything before is valid.
    Truncated {
        /// Byte offset of the first unreadable record.
        offset: u64,
        /// What is missing or invalid there.
        what: String,
    },
}

/// Reads the inputs of one session in order: an iterator over `(instant, input)`.
///
/// A truncated end stops the iteration; a damaged chunk or message is an error item, and the next message follows.
#[derive(Clone, Debug)]
pub struct RecordingReader<'a> {
    header: RecordingHeader,
    beginning: PartHeader,
    walker: RecordWalker<'a>,
    channel_id: Option<u16>,
    next_sequence: u32,
    pending: Option<(Timestamp<HostClock>, Input)>,
    is_finished: bool,
}

impl<'a> RecordingReader<'a> {
    /// Opens a recording in memory and reads its header.
    ///
    /// # Errors
    /// The bytes are not a posebridge recording, or are truncated or damaged before the end of the header.
    pub fn open(bytes: &'a [u8]) -> Result<Self, ReadError> {
        let mut records = RecordScanner::new(bytes).ok_or(ReadError::NotMcap)?;
        if is_json_log(bytes) {
            return Err(ReadError::Messages);
        }
        let (header, beginning) = loop {
            let record = records.next().map_err(missing_header_error)?;
            match record.opcode {
                op::METADATA => {
                    if let Some(found) = parse_header(record.offset as u64, record.body)? {
                        break found;
                    }
                }
                op::MESSAGE | op::CHUNK | op::DATA_END => {
                    return Err(ReadError::NoHeader {
                        offset: record.offset as u64,
                        what: "messages begin here; it was not written by posebridge".to_owned(),
                    });
                }
                _ => {}
            }
        };
        Ok(Self {
            // The number of an input is that of a session, cut to 32 bits.
            next_sequence: beginning.inputs_before as u32,
            beginning,
            walker: RecordWalker::new(records),
            channel_id: (header.format > LAST_UNCHUNKED_FORMAT).then_some(INPUT_CHANNEL),
            pending: None,
            is_finished: false,
            header,
        })
    }

    pub fn header(&self) -> &RecordingHeader {
        &self.header
    }

    /// A replay reproduces the session only if `inputs_before` is 0.
    pub fn part_header(&self) -> &PartHeader {
        &self.beginning
    }

    /// Bytes read so far, for progress bars.
    pub fn offset(&self) -> u64 {
        self.walker.offset() as u64
    }

    /// Bytes of the file.
    pub const fn size(&self) -> u64 {
        self.walker.size() as u64
    }

    /// How the file ends. Callable at any time; does not advance the iteration.
    pub fn recording_end(&self) -> RecordingEnd {
        match self.walker.end() {
            RecordsEnd::Complete => RecordingEnd::Complete,
            RecordsEnd::Truncated { offset, what } | RecordsEnd::Damaged { offset, what } => {
                RecordingEnd::Truncated { offset: offset as u64, what: what.to_owned() }
            }
        }
    }

    /// Decodes a message record; `None` for other channels.
    fn message(&mut self, record: &RawRecord<'a>) -> Option<Result<(Timestamp<HostClock>, Input), ReadError>> {
        let offset = record.offset as u64;
        let Some(message) = fields::message(record.body) else {
            let (wanted, left) = (MESSAGE_HEADER_BYTES, record.body.len());
            let why = DecodeError::TooShort { wanted, left };
            return Some(Err(ReadError::Message { offset, why }));
        };
        if Some(message.channel_id) != self.channel_id {
            return None;
        }
        let (expected, found) = (self.next_sequence, message.sequence);
        let decoded = self.decode(&message);
        // A damaged number cannot be trusted to go on from: count on as if it had been right.
        let verified = if decoded.is_ok() { found } else { expected };
        self.next_sequence = verified.wrapping_add(1);
        let timed_input = match decoded {
            Ok(timed_input) => timed_input,
            Err(why) => return Some(Err(ReadError::Message { offset, why })),
        };
        if found == expected {
            return Some(Ok(timed_input));
        }
        self.pending = Some(timed_input);
        Some(Err(ReadError::Gap { offset, expected, found }))
    }

    fn decode(&self, message: &fields::Message<'_>) -> Result<(Timestamp<HostClock>, Input), DecodeError> {
        let since_start = message.log_time.checked_sub(zero_nanos(&self.header));
        let log_time = since_start.ok_or(DecodeError::Time(message.log_time))?;
        let position = RecordPosition { sequence: message.sequence, log_time };
        let input = encoding::decode(message.data, position)?;
        // What decodes has a time within the range of a stamp.
        Ok((Timestamp::from_nanos(log_time as i64), input))
    }

    fn register_channel(&mut self, record: &RawRecord<'_>) {
        if let Some(channel) = fields::channel(record.body)
            && channel.topic == INPUT_TOPIC
            && channel.message_encoding == INPUT_ENCODING
        {
            self.channel_id = Some(channel.id);
        }
    }

    fn finish(&mut self, stop: WalkEnd) -> Option<ReadError> {
        match stop {
            WalkEnd::Error(defect) => {
                self.is_finished = matches!(defect, ReadError::Compressed { .. });
                Some(defect)
            }
            WalkEnd::End(end) => {
                self.is_finished = true;
                let RecordsEnd::Damaged { offset, what } = end else {
                    return None;
                };
                Some(ReadError::Damaged { offset: offset as u64, what: what.to_owned() })
            }
        }
    }
}

impl Iterator for RecordingReader<'_> {
    type Item = Result<(Timestamp<HostClock>, Input), ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(item) = self.pending.take() {
            return Some(Ok(item));
        }
        while !self.is_finished {
            let record = match self.walker.next() {
                Ok(record) => record,
                Err(stop) => return self.finish(stop).map(Err),
            };
            match record.opcode {
                op::MESSAGE if self.channel_id.is_none() => {
                    // Our channel is written before any message: its record is damaged, and nothing can be told apart.
                    self.is_finished = true;
                    return Some(Err(ReadError::Damaged {
                        offset: record.offset as u64,
                        what: "messages without the record of their channel".to_owned(),
                    }));
                }
                op::MESSAGE => {
                    if let Some(item) = self.message(&record) {
                        return Some(item);
                    }
                }
                op::CHANNEL => self.register_channel(&record),
                _ => {}
            }
        }
        None
    }
}

fn missing_header_error(end: RecordsEnd) -> ReadError {
    match end {
        RecordsEnd::Complete => ReadError::NoHeader {
            offset: 0,
            what: "the file is whole, but it was not written by posebridge".to_owned(),
        },
        RecordsEnd::Truncated { offset, what } | RecordsEnd::Damaged { offset, what } => {
            ReadError::NoHeader { offset: offset as u64, what: what.to_owned() }
        }
    }
}

/// A robot's true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// `None` for the only simulated robot.
    pub robot: Option<RobotId>,
    /// Brick time, without rounding or register wraps.
    pub time: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// The brick's dead reckoning from the start pose.
    pub odometry: Option<Pose<Arena>>,
}

/// A message on [`TRUTH_TOPIC`].
#[derive(Deserialize)]
struct TruthJson {
    link: Option<u16>,
    system: Option<u8>,
    component: Option<u8>,
    brick_nanos: i64,
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    odometry_x_m: Option<f64>,
    odometry_y_m: Option<f64>,
    odometry_heading_rad: Option<f64>,
}

impl TruthJson {
    fn sample(&self) -> Result<TruthSample, &'static str> {
        let pose = |x_m, y_m, heading_rad| Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad));
        let odometry = (self.odometry_x_m, self.odometry_y_m, self.odometry_heading_rad);
        Ok(TruthSample {
            robot: self.robot()?,
            time: Timestamp::from_nanos(self.brick_nanos),
            pose: pose(self.x_m, self.y_m, self.heading_rad),
            odometry: match odometry {
                (Some(x_m), Some(y_m), Some(heading_rad)) => Some(pose(x_m, y_m, heading_rad)),
                _ => None,
            },
        })
    }

    /// Fails if an id is missing: the sample would be assigned to another robot.
    fn robot(&self) -> Result<Option<RobotId>, &'static str> {
        match (self.link, self.system, self.component) {
            (None, None, None) => Ok(None),
            (Some(link), Some(system), Some(component)) => {
                Ok(Some(RobotId { link: LinkId(link), address: Address::new(system, component) }))
            }
            _ => Err("it has some of `link`, `system` and `component`, but only all three say which robot it is of"),
        }
    }
}

/// The ground truth in a recording, sorted by each robot's own time; empty if there is none, as for real robots.
///
/// It is written during the run: a truncated recording contains none or only the beginning.
///
/// # Errors
/// The bytes are not a posebridge recording, or a truth sample is damaged or has an incomplete robot id. Damage elsewhere is ignored.
pub fn read_truth(bytes: &[u8]) -> Result<Vec<TruthSample>, ReadError> {
    let mut walk = RecordingReader::open(bytes)?.walker;
    let mut channel_id = None;
    let mut samples = Vec::new();
    loop {
        let record = match walk.next() {
            Ok(record) => record,
            Err(WalkEnd::Error(_)) => continue,
            Err(WalkEnd::End(_)) => break,
        };
        match record.opcode {
            op::CHANNEL => {
                let channel = fields::channel(record.body);
                if let Some(channel) = channel.filter(|channel| channel.topic == TRUTH_TOPIC) {
                    channel_id = Some(channel.id);
                }
            }
            op::MESSAGE if channel_id.is_some() => {
                let message = fields::message(record.body);
                let Some(message) = message.filter(|one| Some(one.channel_id) == channel_id) else {
                    continue;
                };
                let line = serde_json::from_slice::<TruthJson>(message.data).map_err(|error| error.to_string());
                let sample = line.and_then(|line| line.sample().map_err(str::to_owned));
                samples.push(sample.map_err(|what| ReadError::Truth { offset: record.offset as u64, what })?);
            }
            _ => {}
        }
    }
    samples.sort_by_key(|sample| sample.time);
    Ok(samples)
}
