//! Reads a recording back, as far as it goes.

use mcap::records::op;
use posebridge_telemetry::{HostClock, Input, Stamp};

use super::encoding::{self, DecodeError, Place};
use super::fields::{self, Metadata};
use super::records::{End, RawRecord, Records};
use super::{FORMAT, HEADER_RECORD, Header, INPUT_ENCODING, INPUT_TOPIC};

/// Channel (2), sequence (4), log time (8) and publish time (8) stand before a message's data.
const MESSAGE_HEADER_BYTES: usize = 22;

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
    /// Another program packed the messages into chunks.
    #[error(
        "byte {offset}: the messages are packed in chunks: write the file again without chunks and compression"
    )]
    Chunked {
        /// Where the chunk begins.
        offset: u64,
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
/// A torn tail ends the iteration; a damaged message is an error of its own and the next one follows.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    header: Header,
    records: Records<'a>,
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
        let header = loop {
            let record = records.next().map_err(no_header)?;
            match record.opcode {
                op::METADATA => {
                    if let Some(header) = parse_header(&record)? {
                        break header;
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
            header,
            records,
            channel_id: None,
            next_sequence: 0,
            pending: None,
            is_over: false,
        })
    }

    /// What the recording says about itself.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How the file ends; it can be asked at any time and does not move the iteration.
    pub fn ending(&self) -> Ending {
        match self.records.clone().end() {
            End::Complete => Ending::Complete,
            End::Torn { offset, what } | End::Damaged { offset, what } => Ending::Torn {
                offset: offset as u64,
                what: what.to_owned(),
            },
        }
    }

    /// Takes one message record apart; `None` when it belongs to another channel.
    fn message(
        &mut self,
        record: &RawRecord<'a>,
    ) -> Option<Result<(Stamp<HostClock>, Input), ReadError>> {
        let offset = record.offset as u64;
        let Some((head, data)) = record.body.split_first_chunk::<MESSAGE_HEADER_BYTES>() else {
            let (wanted, left) = (MESSAGE_HEADER_BYTES, record.body.len());
            let why = DecodeError::TooShort { wanted, left };
            return Some(Err(ReadError::Message { offset, why }));
        };
        let [c0, c1, s0, s1, s2, s3, rest @ ..] = *head;
        if Some(u16::from_le_bytes([c0, c1])) != self.channel_id {
            return None;
        }
        let [t0, t1, t2, t3, t4, t5, t6, t7, ..] = rest;
        let place = Place {
            sequence: u32::from_le_bytes([s0, s1, s2, s3]),
            log_time: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
        };
        let expected = self.next_sequence;
        let decoded = encoding::decode(data, place);
        // A damaged number cannot be trusted to go on from: count on as if it had been right.
        let believed = if decoded.is_ok() {
            place.sequence
        } else {
            expected
        };
        self.next_sequence = believed.wrapping_add(1);
        let input = match decoded {
            Ok(input) => input,
            Err(why) => return Some(Err(ReadError::Message { offset, why })),
        };
        // What decodes has a time within the range of a stamp.
        let now = Stamp::from_nanos(place.log_time as i64);
        if place.sequence == expected {
            return Some(Ok((now, input)));
        }
        self.pending = Some((now, input));
        Some(Err(ReadError::Gap {
            offset,
            expected,
            found: place.sequence,
        }))
    }

    fn note_channel(&mut self, record: &RawRecord<'_>) {
        if let Some(channel) = fields::channel(record.body)
            && channel.topic == INPUT_TOPIC
            && channel.message_encoding == INPUT_ENCODING
        {
            self.channel_id = Some(channel.id);
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
            let record = match self.records.next() {
                Ok(record) => record,
                Err(end) => {
                    self.is_over = true;
                    return match end {
                        End::Complete | End::Torn { .. } => None,
                        End::Damaged { offset, what } => Some(Err(ReadError::Damaged {
                            offset: offset as u64,
                            what: what.to_owned(),
                        })),
                    };
                }
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
                op::CHUNK => {
                    self.is_over = true;
                    let offset = record.offset as u64;
                    return Some(Err(ReadError::Chunked { offset }));
                }
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
        End::Torn { offset, what } | End::Damaged { offset, what } => ReadError::NoHeader {
            offset: offset as u64,
            what: what.to_owned(),
        },
    }
}

/// The header, if this metadata record holds it.
fn parse_header(record: &RawRecord<'_>) -> Result<Option<Header>, ReadError> {
    let broken = |what: &str| ReadError::NoHeader {
        offset: record.offset as u64,
        what: what.to_owned(),
    };
    let Some(found) = fields::metadata(record.body) else {
        return Err(broken("a damaged metadata record"));
    };
    if found.name != HEADER_RECORD {
        return Ok(None);
    }
    let text = |key: &str| text_of(&found, key).ok_or_else(|| broken("a header without its keys"));
    let format = text("format")?
        .parse()
        .ok()
        .ok_or_else(|| broken("a header whose format is not a number"))?;
    if format > FORMAT {
        return Err(ReadError::Format { found: format });
    }
    Ok(Some(Header {
        format,
        program_version: text("program_version")?,
        utc_start_micros: text("utc_start_micros")?
            .parse()
            .ok()
            .ok_or_else(|| broken("a header whose start time is not a number"))?,
        config_toml: text("config_toml")?,
        links: serde_json::from_str(&text("links")?)
            .ok()
            .ok_or_else(|| broken("a header whose links are not a list"))?,
    }))
}

fn text_of(record: &Metadata<'_>, key: &str) -> Option<String> {
    record.entries.get(key).map(|value| (*value).to_owned())
}
