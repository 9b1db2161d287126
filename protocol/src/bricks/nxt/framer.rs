//! Splits a stream into telegrams, without a start byte or a checksum (SPEC.md, "Framing").
//!
//! A telegram is accepted if its length, type, opcode and status are consistent. Otherwise the stream is out of step, with
//! the telegram just before it: all bytes are discarded until silence, or until a length-prefixed MAVLink frame with the
//! right checksum, and the pending requests have to be repeated. A complete telegram of another type belongs to a program:
//! it is foreign, and no evidence against the telegrams around it.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::io_maps;
use super::settings::WheelSource;
use super::telegram::{
    DIRECT_NO_REPLY, MAX_TELEGRAM_BYTES, NxtReply, PREFIX_BYTES, REPLY, bytes_at, opcode, reply_bytes,
};
use crate::framing::{START_BYTE_V2, classify};

/// Silence that proves the start of a telegram: three turn-arounds of the radio chip, at about 30 ms.
const QUIET: TimeDelta = TimeDelta::from_millis(100);
/// No requests are sent while bytes are discarded. What still comes after this time is sent by a program, ...
const RESYNC_SILENCE: TimeDelta = TimeDelta::from_millis(1_000);
/// ... and then this shorter silence must suffice: longer than any inside a telegram, and shorter than the pauses of
/// programs that send up to 50 per second.
const TELEGRAM_SILENCE: TimeDelta = TimeDelta::from_millis(15);
/// Bytes in front of the payload of a MAVLink 2 frame, of its checksum and of its signature.
const HEADER_BYTES: usize = 10;
const CHECKSUM_BYTES: usize = 2;
const SIGNATURE_BYTES: usize = 13;
/// Mailboxes of a brick, including those that its own program writes.
const MAILBOXES: u8 = 20;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum TelegramPart {
    /// A complete telegram, without its length.
    Telegram(Vec<u8>),
    /// A telegram of a type that is not read here: a program on the brick sends to another receiver.
    Foreign(Vec<u8>),
    /// Number of bytes that are no telegram, and were dropped.
    OutOfSync { bytes: usize },
}

#[derive(Debug)]
pub(super) struct TelegramFramer {
    source: WheelSource,
    /// An incomplete telegram, with its length before it; while draining, a possible begin of a frame.
    pending: Vec<u8>,
    last_byte: Option<Timestamp<HostClock>>,
    draining_since: Option<Timestamp<HostClock>>,
}

enum PrefixMatch {
    Incomplete,
    Complete(usize),
    Invalid,
}

impl TelegramFramer {
    pub(super) fn new(source: WheelSource) -> Self {
        Self { source, pending: Vec::with_capacity(2 * MAX_TELEGRAM_BYTES), last_byte: None, draining_since: None }
    }

    /// True while bytes are discarded: no request can be answered.
    pub(super) const fn is_draining(&self) -> bool {
        self.draining_since.is_some()
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let last = self.last_byte?;
        let quiet = match self.draining_since {
            None if self.pending.is_empty() => return None,
            Some(since) if last - since >= RESYNC_SILENCE => TELEGRAM_SILENCE,
            None | Some(_) => QUIET,
        };
        Some(last + quiet)
    }

    /// Ends a drain or drops an incomplete telegram after silence; returns the dropped bytes, if any.
    pub(super) fn expire(&mut self, now: Timestamp<HostClock>) -> Option<TelegramPart> {
        if self.deadline().is_none_or(|due| due > now) {
            return None;
        }
        self.draining_since = None;
        let bytes = self.pending.len();
        self.pending.clear();
        (bytes > 0).then_some(TelegramPart::OutOfSync { bytes })
    }

