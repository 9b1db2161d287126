//! The messages of a bag in their order, from a stream of bytes: chunks are unpacked one by one, and nothing grows by what a length claims.
//!
//! Source: MCAP specification 0. A bag of several files is read as one stream of them.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read};
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::op;

use super::RECORD_HEADER_BYTES;
use crate::chunk_compression::{MAX_CHUNK_BYTES, unpack};
use crate::container::fields;

/// Longer schemas and messages are not read: no message of a sensor that we take is larger.
const MAX_RECORD_BYTES: u64 = MAX_CHUNK_BYTES;
/// More than any robot has, and what keeps the memory for them below 100 MB.
const MAX_CHANNELS: usize = 4_096;
/// Of a topic, of a type.
const MAX_NAME_BYTES: usize = 1_024;
/// The fields of a message come first; the rest of a definition is not needed.
const MAX_DEFINITION_BYTES: usize = 16 << 10;

/// Why a bag cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    #[error("this is not an MCAP file: it does not begin with the MCAP magic")]
    NotMcap,
    #[error(transparent)]
    Read(#[from] io::Error),
}

/// A channel of the bag, with its schema.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct BagChannel {
    pub(super) topic: String,
    pub(super) message_encoding: String,
    /// `None` if the bag does not have it.
    pub(super) schema: Option<Arc<BagSchema>>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct BagSchema {
    pub(super) name: String,
    pub(super) encoding: String,
    /// Its beginning.
    pub(super) definition: String,
}

impl BagSchema {
    fn new(found: &fields::Schema<'_>) -> Self {
        let beginning = found.data.get(..MAX_DEFINITION_BYTES).unwrap_or(found.data);
        Self {
            name: found.name.to_owned(),
            encoding: found.encoding.chars().take(MAX_NAME_BYTES).collect(),
            definition: String::from_utf8_lossy(beginning).into_owned(),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct BagMessage<'a> {
    pub(super) channel: &'a BagChannel,
    pub(super) log_nanos: u64,
    pub(super) data: &'a [u8],
    /// Of its record in the file; of a compressed chunk, that of the chunk.
    pub(super) offset: u64,
}

/// Reads a bag from its beginning to its end, or to where it was cut off.
pub(super) struct BagReader<R> {
    input: R,
    /// Of the next byte of the file.
    offset: u64,
    record: Vec<u8>,
    chunk: Option<OpenChunk>,
    schemas: BTreeMap<u16, Arc<BagSchema>>,
    channels: BTreeMap<u16, BagChannel>,
    /// What could not be read, in words.
    faults: Faults,
    is_finished: bool,
}

struct OpenChunk {
    records: Vec<u8>,
    /// Of the next record, within the chunk.
    next: usize,
    /// Of the first record in the file if the chunk is not compressed.
    base: Option<u64>,
    /// Of the chunk in the file.
    offset: u64,
}

/// The first faults, and the number of all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Faults {
    pub(super) listed: Vec<String>,
    pub(super) count: u64,
}

const MAX_LISTED: usize = 10;

impl Faults {
    pub(super) fn push(&mut self, fault: String) {
        self.count += 1;
        if self.listed.len() < MAX_LISTED {
            self.listed.push(fault);
        }
    }
}

struct RecordPlace {
    opcode: u8,
    offset: u64,
    /// Within the chunk; otherwise the body is in `record`.
    within_chunk: Option<(usize, usize)>,
}

impl<R: Read> BagReader<R> {
    /// # Errors
    /// Reading failed, or the bytes are not those of an MCAP file.
    pub(super) fn open(mut input: R) -> Result<Self, BagError> {
        let mut magic = [0; MAGIC.len()];
        let read = read_up_to(&mut input, &mut magic)?;
        if read < magic.len() || magic != *MAGIC {
            return Err(BagError::NotMcap);
        }
        Ok(Self {
            input,
            offset: MAGIC.len() as u64,
            record: Vec::new(),
            chunk: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            faults: Faults::default(),
            is_finished: false,
        })
    }

