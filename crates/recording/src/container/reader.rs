//! Reads a recording back, as far as it goes.

use mcap::records::op;
use posebridge_telemetry::{HostClock, Input, Stamp};

use super::encoding::{self, DecodeError, Place};
use super::fields::{self, MESSAGE_HEADER_BYTES};
use super::header;
use super::records::{End, RawRecord, Records};
use super::walk::{Stop, Walk};
use super::{Beginning, FORMAT, Header, INPUT_CHANNEL, INPUT_ENCODING, INPUT_TOPIC, UNCHUNKED};

/// How a recording ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It was finished properly.
    Complete,
    /// It was cut off, by a crash or a full disk; everything before is good.
    Torn {
        /// Byte offset of the first thing that cannot be read.
        offset: u64,
        /// What is missing or wrong there.
        what: String,
    },
}

/// Why a recording, or a part of it, cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The bytes are not an MCAP file.
    #[error("this is not an MCAP file: it does not begin with the MCAP magic")]
    NotMcap,
    /// The header is missing.
    #[error("byte {offset}: the file ends or goes on without a posebridge header: {what}")]
    NoHeader {
        /// Where it should have been.
        offset: u64,
        /// What stands there.
        what: String,
    },
    /// Written by a newer program.
    #[error(
        "the recording has format {found}, this program reads up to {FORMAT}: read it with the program that wrote it"
    )]
    Format {
        /// The format that it claims.
        found: u32,
    },
    /// Another program packed the messages anew.
    #[error("byte {offset}: the messages are compressed ({compression}): write the file again without compression")]
    Compressed {
        /// Where the chunk begins.
        offset: u64,
        /// How it is compressed.
        compression: String,
    },
    /// A chunk is damaged; what is whole in it and behind it follows.
    #[error("byte {offset}: a chunk of the recording is damaged: {what}")]
    Chunk {
        /// Where the damage, or the chunk, begins.
        offset: u64,
        /// What is wrong there.
        what: String,
    },
    /// A sample of the truth is destroyed.
    #[error("byte {offset}: a recorded sample of the truth is damaged: {what}")]
    Truth {
        /// Where its record begins.
        offset: u64,
        /// What is wrong with it.
        what: String,
    },
    /// The framing is destroyed; nothing behind it can be found.
    #[error("byte {offset}: {what}; the recording cannot be read any further")]
    Damaged {
        /// Where.
        offset: u64,
        /// What stands there.
        what: String,
    },
    /// One message is destroyed; the iteration goes on behind it.
    #[error("byte {offset}: a recorded input is damaged: {why}")]
    Message {
        /// Where its record begins.
        offset: u64,
        /// What is wrong with it.
        #[source]
        why: DecodeError,
    },
    /// Messages are missing between the one before and the one at the offset.
    #[error("byte {offset}: input number {expected} should stand here, but number {found} does")]
    Gap {
        /// Where the message behind the gap begins.
        offset: u64,
        /// The number that should have come.
        expected: u32,
        /// The number that came.
        found: u32,
    },
}

/// Reads the inputs of one session, in the order in which they were given: an iterator over `(instant, input)`.
///
/// A torn tail ends the iteration; a damaged chunk or message is an error of its own and the next message follows.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    header: Header,
    beginning: Beginning,
    walk: Walk<'a>,
    channel_id: Option<u16>,
    next_sequence: u32,
    pending: Option<(Stamp<HostClock>, Input)>,
    is_over: bool,
}