    /// Splits one chunk; call [`TelegramFramer::expire`] before.
    pub(super) fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], found: &mut Vec<TelegramPart>) {
        if bytes.is_empty() {
            return;
        }
        self.last_byte = Some(now);
        self.pending.extend_from_slice(bytes);
        while self.is_draining() || !self.split_telegrams(found) {
            self.draining_since = self.draining_since.or(Some(now));
            if !self.resynchronize(found) {
                return;
            }
            self.draining_since = None;
        }
    }

    /// Emits all telegrams that are certain; false if the stream is out of step.
    fn split_telegrams(&mut self, found: &mut Vec<TelegramPart>) -> bool {
        // Where the last complete, unconfirmed telegram begins, and where the bytes behind it do.
        let (mut held, mut rest_at) = (0, 0);
        let is_in_step = loop {
            let rest = self.pending.get(rest_at..).unwrap_or_default();
            match classify_prefix(rest) {
                PrefixMatch::Incomplete => break true,
                PrefixMatch::Invalid => break false,
                PrefixMatch::Complete(length) => {
                    found.extend(self.telegram(held, rest_at));
                    held = rest_at;
                    rest_at += length;
                }
            }
        };
        if is_in_step && rest_at == self.pending.len() {
            found.extend(self.telegram(held, rest_at));
            held = rest_at;
        }
        self.pending.drain(..held);
        is_in_step
    }

    /// Discards bytes that cannot be the begin of a frame; true if a verified frame was found.
    fn resynchronize(&mut self, found: &mut Vec<TelegramPart>) -> bool {
        let hunted = match self.source {
            WheelSource::Polled => ResyncPoint::nothing_in(&self.pending),
            WheelSource::Pushed => find_resync_point(&self.pending),
        };
        if hunted.at > 0 {
            found.push(TelegramPart::OutOfSync { bytes: hunted.at });
            self.pending.drain(..hunted.at);
        }
        let Some(length) = hunted.length else {
            return false;
        };
        found.extend(self.telegram(0, length));
        self.pending.drain(..length);
        true
    }

    fn telegram(&self, begin: usize, end: usize) -> Option<TelegramPart> {
        let telegram = self.pending.get(begin..end)?.get(PREFIX_BYTES..)?.to_vec();
        let is_ours = match telegram.first()? {
            &REPLY | &DIRECT_NO_REPLY => true,
            &START_BYTE_V2 => self.source == WheelSource::Pushed,
            _ => false,
        };
        Some(if is_ours { TelegramPart::Telegram(telegram) } else { TelegramPart::Foreign(telegram) })
    }
}

/// A position where a stream that is out of step may be in step again.
struct ResyncPoint {
    at: usize,
    /// Length of a verified frame there, including its length prefix; `None` if the rest may become one.
    length: Option<usize>,
}

impl ResyncPoint {
    const fn nothing_in(stream: &[u8]) -> Self {
        Self { at: stream.len(), length: None }
    }
}

/// The first verified frame, or else the first offset at which an incomplete one may begin.
fn find_resync_point(stream: &[u8]) -> ResyncPoint {
    let mut begun = None;
    for at in 0..stream.len() {
        let rest = stream.get(at..).unwrap_or_default();
        if rest.get(PREFIX_BYTES).is_some_and(|kind| *kind != START_BYTE_V2) {
            continue;
        }
        match classify_prefix(rest) {
            PrefixMatch::Invalid => {}
            PrefixMatch::Incomplete => begun = begun.or(Some(at)),
            PrefixMatch::Complete(length) => {
                if rest.get(PREFIX_BYTES..length).is_some_and(has_right_checksum) {
                    let length = Some(length);
                    return ResyncPoint { at, length };
                }
            }
        }
    }
    ResyncPoint { at: begun.unwrap_or(stream.len()), ..ResyncPoint::nothing_in(stream) }
}

/// Whether this is an undamaged MAVLink 2 frame of a known message.
fn has_right_checksum(frame: &[u8]) -> bool {
    classify(frame).verified_frame(frame).is_some()
}

/// Decides as early as the bytes allow: does not wait for the rest of a wrong beginning.
fn classify_prefix(bytes: &[u8]) -> PrefixMatch {
    let Some((prefix, begun)) = bytes.split_first_chunk::<PREFIX_BYTES>() else {
        return PrefixMatch::Incomplete;
    };
    let length = usize::from(u16::from_le_bytes(*prefix));
    if !(2..=MAX_TELEGRAM_BYTES).contains(&length) {
        return PrefixMatch::Invalid;
    }
    let begun = begun.get(..length).unwrap_or(begun);
    let is_possible = match begun.first() {
        Some(&REPLY) => could_be_reply(begun, length),
        Some(&DIRECT_NO_REPLY) => could_be_message(begun, length),
        Some(&START_BYTE_V2) => could_be_frame(begun, length),
        // A program may send whatever it likes.
        None | Some(_) => true,
    };
    match (is_possible, begun.len() == length) {
        (false, _) => PrefixMatch::Invalid,
        (true, false) => PrefixMatch::Incomplete,
        (true, true) => PrefixMatch::Complete(PREFIX_BYTES + length),
    }
}

