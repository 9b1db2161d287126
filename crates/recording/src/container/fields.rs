//! The fields of the records that describe a recording and hold its messages: metadata, channel, chunk, message.
//!
//! The `mcap` crate's parser allocates the length that a string claims before it checks how many bytes there are: a damaged file of
//! some hundred bytes made it request four gigabytes. This parser never allocates more than the bytes present.
//!
//! Source: MCAP specification, "Metadata (op=0x0C)", "Schema (op=0x03)", "Channel (op=0x04)", "Message (op=0x05)", "Chunk (op=0x06)",
//! "Serialization": a string is its length (u32) and UTF-8; a map is its length in bytes (u32) and pairs, with no key
//! twice; little-endian.

use std::collections::BTreeMap;

use super::encoding::DecodeError;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Metadata<'a> {
    pub(crate) name: &'a str,
    pub(crate) entries: BTreeMap<&'a str, &'a str>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Channel<'a> {
    pub(crate) id: u16,
    /// 0 for none.
    pub(crate) schema_id: u16,
    pub(crate) topic: &'a str,
    pub(crate) message_encoding: &'a str,
    pub(crate) metadata: BTreeMap<&'a str, &'a str>,
}

/// `None` if the record is damaged. Extra bytes after its fields belong to newer versions and are ignored.
pub(crate) fn metadata(body: &[u8]) -> Option<Metadata<'_>> {
    let mut fields = ByteReader { remaining: body };
    Some(Metadata { name: fields.text()?, entries: fields.map()? })
}

/// `None` if the record is damaged.
pub(crate) fn channel(body: &[u8]) -> Option<Channel<'_>> {
    let mut fields = ByteReader { remaining: body };
    let id = fields.u16().ok()?;
    let schema_id = fields.u16().ok()?;
    Some(Channel { id, schema_id, topic: fields.text()?, message_encoding: fields.text()?, metadata: fields.map()? })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Schema<'a> {
    pub(crate) id: u16,
    pub(crate) name: &'a str,
    pub(crate) encoding: &'a str,
    pub(crate) data: &'a [u8],
}

/// `None` if the record is damaged.
pub(crate) fn schema(body: &[u8]) -> Option<Schema<'_>> {
    let mut fields = ByteReader { remaining: body };
    Some(Schema {
        id: fields.u16().ok()?,
        name: fields.text()?,
        encoding: fields.text()?,
        data: fields.length_prefixed()?,
    })
}

/// Opcode and length before the content of a record.
const RECORD_HEADER_BYTES: usize = 9;

/// The profile of a file that begins with these bytes, from its first record; `None` if it is no MCAP file.
pub(crate) fn profile(beginning: &[u8]) -> Option<&str> {
    let header = beginning.strip_prefix(mcap::MAGIC)?.get(RECORD_HEADER_BYTES..)?;
    ByteReader { remaining: header }.text()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Chunk<'a> {
    /// Of the records, uncompressed, as it claims.
    pub(crate) unpacked_bytes: u64,
    /// CRC-32 of the uncompressed records; 0 when it was not computed.
    pub(crate) crc: u32,
    /// Name of the compression; empty for none.
    pub(crate) compression: &'a str,
    /// Offset of the records within the chunk.
    pub(crate) head_bytes: usize,
    /// The records, truncated if the file is.
    pub(crate) records: &'a [u8],
}

/// `None` if the record is damaged. A truncated chunk has fewer records than its length claims.
pub(crate) fn chunk(body: &[u8]) -> Option<Chunk<'_>> {
    let mut fields = ByteReader { remaining: body };
    let _first_time = fields.u64().ok()?;
    let _last_time = fields.u64().ok()?;
    let unpacked_bytes = fields.u64().ok()?;
    let crc = fields.u32().ok()?;
    let compression = fields.text()?;
    let bytes = usize::try_from(fields.u64().ok()?).ok()?;
    Some(Chunk {
        unpacked_bytes,
        crc,
        compression,
        head_bytes: body.len() - fields.remaining.len(),
        records: fields.remaining.get(..bytes).unwrap_or(fields.remaining),
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Message<'a> {
    pub(crate) channel_id: u16,
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) data: &'a [u8],
}

/// Channel (2), sequence (4), log time (8) and publish time (8).
pub(crate) const MESSAGE_HEADER_BYTES: usize = 22;

