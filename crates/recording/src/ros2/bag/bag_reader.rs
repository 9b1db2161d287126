//! The messages of a bag in their order, from a stream of bytes: chunks are unpacked one by one, and nothing grows by what a length claims.
//!
//! A bag of several files is one input that ends (a read of no bytes) at the end of each, and goes on with the next.
//!
//! Source: MCAP specification 0.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read};
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::op;

use crate::chunk_compression::{MAX_CHUNK_BYTES, unpack};
use crate::container::fields;

/// Opcode and length before the content of a record.
const RECORD_HEADER_BYTES: usize = 9;
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
    /// The number of the file in the bag, from 1.
    file: u32,
    /// The offset of the next byte in the file.
    offset: u64,
    record: Vec<u8>,
    chunk: Option<OpenChunk>,
    schemas: BTreeMap<u16, Arc<BagSchema>>,
    channels: BTreeMap<u16, BagChannel>,
    /// What could not be read.
    faults: Faults,
    /// The end of the present file was met.
    is_file_read: bool,
    is_finished: bool,
}

struct OpenChunk {
    records: Vec<u8>,
    /// The offset of the next record in the chunk.
    next: usize,
    /// The offset of the first record in the file if the chunk is not compressed.
    base: Option<u64>,
    /// The offset of the chunk in the file.
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
            file: 1,
            offset: MAGIC.len() as u64,
            record: Vec::new(),
            chunk: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            faults: Faults::default(),
            is_file_read: false,
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
                    self.report(place.offset, &format!("a message of channel {id}, which has no record"));
                }
                None => self.report(place.offset, "a message that is shorter than its head"),
            }
        }
    }

    /// Records what could not be read at an offset of the present file.
    fn report(&mut self, offset: u64, what: &str) {
        let file = if self.file > 1 { format!("file {}, ", self.file) } else { String::new() };
        self.faults.push(format!("{file}byte {offset}: {what}"));
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
            self.report(place.offset, fault);
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
            if self.is_file_read {
                self.open_next_file()?;
                continue;
            }
            let offset = self.offset;
            match self.read_record()? {
                None => {}
                Some(op::CHUNK) => self.enter(offset),
                Some(op::FOOTER) => self.finish_file()?,
                Some(opcode) => return Ok(Some(RecordPlace { opcode, offset, within_chunk: None })),
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
            let damaged = rest.len();
            self.chunk = None;
            if damaged > 0 {
                self.report(offset, &format!("the rest of a chunk, {damaged} bytes, is damaged"));
            }
        }
        place
    }

    /// Reads a record of the file into `record`, without the content of one of no use. `None` for one that is too long or cut off.
    fn read_record(&mut self) -> io::Result<Option<u8>> {
        let begin = self.offset;
        let mut header = [0; RECORD_HEADER_BYTES];
        let read = read_up_to(&mut self.input, &mut header)?;
        self.offset += read as u64;
        if read < header.len() {
            self.report(begin, "the bag is cut off here");
            self.is_file_read = true;
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
            self.report(begin, &format!("the bag is cut off here: {read} of {length} bytes of a record"));
            self.is_file_read = true;
            // What is there of a chunk is of use, of another record not.
            return Ok((opcode == op::CHUNK && length <= MAX_RECORD_BYTES).then_some(opcode));
        }
        if is_wanted && length > MAX_RECORD_BYTES {
            let most = MAX_RECORD_BYTES >> 20;
            self.report(begin, &format!("a record of {length} bytes is left out: the limit is {most} MiB"));
            return Ok(None);
        }
        Ok(Some(opcode))
    }

    fn enter(&mut self, offset: u64) {
        let Some(chunk) = fields::chunk(&self.record) else {
            self.report(offset, "the head of a chunk is damaged");
            return;
        };
        let Some(unpacked) = unpack(&chunk) else {
            let name = chunk.compression.escape_default();
            let fault = format!("a chunk with the compression `{name}`, which is neither zstd nor lz4");
            self.report(offset, &fault);
            return;
        };
        let base = offset + (RECORD_HEADER_BYTES + chunk.head_bytes) as u64;
        let base = chunk.compression.is_empty().then_some(base);
        if let Some(fault) = unpacked.fault {
            self.report(offset, &format!("a chunk cannot be unpacked whole: {fault}"));
        } else {
            let mut crc = flate2::Crc::new();
            crc.update(&unpacked.records);
            if chunk.crc != 0 && chunk.crc != crc.sum() {
                self.report(offset, "the checksum of a chunk is wrong");
            }
        }
        self.chunk = Some(OpenChunk { records: unpacked.records, next: 0, base, offset });
    }

    /// Behind the footer: the end magic.
    fn finish_file(&mut self) -> io::Result<()> {
        if self.read_magic()? != MAGIC {
            self.report(self.offset, "something else than the end of a bag behind its footer");
        }
        self.skip_file()
    }

    /// Begins the next file of the bag, if there is one.
    fn open_next_file(&mut self) -> io::Result<()> {
        self.is_file_read = false;
        let magic = self.read_magic()?;
        if magic.is_empty() {
            self.is_finished = true;
            return Ok(());
        }
        self.file += 1;
        self.offset = MAGIC.len() as u64;
        self.schemas.clear();
        self.channels.clear();
        if magic != MAGIC {
            self.report(0, "this is not an MCAP file");
            self.skip_file()?;
        }
        Ok(())
    }

    /// As many of its bytes as the file has.
    fn read_magic(&mut self) -> io::Result<Vec<u8>> {
        let mut magic = vec![0; MAGIC.len()];
        let read = read_up_to(&mut self.input, &mut magic)?;
        self.is_file_read = read < magic.len();
        magic.truncate(read);
        Ok(magic)
    }

    /// Reads the file to its end, unless that was met before.
    fn skip_file(&mut self) -> io::Result<()> {
        if !self.is_file_read {
            io::copy(&mut self.input, &mut io::sink())?;
            self.is_file_read = true;
        }
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
