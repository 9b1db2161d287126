//! Classifies a candidate frame by its header alone, and keeps frames with an unknown id until they are decided.
//!
//! Flags that no version has and lengths that the claimed message cannot have are rejected before their bytes have come. A
//! frame with an unknown id never stops the scan: it is accepted when a verified frame (or another accepted one, or the end
//! of all bytes) begins exactly where it ends and no verified frame has begun inside it.

use posebridge_telemetry::Address;

use super::checksum::checksum;
use super::{FLAG_SIGNED, FrameRef, START_BYTE_V1, START_BYTE_V2, WireVersion};
use crate::dialect::catalogue::CATALOGUE;
use crate::dialect::definitions::MessageLayout;

/// Start, length, two flag bytes, sequence, system, component, three bytes of id.
const HEADER_V2: usize = 10;
/// Start, length, sequence, system, component, id.
const HEADER_V1: usize = 6;
const CHECKSUM: usize = 2;
/// Bytes of the signature: link, 48 bits of time, 48 bits of hash.
const SIGNATURE: usize = 13;

#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameHeader {
    version: WireVersion,
    pub(crate) message_id: u32,
    source: Address,
    pub(crate) sequence: u8,
    payload_len: usize,
    /// Length of the complete frame, signature included.
    pub(crate) total: usize,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum FrameCandidate {
    Incomplete,
    /// Flags or a length that the message cannot have.
    Impossible {
        message_id: u32,
        length: u8,
    },
    Supported {
        header: FrameHeader,
        layout: MessageLayout,
    },
    Unknown {
        header: FrameHeader,
    },
}

/// The result of verifying one candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VerifiedFrame<'a> {
    /// A frame of any known dialect whose checksum matches.
    Frame(FrameRef<'a>),
    /// A complete frame by its length, with an unknown id.
    UnknownFrame(FrameRef<'a>),
    Invalid,
}

/// Verifies bytes that were framed by something else, such as a record of a file: they must be exactly one frame.
pub fn verify(raw: &[u8]) -> VerifiedFrame<'_> {
    let candidate = classify(raw);
    if let FrameCandidate::Unknown { header } = candidate
        && header.total == raw.len()
    {
        return VerifiedFrame::UnknownFrame(header.frame(raw));
    }
    candidate.verified_frame(raw).map_or(VerifiedFrame::Invalid, VerifiedFrame::Frame)
}

impl FrameCandidate {
    /// The frame of a supported message; `None` unless `raw`, which was classified as this, holds exactly that frame and
    /// its checksum matches.
    pub(crate) fn verified_frame(self, raw: &[u8]) -> Option<FrameRef<'_>> {
        let Self::Supported { header, layout } = self else { return None };
        if header.total != raw.len() {
            return None;
        }
        let (covered, found) = header.covered(raw);
        (checksum(covered, layout.crc_extra) == found).then(|| header.frame(raw))
    }
}

/// Parses a frame by its header alone; `None` if the number of bytes differs from it. For bytes that [`verify`] has
/// accepted, which need no second checksum.
#[inline]
pub fn parse_verified(raw: &[u8]) -> Option<FrameRef<'_>> {
    let header = FrameHeader::parse(raw).filter(|header| header.total == raw.len())?;
    Some(header.frame(raw))
}

/// Classifies `bytes`, which begin with a start byte of the version.
#[inline]
pub(crate) fn classify(bytes: &[u8]) -> FrameCandidate {
    if let [START_BYTE_V2, length, flags, ..] = *bytes
        && flags & !FLAG_SIGNED != 0
    {
        // With unknown flags the place of the id is unknown too.
        return FrameCandidate::Impossible { message_id: 0, length };
    }
    let Some(header) = FrameHeader::parse(bytes) else {
        return FrameCandidate::Incomplete;
    };
    let Some(layout) = CATALOGUE.layout(header.message_id) else {
        return FrameCandidate::Unknown { header };
    };
    let (shortest, longest) = (usize::from(layout.max_len_v1), usize::from(layout.max_len_v2));
    let fits = match header.version {
        // Version 1 cuts no zeros off: a payload has the length of its definition. Extension fields do not belong there,
        // but pymavlink sends them when it is set to version 1.
        WireVersion::V1 => [shortest, longest].contains(&header.payload_len),
        WireVersion::V2 => header.payload_len <= longest,
    };
    if fits {
        FrameCandidate::Supported { header, layout }
    } else if layout.is_foreign {
        // Another version of its dialect has other fields.
        FrameCandidate::Unknown { header }
    } else {
        FrameCandidate::Impossible { message_id: header.message_id, length: header.payload_len as u8 }
    }
}