    /// The next message whose channel is known; `None` at the end, and where the bag was cut off.
    ///
    /// # Errors
    /// Reading failed.
    pub(super) fn next(&mut self) -> io::Result<Option<BagMessage<'_>>> {
        loop {
            let Some(place) = self.next_record()? else {
                return Ok(None);
            };
            if place.opcode != op::MESSAGE {
                self.on_record(&place);
                continue;
            }
            let channel_id = fields::message(self.body(&place)).map(|message| message.channel_id);
            match channel_id {
                Some(id) if self.channels.contains_key(&id) => {
                    let message = fields::message(self.body(&place));
                    let found = message.zip(self.channels.get(&id));
                    return Ok(found.map(|(message, channel)| BagMessage {
                        channel,
                        log_nanos: message.log_time,
                        data: message.data,
                        offset: place.offset,
                    }));
                }
                Some(id) => {
                    let fault = format!("byte {}: a message of channel {id}, which has no record", place.offset);
                    self.faults.push(fault);
                }
                None => self.faults.push(format!("byte {}: a message that is shorter than its head", place.offset)),
            }
        }
    }

    pub(super) const fn faults(&self) -> &Faults {
        &self.faults
    }

    pub(super) fn channels(&self) -> impl Iterator<Item = &BagChannel> {
        self.channels.values()
    }

    fn body(&self, place: &RecordPlace) -> &[u8] {
        match (place.within_chunk, &self.chunk) {
            (Some((start, end)), Some(chunk)) => chunk.records.get(start..end).unwrap_or_default(),
            _ => &self.record,
        }
    }

    fn on_record(&mut self, place: &RecordPlace) {
        let body = self.body(place);
        let fault = match place.opcode {
            op::SCHEMA => {
                let schema = fields::schema(body).filter(|schema| schema.name.len() <= MAX_NAME_BYTES);
                let entry = schema.map(|found| (found.id, BagSchema::new(&found)));
                match entry {
                    None => Some("a damaged schema"),
                    Some(_) if self.schemas.len() >= MAX_CHANNELS => Some("a schema beyond the first 4096"),
                    Some((id, schema)) => {
                        self.schemas.insert(id, Arc::new(schema));
                        None
                    }
                }
            }
            op::CHANNEL => {
                let channel = fields::channel(body).filter(|channel| channel.topic.len() <= MAX_NAME_BYTES);
                let entry = channel.map(|found| {
                    let (topic, message_encoding) = (found.topic.to_owned(), found.message_encoding.to_owned());
                    let schema = self.schemas.get(&found.schema_id).cloned();
                    (found.id, BagChannel { topic, message_encoding, schema })
                });
                match entry {
                    None => Some("a damaged channel"),
                    Some((id, _)) if self.channels.len() >= MAX_CHANNELS && !self.channels.contains_key(&id) => {
                        Some("a channel beyond the first 4096")
                    }
                    Some((id, channel)) => {
                        self.channels.insert(id, channel);
                        None
                    }
                }
            }
            _ => None,
        };
        if let Some(fault) = fault {
            self.faults.push(format!("byte {}: {fault}", place.offset));
        }
    }

    /// The next record that is not a chunk.
    fn next_record(&mut self) -> io::Result<Option<RecordPlace>> {
        loop {
            if let Some(place) = self.next_in_chunk() {
                return Ok(Some(place));
            }
            if self.is_finished {
                return Ok(None);
            }
            let offset = self.offset;
            let Some(opcode) = self.read_record()? else {
                self.is_finished = true;
                return Ok(None);
            };
            match opcode {
                op::CHUNK => self.enter(offset),
                op::FOOTER => self.end_file()?,
                _ => return Ok(Some(RecordPlace { opcode, offset, within_chunk: None })),
            }
        }
    }

    fn next_in_chunk(&mut self) -> Option<RecordPlace> {
        let chunk = self.chunk.as_mut()?;
        let start = chunk.next;
        let offset = chunk.base.map_or(chunk.offset, |base| base + start as u64);
        let rest = chunk.records.get(start..).unwrap_or_default();
        let place = rest.split_first_chunk::<RECORD_HEADER_BYTES>().and_then(|(header, content)| {
            let [opcode, length @ ..] = *header;
            let length = usize::try_from(u64::from_le_bytes(length)).ok()?;
            let body = start + RECORD_HEADER_BYTES;
            content.get(..length).map(|_| RecordPlace { opcode, offset, within_chunk: Some((body, body + length)) })
        });
        if let Some(RecordPlace { within_chunk: Some((_, end)), .. }) = &place {
            chunk.next = *end;
        } else {
            if !rest.is_empty() {
                self.faults.push(format!("byte {offset}: the rest of a chunk, {} bytes, is damaged", rest.len()));
            }
            self.chunk = None;
        }
        place
    }

