//! Telegrams out of a stream that has neither a start byte nor a checksum.
//!
//! A telegram is believed if its length, type, opcode and status agree with each other. Otherwise the stream is out of step, and
//! nothing in it says where the next telegram begins; only silence does. So everything is thrown away until the link has been quiet, and
//! whoever asked must ask again.
//!
//! # Model
//! ```text
//! reading   a telegram is whole and nothing follows  hand it out
//!           a whole one follows it in the same chunk hand it out
//!           length, type, opcode or status is wrong  out of step, with the telegram just before it; draining
//!           a telegram stops in its middle for QUIET out of step, with the telegram just before it; reading
//! draining  quiet for QUIET                          reading
//! ```
//! Behind an answer there is silence until the next question. Bytes right behind it that are no telegram mean that a byte too many
//! stood in it.

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::io_maps;
use super::settings::NxtFraming;
use super::telegram::{
    DIRECT_NO_REPLY, LONGEST, PREFIX_BYTES, REPLY, Reply, bytes_at, opcode, reply_bytes,
};
use crate::framing::START_V2;

/// So long the link must be silent to be at the start of a telegram: three turn-arounds of the radio chip, at about 30 ms.
const QUIET: Span = Span::from_millis(100);
/// Bytes around the payload of a MAVLink 2 frame, and of its signature.
const FRAME_BYTES: usize = 12;
const SIGNATURE_BYTES: usize = 13;
/// Mailboxes of a brick, with those that its own program writes.
const MAILBOXES: u8 = 20;

/// What comes from a brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Speech {
    /// Replies, and messages from mailbox to mailbox.
    Telegrams,
    /// Also MAVLink 2 frames that a program sends of itself.
    TelegramsAndFrames,
}

/// A find.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Piece {
    /// A whole telegram, without its length.
    Telegram(Vec<u8>),
    /// So many bytes are no telegram; they and what follows until the link is quiet are thrown away.
    OutOfStep { bytes: usize },
}

/// The state of one link.
#[derive(Debug)]
pub(super) struct Cutter {
    framing: NxtFraming,
    speech: Speech,
    /// A telegram that is not whole yet, with its length in front.
    begun: Vec<u8>,
    last_byte: Option<Stamp<HostClock>>,
    is_draining: bool,
}

/// What the first bytes of the stream are.
enum Judgement {
    NotWhole,
    Whole(usize),
    Wrong,
}

impl Cutter {
    pub(super) fn new(framing: NxtFraming, speech: Speech) -> Self {
        Self {
            framing,
            speech,
            begun: Vec::with_capacity(2 * LONGEST),
            last_byte: None,
            is_draining: false,
        }
    }

    /// True while everything is thrown away: no question can be answered.
    pub(super) const fn is_draining(&self) -> bool {
        self.is_draining
    }

    /// When silence means something; then [`Cutter::expire`].
    pub(super) fn deadline(&self) -> Option<Stamp<HostClock>> {
        let waits = self.is_draining || !self.begun.is_empty();
        self.last_byte.filter(|_| waits).map(|last| last + QUIET)
    }

    /// Silence may have ended a drain, which gives nothing, or torn a telegram, whose bytes are given.
    pub(super) fn expire(&mut self, now: Stamp<HostClock>) -> Option<Piece> {
        if self.deadline().is_none_or(|due| due > now) {
            return None;
        }
        self.is_draining = false;
        let bytes = self.begun.len();
        self.begun.clear();
        (bytes > 0).then_some(Piece::OutOfStep { bytes })
    }