fn could_be_reply(begun: &[u8], length: usize) -> bool {
    if length < 3 {
        return false;
    }
    let Some(reply) = NxtReply::parse(begun) else {
        return begun.get(1).is_none_or(|code| *code == opcode::READ_IO_MAP || reply_bytes(*code).is_some());
    };
    if !reply.status.is_known() {
        return false;
    }
    match reply_bytes(reply.opcode) {
        // A refusal may be as short as its status, and a sensor's answer may be cut at what there is.
        _ if reply.status.0 != 0 => true,
        Some(expected) => length == expected,
        None if reply.opcode != opcode::READ_IO_MAP => false,
        None if begun.len() == length => io_maps::parse_reply(&reply).is_some(),
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
        let unsigned = HEADER_BYTES + usize::from(*payload) + CHECKSUM_BYTES;
        length == unsigned || length == unsigned + SIGNATURE_BYTES
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const VERSION: [u8; 9] = [0x07, 0x00, 0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01];
    const DONE: [u8; 5] = [0x03, 0x00, 0x02, 0x05, 0x00];

    fn cut(chunks: &[&[u8]]) -> (Vec<TelegramPart>, TelegramFramer) {
        let mut cutter = TelegramFramer::new(WheelSource::Polled);
        let mut found = Vec::new();
        for chunk in chunks {
            cutter.push(Timestamp::ZERO, chunk, &mut found);
        }
        (found, cutter)
    }

    #[test]
    fn a_telegram_with_an_extra_byte_behind_it_is_rejected() {
        let (found, cutter) = cut(&[&[&VERSION[..], &[0xFF, 0xFF]].concat()]);
        assert_eq!(found, [TelegramPart::OutOfSync { bytes: 11 }]);
        assert!(cutter.is_draining());
    }

    #[test]
    fn a_telegram_waits_for_what_follows_it_in_the_same_chunk() {
        let (found, mut cutter) = cut(&[&[&VERSION[..], &[0x03]].concat()]);
        assert_eq!(found, []);
        let mut later = Vec::new();
        cutter.push(Timestamp::ZERO, &DONE[1..], &mut later);
        let expected = [&VERSION[2..], &DONE[2..]].map(|bytes| TelegramPart::Telegram(bytes.to_vec()));
        assert_eq!(later, expected);

        let (_, mut cutter) = cut(&[&[&VERSION[..], &[0x03]].concat()]);
        let part = cutter.expire(Timestamp::from_millis(100));
        assert_eq!(part, Some(TelegramPart::OutOfSync { bytes: 10 }));
    }

    #[test]
    fn the_first_wrong_byte_is_enough_and_silence_ends_the_drain() {
        // A reply to a command that is never sent.
        let (found, mut cutter) = cut(&[&[0x07], &[0x00], &[0x02], &[0x55], &VERSION]);
        let expected = [4, 9].map(|bytes| TelegramPart::OutOfSync { bytes });
        assert_eq!(found, expected);
        assert_eq!(cutter.deadline(), Some(Timestamp::from_millis(100)));
        assert_eq!(cutter.expire(Timestamp::from_millis(99)), None);
        assert!(cutter.is_draining());
        assert_eq!(cutter.expire(Timestamp::from_millis(100)), None);
        assert!(!cutter.is_draining());
    }

    #[test]
    fn lengths_that_contradict_opcode_or_map_are_refused() {
        let long_version = [0x08, 0x00, 0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01, 0x00];
        let unknown_status = [0x03, 0x00, 0x02, 0x05, 0x01];
        let unrequested = [0x03, 0x00, 0x02, 0x55, 0x00];
        let nothing = [0x00, 0x00];
        let too_long = [0x81, 0x00];
        let wrong_map: [u8; 12] = [0x0D, 0, 2, 0x94, 0, 1, 0, 1, 0, 5, 0, 0];
        for bytes in [&long_version[..], &unknown_status, &unrequested, &nothing, &too_long, &wrong_map] {
            let (found, cutter) = cut(&[bytes]);
            assert_eq!(found, [TelegramPart::OutOfSync { bytes: bytes.len() }]);
            assert!(cutter.is_draining(), "{bytes:02x?}");
        }
    }

    /// What a user's program writes with `BluetoothWrite`, behind its length.
    const HELLO: [u8; 8] = *b"\x06\x00hello\x00";

    #[test]
    fn a_programs_own_message_is_foreign_and_the_telegrams_around_it_are_accepted() {
        let hello = || TelegramPart::Foreign(HELLO[2..].to_vec());
        let version = || TelegramPart::Telegram(VERSION[2..].to_vec());
        let (found, cutter) = cut(&[&HELLO, &VERSION, &HELLO]);
        assert_eq!(found, [hello(), version(), hello()]);
        assert_eq!(cutter.deadline(), None);
        let together = [&VERSION[..], &HELLO, &VERSION].concat();
        for size in 1..=together.len() {
            let chunks: Vec<&[u8]> = together.chunks(size).collect();
            let (found, _) = cut(&chunks);
            assert_eq!(found, [version(), hello(), version()], "chunks of {size}");
        }
    }

    #[test]
    fn a_drain_ends_between_two_messages_of_a_program_that_never_rests() {
        let mut cutter = TelegramFramer::new(WheelSource::Polled);
        let mut found = Vec::new();
        cutter.push(Timestamp::ZERO, &[0xFF, 0xFF], &mut found);
        for step in 1..30 {
            let now = Timestamp::from_millis(80 * step);
            assert_eq!(cutter.expire(now), None);
            cutter.push(now, &HELLO, &mut found);
        }
        let foreign = found.iter().filter(|piece| **piece == TelegramPart::Foreign(HELLO[2..].to_vec()));
        // Those of the first second are thrown away, and the one that ends it.
        assert_eq!(foreign.count(), 29 - 13);
        assert!(!cutter.is_draining());
    }
}