    /// Reads a record of the file into `record`; the content of one that nobody asks for is left out. `None` where the file ends.
    fn read_record(&mut self) -> io::Result<Option<u8>> {
        let begin = self.offset;
        let mut header = [0; RECORD_HEADER_BYTES];
        let read = read_up_to(&mut self.input, &mut header)?;
        self.offset += read as u64;
        if read < header.len() {
            self.faults.push(format!("byte {begin}: the bag is cut off here"));
            return Ok(None);
        }
        let [opcode, length @ ..] = header;
        let length = u64::from_le_bytes(length);
        let is_wanted = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK);
        self.record.clear();
        let mut content = (&mut self.input).take(length);
        let read = if is_wanted && length <= MAX_RECORD_BYTES {
            content.read_to_end(&mut self.record)? as u64
        } else {
            io::copy(&mut content, &mut io::sink())?
        };
        self.offset += read;
        if read < length {
            self.faults.push(format!("byte {begin}: the bag is cut off here: {read} of {length} bytes of a record"));
            // What is there of a chunk is of use, of another record not.
            return Ok((opcode == op::CHUNK && length <= MAX_RECORD_BYTES).then_some(opcode));
        }
        if is_wanted && length > MAX_RECORD_BYTES {
            let most = MAX_RECORD_BYTES >> 20;
            self.faults.push(format!("byte {begin}: a record of {length} bytes is left out: the limit is {most} MiB"));
            self.record.clear();
            return Ok(Some(0));
        }
        Ok(Some(opcode))
    }

    fn enter(&mut self, offset: u64) {
        let Some(chunk) = fields::chunk(&self.record) else {
            self.faults.push(format!("byte {offset}: the head of a chunk is damaged"));
            return;
        };
        let Some(unpacked) = unpack(&chunk) else {
            let name = chunk.compression.escape_default();
            self.faults
                .push(format!("byte {offset}: a chunk with the compression `{name}`, which is neither zstd nor lz4"));
            return;
        };
        let base = offset + (RECORD_HEADER_BYTES + chunk.head_bytes) as u64;
        let base = chunk.compression.is_empty().then_some(base);
        if let Some(fault) = unpacked.fault {
            self.faults.push(format!("byte {offset}: a chunk cannot be unpacked whole: {fault}"));
        } else {
            let mut crc = flate2::Crc::new();
            crc.update(&unpacked.records);
            if chunk.crc != 0 && chunk.crc != crc.sum() {
                self.faults.push(format!("byte {offset}: the checksum of a chunk is wrong"));
            }
        }
        self.chunk = Some(OpenChunk { records: unpacked.records, next: 0, base, offset });
    }

    /// Behind the footer: the end magic, and then perhaps the next file of the bag.
    fn end_file(&mut self) -> io::Result<()> {
        let mut magics = [0; 2 * MAGIC.len()];
        let read = read_up_to(&mut self.input, &mut magics)?;
        let (end, next) = magics.split_at(MAGIC.len());
        if read == magics.len() && end == MAGIC && next == MAGIC {
            self.schemas.clear();
            self.channels.clear();
            self.offset = MAGIC.len() as u64;
            return Ok(());
        }
        if read != MAGIC.len() || end != MAGIC {
            self.faults.push(format!("byte {}: something else than the end of a bag behind its footer", self.offset));
        }
        self.is_finished = true;
        Ok(())
    }
}

fn read_up_to(input: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut read = 0;
    while let Some(rest) = buffer.get_mut(read..).filter(|rest| !rest.is_empty()) {
        match input.read(rest) {
            Ok(0) => break,
            Ok(count) => read += count,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(read)
}