    /// Cuts one chunk; [`Cutter::expire`] comes first.
    pub(super) fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], found: &mut Vec<Piece>) {
        if bytes.is_empty() {
            return;
        }
        self.last_byte = Some(now);
        if self.framing == NxtFraming::Bare {
            found.push(self.datagram(bytes));
            return;
        }
        if self.is_draining {
            found.push(Piece::OutOfStep { bytes: bytes.len() });
            return;
        }
        self.begun.extend_from_slice(bytes);
        // Where the last whole telegram begins that nothing has confirmed yet, and where the bytes behind it do.
        let (mut held, mut rest_at) = (0, 0);
        loop {
            let rest = self.begun.get(rest_at..).unwrap_or_default();
            match judge(rest, self.speech) {
                Judgement::NotWhole => break,
                Judgement::Whole(length) => {
                    found.extend(telegram(&self.begun, held, rest_at));
                    held = rest_at;
                    rest_at += length;
                }
                Judgement::Wrong => {
                    self.is_draining = true;
                    let bytes = self.begun.len() - held;
                    self.begun.clear();
                    found.push(Piece::OutOfStep { bytes });
                    return;
                }
            }
        }
        if rest_at == self.begun.len() {
            found.extend(telegram(&self.begun, held, rest_at));
            held = rest_at;
        }
        self.begun.drain(..held);
    }

    /// A chunk that is one telegram or none.
    fn datagram(&self, bytes: &[u8]) -> Piece {
        let mut whole = (bytes.len().min(usize::from(u16::MAX)) as u16)
            .to_le_bytes()
            .to_vec();
        whole.extend_from_slice(bytes);
        match judge(&whole, self.speech) {
            Judgement::Whole(length) if length == whole.len() => Piece::Telegram(bytes.to_vec()),
            Judgement::Whole(_) | Judgement::NotWhole | Judgement::Wrong => {
                Piece::OutOfStep { bytes: bytes.len() }
            }
        }
    }
}

/// The telegram between two places in the stream, if there is one.
fn telegram(stream: &[u8], begin: usize, end: usize) -> Option<Piece> {
    let telegram = stream.get(begin..end)?.get(PREFIX_BYTES..)?;
    Some(Piece::Telegram(telegram.to_vec()))
}

/// Judges as early as the bytes allow: what is wrong with its first byte is not waited for.
fn judge(bytes: &[u8], speech: Speech) -> Judgement {
    let Some((prefix, begun)) = bytes.split_first_chunk::<PREFIX_BYTES>() else {
        return Judgement::NotWhole;
    };
    let length = usize::from(u16::from_le_bytes(*prefix));
    if !(2..=LONGEST).contains(&length) {
        return Judgement::Wrong;
    }
    let begun = begun.get(..length).unwrap_or(begun);
    let is_possible = match (begun.first().copied(), speech) {
        (None, _) => true,
        (Some(REPLY), _) => could_be_reply(begun, length),
        (Some(DIRECT_NO_REPLY), _) => could_be_message(begun, length),
        (Some(START_V2), Speech::TelegramsAndFrames) => could_be_frame(begun, length),
        (Some(_), _) => false,
    };
    match (is_possible, begun.len() == length) {
        (false, _) => Judgement::Wrong,
        (true, false) => Judgement::NotWhole,
        (true, true) => Judgement::Whole(PREFIX_BYTES + length),
    }
}

fn could_be_reply(begun: &[u8], length: usize) -> bool {
    if length < 3 {
        return false;
    }
    let Some(reply) = Reply::of(begun) else {
        return begun
            .get(1)
            .is_none_or(|code| *code == opcode::READ_IO_MAP || reply_bytes(*code).is_some());
    };
    if !reply.status.is_known() {
        return false;
    }
    match reply_bytes(reply.opcode) {
        // A refusal may be as short as its status, and a sensor's answer may be cut at what there is.
        _ if reply.status.0 != 0 => true,
        Some(expected) => length == expected,
        None if reply.opcode != opcode::READ_IO_MAP => false,
        None if begun.len() == length => io_maps::answered(&reply).is_some(),
        None => {
            let claimed = bytes_at(reply.values, 4).map(u16::from_le_bytes);
            length >= 9 && claimed.is_none_or(|claimed| length == usize::from(claimed) + 9)
        }
    }
}

/// A program's message to a mailbox of this side.
fn could_be_message(begun: &[u8], length: usize) -> bool {
    let is = |at: usize, fits: &dyn Fn(u8) -> bool| begun.get(at).is_none_or(|byte| fits(*byte));
    length >= 5
        && is(1, &|code| code == opcode::MESSAGE_WRITE)
        && is(2, &|mailbox| mailbox < MAILBOXES)
        && is(3, &|size| usize::from(size) + 4 == length)
}