impl FrameHeader {
    /// `None` if it is incomplete.
    #[inline]
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        match *bytes {
            [START_BYTE_V2, length, flags, _, sequence, system, component, id0, id1, id2, ..] => {
                let payload_len = usize::from(length);
                let signature = if flags & FLAG_SIGNED == 0 { 0 } else { SIGNATURE };
                Some(Self {
                    version: WireVersion::V2,
                    message_id: u32::from_le_bytes([id0, id1, id2, 0]),
                    source: Address::new(system, component),
                    sequence,
                    payload_len,
                    total: HEADER_V2 + payload_len + CHECKSUM + signature,
                })
            }
            [START_BYTE_V1, length, sequence, system, component, id, ..] => {
                let payload_len = usize::from(length);
                Some(Self {
                    version: WireVersion::V1,
                    message_id: u32::from(id),
                    source: Address::new(system, component),
                    sequence,
                    payload_len,
                    total: HEADER_V1 + payload_len + CHECKSUM,
                })
            }
            _ => None,
        }
    }

    /// The frame that begins with this header; `raw` holds exactly [`FrameHeader::total`] bytes.
    #[inline]
    pub(super) fn frame<'a>(&self, raw: &'a [u8]) -> FrameRef<'a> {
        FrameRef {
            version: self.version,
            message_id: self.message_id,
            source: self.source,
            sequence: self.sequence,
            payload: &raw[self.payload_at()..self.end()],
            raw,
        }
    }

    /// The part of the frame that the checksum covers, and the checksum in the frame.
    #[inline]
    pub(crate) fn covered<'a>(&self, raw: &'a [u8]) -> (&'a [u8], u16) {
        let end = self.end();
        (&raw[1..end], u16::from_le_bytes([raw[end], raw[end + 1]]))
    }

    /// Offset of the sequence number; the sender's system and component follow it.
    pub(crate) const fn sequence_at(&self) -> usize {
        match self.version {
            WireVersion::V1 => 2,
            WireVersion::V2 => 4,
        }
    }

    pub(crate) const fn payload_at(&self) -> usize {
        match self.version {
            WireVersion::V1 => HEADER_V1,
            WireVersion::V2 => HEADER_V2,
        }
    }

    /// Offset of the payload's end, where the checksum begins.
    pub(crate) const fn end(&self) -> usize {
        self.payload_at() + self.payload_len
    }

    pub(crate) const fn is_signed(&self) -> bool {
        self.total > self.end() + CHECKSUM
    }
}

/// Most undecided claims: enough for a second of unknown telemetry at 50 Hz between two heartbeats, and a bound on the
/// memory (64 frames of at most 280 bytes).
const MAX_SPANS: usize = 64;

/// A claim: bytes `start..end` of the framer's buffer may be an unknown frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UnknownSpan {
    pub(super) start: usize,
    pub(super) end: usize,
}

/// The undecided claims, in the order of their starts.
#[derive(Clone, Debug, Default)]
pub(super) struct UnknownSpans(Vec<UnknownSpan>);