/// `None` if the record is shorter than its header.
pub(crate) fn message(body: &[u8]) -> Option<Message<'_>> {
    let mut fields = ByteReader { remaining: body };
    let (channel_id, sequence) = (fields.u16().ok()?, fields.u32().ok()?);
    let log_time = fields.u64().ok()?;
    let _publish_time = fields.u64().ok()?;
    Some(Message { channel_id, sequence, log_time, data: fields.remaining })
}

/// Reads from the front of the remaining bytes.
pub(super) struct ByteReader<'a> {
    pub(super) remaining: &'a [u8],
}

impl<'a> ByteReader<'a> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let left = self.remaining.len();
        let (head, rest) = self.remaining.split_first_chunk().ok_or(DecodeError::TooShort { wanted: N, left })?;
        self.remaining = rest;
        Ok(*head)
    }

    pub(super) fn u8(&mut self) -> Result<u8, DecodeError> {
        self.bytes().map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self) -> Result<u16, DecodeError> {
        self.bytes().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, DecodeError> {
        self.bytes().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, DecodeError> {
        self.bytes().map(u64::from_le_bytes)
    }

    pub(super) fn i64(&mut self) -> Result<i64, DecodeError> {
        self.bytes().map(i64::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Result<f64, DecodeError> {
        self.bytes().map(f64::from_le_bytes)
    }

    /// Bytes after their length.
    fn length_prefixed(&mut self) -> Option<&'a [u8]> {
        let length = self.u32().ok()? as usize;
        let (bytes, rest) = self.remaining.split_at_checked(length)?;
        self.remaining = rest;
        Some(bytes)
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.length_prefixed()?).ok()
    }

    fn map(&mut self) -> Option<BTreeMap<&'a str, &'a str>> {
        let mut pairs = ByteReader { remaining: self.length_prefixed()? };
        let mut entries = BTreeMap::new();
        while !pairs.remaining.is_empty() {
            let (key, value) = (pairs.text()?, pairs.text()?);
            if entries.insert(key, value).is_some() {
                return None;
            }
        }
        Some(entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The name `n`, one entry `k` = `v`, and a byte of a newer version.
    const RECORD: &[u8] = b"\x01\0\0\0n\x0A\0\0\0\x01\0\0\0k\x01\0\0\0v+";

    #[test]
    fn a_record_comes_apart_as_the_specification_says() {
        let found = metadata(RECORD).unwrap();
        assert_eq!(found.name, "n");
        assert_eq!(found.entries, BTreeMap::from([("k", "v")]));

        let record = b"\x07\0\x01\0\x01\0\0\0t\x02\0\0\0me\0\0\0\0";
        let metadata = BTreeMap::new();
        let expected = Channel { id: 7, schema_id: 1, topic: "t", message_encoding: "me", metadata };
        assert_eq!(channel(record), Some(expected));
    }

    #[test]
    fn a_record_that_is_cut_or_claims_too_much_is_damaged() {
        for length in 0..RECORD.len() - 1 {
            assert_eq!(metadata(&RECORD[..length]), None, "{length}");
        }
        // The lengths of the name, the map, the key and the value.
        for at in [0, 5, 9, 14] {
            let mut record = RECORD.to_vec();
            record[at..at + 4].fill(0xFF);
            assert_eq!(metadata(&record), None, "{at}");
        }
    }

    #[test]
    fn a_chunk_that_is_cut_gives_what_is_there() {
        let mut body = [0; 24].to_vec();
        body.extend(b"\x04\x03\x02\x01\0\0\0\0\x05\0\0\0\0\0\0\0abcde");
        let whole = chunk(&body).unwrap();
        assert_eq!((whole.crc, whole.compression), (0x0102_0304, ""));
        assert_eq!(whole.records, b"abcde");
        assert_eq!(chunk(&body[..body.len() - 2]).unwrap().records, b"abc");
        assert_eq!(chunk(&body[..39]), None);
    }

    #[test]
    fn no_key_stands_twice() {
        let entry = b"\x01\0\0\0k\x01\0\0\0v";
        let record = [&b"\x01\0\0\0n\x14\0\0\0"[..], entry, entry].concat();
        assert_eq!(metadata(&record), None);
    }
}