fn could_be_frame(begun: &[u8], length: usize) -> bool {
    begun.get(1).is_none_or(|payload| {
        let bare = usize::from(*payload) + FRAME_BYTES;
        length == bare || length == bare + SIGNATURE_BYTES
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Status ok, 7900 mV is no question of ours; a firmware version is.
    const VERSION: [u8; 9] = [0x07, 0x00, 0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01];
    const DONE: [u8; 5] = [0x03, 0x00, 0x02, 0x05, 0x00];

    fn cut(chunks: &[&[u8]]) -> (Vec<Piece>, Cutter) {
        let mut cutter = Cutter::new(NxtFraming::Prefixed, Speech::Telegrams);
        let mut found = Vec::new();
        for chunk in chunks {
            cutter.push(Stamp::ZERO, chunk, &mut found);
        }
        (found, cutter)
    }

    #[test]
    fn two_telegrams_in_one_chunk_are_two() {
        let (found, cutter) = cut(&[&[&VERSION[..], &DONE[..]].concat()]);
        let expected = [&VERSION[2..], &DONE[2..]].map(|bytes| Piece::Telegram(bytes.to_vec()));
        assert_eq!(found, expected);
        assert_eq!(cutter.deadline(), None);
    }

    #[test]
    fn a_telegram_with_a_byte_too_many_behind_it_is_not_believed() {
        let (found, cutter) = cut(&[&[&VERSION[..], &[0xFF, 0xFF]].concat()]);
        assert_eq!(found, [Piece::OutOfStep { bytes: 11 }]);
        assert!(cutter.is_draining());
    }

    #[test]
    fn a_telegram_waits_for_what_follows_it_in_the_same_chunk() {
        let (found, mut cutter) = cut(&[&[&VERSION[..], &[0x03]].concat()]);
        assert_eq!(found, []);
        let mut later = Vec::new();
        cutter.push(Stamp::ZERO, &DONE[1..], &mut later);
        let expected = [&VERSION[2..], &DONE[2..]].map(|bytes| Piece::Telegram(bytes.to_vec()));
        assert_eq!(later, expected);

        let (_, mut cutter) = cut(&[&[&VERSION[..], &[0x03]].concat()]);
        let torn = cutter.expire(Stamp::from_millis(100));
        assert_eq!(torn, Some(Piece::OutOfStep { bytes: 10 }));
    }

    #[test]
    fn the_wrong_first_byte_is_enough_and_silence_ends_the_drain() {
        let (found, mut cutter) = cut(&[&[0x07], &[0x00], &[0x03], &VERSION]);
        let expected = [3, 9].map(|bytes| Piece::OutOfStep { bytes });
        assert_eq!(found, expected);
        assert_eq!(cutter.deadline(), Some(Stamp::from_millis(100)));
        assert_eq!(cutter.expire(Stamp::from_millis(99)), None);
        assert!(cutter.is_draining());
        assert_eq!(cutter.expire(Stamp::from_millis(100)), None);
        assert!(!cutter.is_draining());
    }

    #[test]
    fn a_torn_telegram_is_given_up_in_silence() {
        let (found, mut cutter) = cut(&[&VERSION[..8]]);
        assert!(found.is_empty());
        let torn = cutter.expire(Stamp::from_millis(100));
        assert_eq!(torn, Some(Piece::OutOfStep { bytes: 8 }));
        assert_eq!(cutter.deadline(), None);
    }

    #[test]
    fn lengths_that_contradict_opcode_or_map_are_refused() {
        let long_version = [0x08, 0x00, 0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01, 0x00];
        let unknown_status = [0x03, 0x00, 0x02, 0x05, 0x01];
        let never_asked = [0x03, 0x00, 0x02, 0x55, 0x00];
        let nothing = [0x00, 0x00];
        let too_long = [0x81, 0x00];
        let wrong_map: [u8; 12] = [0x0D, 0, 2, 0x94, 0, 1, 0, 1, 0, 5, 0, 0];
        for bytes in [
            &long_version[..],
            &unknown_status,
            &never_asked,
            &nothing,
            &too_long,
            &wrong_map,
        ] {
            let (found, cutter) = cut(&[bytes]);
            assert_eq!(found, [Piece::OutOfStep { bytes: bytes.len() }]);
            assert!(cutter.is_draining(), "{bytes:02x?}");
        }
    }

    #[test]
    fn a_bare_telegram_is_its_chunk() {
        let mut cutter = Cutter::new(NxtFraming::Bare, Speech::Telegrams);
        let mut found = Vec::new();
        cutter.push(Stamp::ZERO, &VERSION[2..], &mut found);
        cutter.push(Stamp::ZERO, &VERSION[2..8], &mut found);
        let expected = [
            Piece::Telegram(VERSION[2..].to_vec()),
            Piece::OutOfStep { bytes: 6 },
        ];
        assert_eq!(found, expected);
        assert!(!cutter.is_draining());
        assert_eq!(cutter.deadline(), None);
    }
}