impl<'a> Reader<'a> {
    /// Opens a recording that lies in memory and reads its header.
    ///
    /// # Errors
    /// When the bytes are not a recording of ours, or are cut off or damaged before the end of the header.
    pub fn open(bytes: &'a [u8]) -> Result<Self, ReadError> {
        let mut records = Records::new(bytes).ok_or(ReadError::NotMcap)?;
        let (header, beginning) = loop {
            let record = records.next().map_err(no_header)?;
            match record.opcode {
                op::METADATA => {
                    if let Some(found) = header::parse(&record)? {
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
            walk: Walk::from(records),
            channel_id: (header.format > UNCHUNKED).then_some(INPUT_CHANNEL),
            pending: None,
            is_over: false,
            header,
        })
    }

    /// What the recording says about itself.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Where in its session it begins. A replay is that of the session only if no input was given before.
    pub fn beginning(&self) -> &Beginning {
        &self.beginning
    }

    /// How many bytes of the file lie behind the iteration, for progress bars.
    pub fn offset(&self) -> u64 {
        self.walk.offset() as u64
    }

    /// How the file ends; it can be asked at any time and does not move the iteration.
    pub fn ending(&self) -> Ending {
        match self.walk.end() {
            End::Complete => Ending::Complete,
            End::Torn { offset, what } | End::Damaged { offset, what } => {
                Ending::Torn { offset: offset as u64, what: what.to_owned() }
            }
        }
    }

    /// The records behind the header.
    pub(super) fn into_walk(self) -> Walk<'a> {
        self.walk
    }

    /// Takes one message record apart; `None` when it belongs to another channel.
    fn message(&mut self, record: &RawRecord<'a>) -> Option<Result<(Stamp<HostClock>, Input), ReadError>> {
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
        let believed = if decoded.is_ok() { found } else { expected };
        self.next_sequence = believed.wrapping_add(1);
        let given = match decoded {
            Ok(given) => given,
            Err(why) => return Some(Err(ReadError::Message { offset, why })),
        };
        if found == expected {
            return Some(Ok(given));
        }
        self.pending = Some(given);
        Some(Err(ReadError::Gap { offset, expected, found }))
    }

    /// The input of a message, and when it was given.
    fn decode(&self, message: &fields::Message<'_>) -> Result<(Stamp<HostClock>, Input), DecodeError> {
        let since_start = message.log_time.checked_sub(header::zero_nanos(&self.header));
        let log_time = since_start.ok_or(DecodeError::Time(message.log_time))?;
        let place = Place { sequence: message.sequence, log_time };
        let input = encoding::decode(message.data, place)?;
        // What decodes has a time within the range of a stamp.
        Ok((Stamp::from_nanos(log_time as i64), input))
    }

    fn note_channel(&mut self, record: &RawRecord<'_>) {
        if let Some(channel) = fields::channel(record.body)
            && channel.topic == INPUT_TOPIC
            && channel.message_encoding == INPUT_ENCODING
        {
            self.channel_id = Some(channel.id);
        }
    }

    /// What follows from where the walk stopped.
    fn stopped(&mut self, stop: Stop) -> Option<ReadError> {
        match stop {
            Stop::Defect(defect) => {
                self.is_over = matches!(defect, ReadError::Compressed { .. });
                Some(defect)
            }
            Stop::End(end) => {
                self.is_over = true;
                let End::Damaged { offset, what } = end else {
                    return None;
                };
                Some(ReadError::Damaged { offset: offset as u64, what: what.to_owned() })
            }
        }
    }
}

impl Iterator for Reader<'_> {
    type Item = Result<(Stamp<HostClock>, Input), ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(item) = self.pending.take() {
            return Some(Ok(item));
        }
        while !self.is_over {
            let record = match self.walk.next() {
                Ok(record) => record,
                Err(stop) => return self.stopped(stop).map(Err),
            };
            match record.opcode {
                op::MESSAGE if self.channel_id.is_none() => {
                    // Our channel is written before any message: its record is damaged, and nothing can be told apart.
                    self.is_over = true;
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
                op::CHANNEL => self.note_channel(&record),
                _ => {}
            }
        }
        None
    }
}

fn no_header(end: End) -> ReadError {
    match end {
        End::Complete => ReadError::NoHeader {
            offset: 0,
            what: "the file is whole, but it was not written by posebridge".to_owned(),
        },
        End::Torn { offset, what } | End::Damaged { offset, what } => {
            ReadError::NoHeader { offset: offset as u64, what: what.to_owned() }
        }
    }
}
