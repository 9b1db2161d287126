//! Judges what begins at a start byte, by its header alone.
//!
//! Early judgement is what keeps a torn or invented header from holding back the frames behind it: flags that no
//! protocol version has and lengths that the claimed message cannot have are refused before their bytes have come.
//! Checksums are the scanner's business.

use posebridge_telemetry::Address;

use super::{FrameRef, START_V1, START_V2, WireVersion};
use crate::dialect::catalogue::{Catalogue, Shape};

/// Start, length, two flag bytes, sequence, system, component, three bytes of id.
const HEADER_V2: usize = 10;
/// Start, length, sequence, system, component, id.
const HEADER_V1: usize = 6;
/// Bytes of the checksum.
const CHECKSUM: usize = 2;
/// Bytes of the signature: link, 48 bits of time, 48 bits of hash.
const SIGNATURE: usize = 13;
/// Incompatibility flag: a signature follows. The only one in use.
const FLAG_SIGNED: u8 = 0x01;

/// A header that can begin a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header {
    version: WireVersion,
    message_id: u32,
    source: Address,
    sequence: u8,
    payload_len: usize,
    /// Length of the whole frame, signature included.
    pub(super) total: usize,
}

/// What a start byte turned out to begin.
#[derive(Clone, Copy, Debug)]
pub(super) enum Candidate {
    /// The header is not whole yet.
    Incomplete,
    /// The header says what no sender can mean.
    Impossible { message_id: u32, length: u8 },
    /// A header with an id of a dialect; the frame may not be whole yet.
    Known { header: Header, crc_extra: u8 },
    /// A header with an id of no dialect; the frame may not be whole yet.
    Unknown { header: Header },
}

/// Judges `bytes`, which begin with a start byte of the version.
#[inline]
pub(super) fn judge(bytes: &[u8], catalogue: &Catalogue) -> Candidate {
    match bytes {
        [START_V2, rest @ ..] => judge_v2(rest, catalogue),
        [START_V1, rest @ ..] => judge_v1(rest, catalogue),
        _ => Candidate::Incomplete,
    }
}

#[inline]
fn judge_v2(rest: &[u8], catalogue: &Catalogue) -> Candidate {
    if let [length, flags, ..] = *rest
        && flags & !FLAG_SIGNED != 0
    {
        // With unknown flags the place of the id is unknown too.
        return Candidate::Impossible {
            message_id: 0,
            length,
        };
    }
    let [
        length,
        flags,
        _,
        sequence,
        system,
        component,
        id0,
        id1,
        id2,
        ..,
    ] = *rest
    else {
        return Candidate::Incomplete;
    };
    let payload_len = usize::from(length);
    let signature = if flags & FLAG_SIGNED == 0 {
        0
    } else {
        SIGNATURE
    };
    let header = Header {
        version: WireVersion::V2,
        message_id: u32::from_le_bytes([id0, id1, id2, 0]),
        source: Address::new(system, component),
        sequence,
        payload_len,
        total: HEADER_V2 + payload_len + CHECKSUM + signature,
    };
    with_shape(header, length, catalogue, |shape| shape.max_len_v2)
}

fn judge_v1(rest: &[u8], catalogue: &Catalogue) -> Candidate {
    let [length, sequence, system, component, id, ..] = *rest else {
        return Candidate::Incomplete;
    };
    let payload_len = usize::from(length);
    let header = Header {
        version: WireVersion::V1,
        message_id: u32::from(id),
        source: Address::new(system, component),
        sequence,
        payload_len,
        total: HEADER_V1 + payload_len + CHECKSUM,
    };
    with_shape(header, length, catalogue, |shape| shape.max_len_v1)
}

#[inline]
fn with_shape(
    header: Header,
    length: u8,
    catalogue: &Catalogue,
    max_len: fn(&Shape) -> u8,
) -> Candidate {
    let Some(shape) = catalogue.shape(header.message_id) else {
        return Candidate::Unknown { header };
    };
    if length > max_len(&shape) {
        return Candidate::Impossible {
            message_id: header.message_id,
            length,
        };
    }
    Candidate::Known {
        header,
        crc_extra: shape.crc_extra,
    }
}

impl Header {
    /// The frame that begins with this header; `raw` holds exactly [`Header::total`] bytes.
    #[inline]
    pub(super) fn frame<'a>(&self, raw: &'a [u8]) -> FrameRef<'a> {
        let at = self.header_len();
        FrameRef {
            version: self.version,
            message_id: self.message_id,
            source: self.source,
            sequence: self.sequence,
            payload: &raw[at..at + self.payload_len],
            raw,
        }
    }

    /// The id that the header claims.
    pub(super) const fn message_id(&self) -> u32 {
        self.message_id
    }

    /// The part of the frame that the checksum covers, and the checksum that stands there.
    #[inline]
    pub(super) fn covered<'a>(&self, raw: &'a [u8]) -> (&'a [u8], u16) {
        let end = self.header_len() + self.payload_len;
        (&raw[1..end], u16::from_le_bytes([raw[end], raw[end + 1]]))
    }

    const fn header_len(&self) -> usize {
        match self.version {
            WireVersion::V1 => HEADER_V1,
            WireVersion::V2 => HEADER_V2,
        }
    }
}