impl UnknownSpans {
    pub(super) fn push(&mut self, claim: UnknownSpan) {
        if self.0.len() == MAX_SPANS {
            self.0.remove(0);
        }
        self.0.push(claim);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn first_start(&self) -> Option<usize> {
        self.0.first().map(|claim| claim.start)
    }

    /// The unbroken chain of claims that ends exactly at `end`, first claim first; empty if there is none.
    pub(super) fn chain_to(&self, end: usize) -> Vec<UnknownSpan> {
        let mut chain = Vec::new();
        let mut end = end;
        // Of several claims with one end the longest is taken: a shorter one lies inside its payload.
        while let Some(claim) = self.0.iter().find(|claim| claim.end == end) {
            chain.push(*claim);
            end = claim.start;
        }
        chain.reverse();
        chain
    }

    /// Drops every claim that cannot be confirmed any more, with the scan at `cursor`.
    pub(super) fn prune(&mut self, cursor: usize) {
        let mut alive: Vec<UnknownSpan> = Vec::with_capacity(self.0.len());
        for &claim in self.0.iter().rev() {
            let open = claim.end >= cursor;
            if open || alive.iter().any(|later| later.start == claim.end) {
                alive.push(claim);
            }
        }
        alive.reverse();
        self.0 = alive;
    }

    /// Shifts the claims after the first `dropped` bytes of the buffer were dropped; no claim begins before them.
    pub(super) fn shift(&mut self, dropped: usize) {
        for claim in &mut self.0 {
            claim.start -= dropped;
            claim.end -= dropped;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn v1(id: u8, crc_extra: u8, payload: usize) -> Vec<u8> {
        let mut raw = vec![START_BYTE_V1, payload as u8, 0, 1, 1, id];
        raw.resize(HEADER_V1 + payload, 7);
        let sum = checksum(&raw[1..], crc_extra);
        raw.extend(sum.to_le_bytes());
        raw
    }

    fn is_frame(raw: &[u8]) -> bool {
        matches!(verify(raw), VerifiedFrame::Frame(_))
    }

    #[test]
    fn a_version_1_frame_has_the_length_of_its_definition() {
        // HEARTBEAT has no extension fields, COMMAND_ACK (77) has 7 bytes of them.
        assert!(is_frame(&v1(0, 50, 9)));
        assert!(!is_frame(&v1(0, 50, 8)) && !is_frame(&v1(0, 50, 10)));
        assert!(is_frame(&v1(77, 143, 3)) && is_frame(&v1(77, 143, 10)));
        assert!(!is_frame(&v1(77, 143, 5)));
    }

    #[test]
    fn what_is_verified_is_exactly_one_frame_of_any_dialect() {
        // RADIO of ardupilotmega.xml.
        let radio = v1(166, 21, 9);
        assert!(is_frame(&radio));
        assert_eq!(parse_verified(&radio).unwrap().message_id, 166);
        assert_eq!(verify(&[&radio[..], &[0]].concat()), VerifiedFrame::Invalid);
        assert_eq!(verify(&radio[..radio.len() - 1]), VerifiedFrame::Invalid);
        assert_eq!(verify(&[]), VerifiedFrame::Invalid);
        let mut damaged = radio;
        damaged[7] ^= 1;
        assert_eq!(verify(&damaged), VerifiedFrame::Invalid);
        let unknown = v1(255, 0, 4);
        assert!(matches!(verify(&unknown), VerifiedFrame::UnknownFrame(frame) if !frame.is_signed()));
    }

    fn claims(list: &[(usize, usize)]) -> UnknownSpans {
        let mut claims = UnknownSpans::default();
        for &(start, end) in list {
            claims.push(UnknownSpan { start, end });
        }
        claims
    }

    #[test]
    fn a_chain_is_followed_back_to_its_first_claim() {
        let claims = claims(&[(3, 20), (7, 11), (20, 40), (25, 40)]);
        let chain = claims.chain_to(40);
        assert_eq!(chain, [UnknownSpan { start: 3, end: 20 }, UnknownSpan { start: 20, end: 40 }]);
        assert!(claims.chain_to(41).is_empty());
    }

    #[test]
    fn a_claim_lives_while_its_end_lies_ahead_or_another_claim_begins_there() {
        let mut remaining = claims(&[(0, 12), (5, 9), (12, 30)]);
        remaining.prune(14);
        assert_eq!(remaining.first_start(), Some(0));
        remaining.prune(31);
        assert!(remaining.is_empty());
    }

    #[test]
    fn the_oldest_claim_is_dropped_when_there_are_too_many() {
        let mut many = UnknownSpans::default();
        for start in 0..=MAX_SPANS {
            many.push(UnknownSpan { start, end: start + 12 });
        }
        assert_eq!(many.first_start(), Some(1));
    }
}
