//! Several senders, repeated frames, passing time and ending sessions: a frame of a key holder is accepted exactly
//! once.
//!
//! # Oracle
//! ```text
//! stream known     accepted when its timestamp is later than the last accepted one, else Replayed
//! stream not known Stale below the floor or more than a minute behind the clock, else accepted
//! ```

use std::collections::BTreeMap;

use posebridge::config::MemoryRecord;
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::signing::{
    Key, LinkSigner, ShutdownKind, SigningConfig, SigningState, SigningTime, StreamId, UnsignedPolicy,
};
use posebridge_telemetry::{Address, HostClock, SignatureError, TimeDelta, Timestamp};

use super::inputs::{for_each_frame, key, start};
use crate::operands::Operands;

/// Most streams that a link may remember.
const MAX_STREAMS: usize = 1_024;
/// A minute, in units of 10 µs.
const MINUTE: u64 = 6_000_000;
/// Frames of one input, all in all.
const MAX_FRAMES: usize = 2_000;
/// Streams that begin by one operation, and operations that may do so: together a few more than are remembered.
const STREAM_BURST: u16 = 240;
const MAX_STREAM_BURSTS: u8 = 5;

/// Input: time, then operations.
pub(super) fn check(mut operands: Operands<'_>) {
    let mut talk = SignedExchange::new(start(operands.byte()));
    while !operands.is_empty() && talk.sent_frames.len() < MAX_FRAMES {
        match operands.byte() % 8 {
            0 => talk.advance(TimeDelta::from_millis(i64::from(operands.number()))),
            1..=3 => talk.send(operands.byte(), operands.number()),
            4 => talk.repeat(usize::from(operands.number())),
            5 => talk.sign(),
            6 => talk.send_burst(operands.byte()),
            _ => talk.restart(operands.byte()),
        }
    }
    talk.finish();
}

struct SignedExchange {
    key: Key,
    link: LinkSigner,
    now: Timestamp<HostClock>,
    /// The computer's date at the host clock's zero.
    date: SigningTime,
    /// Every frame that was ever sent, with whether it was believed.
    sent_frames: Vec<(Vec<u8>, bool)>,
    own: Option<SigningTime>,
    stream_bursts: u8,
}

impl SignedExchange {
    fn new(date: SigningTime) -> Self {
        let key = key(0);
        let memory = SigningState { written_at: date, clock: date, ..SigningState::default() };
        Self {
            link: opened(&key, memory),
            key,
            now: Timestamp::ZERO,
            date,
            sent_frames: Vec::new(),
            own: None,
            stream_bursts: 0,
        }
    }

    fn advance(&mut self, span: TimeDelta) {
        let before = self.link.state(self.now);
        self.now = self.now + span;
        let after = self.link.state(self.now);
        assert!(after.clock >= before.clock && after.written_at >= before.written_at);
        assert_eq!((after.last_sent, after.streams), (before.last_sent, before.streams));
    }

    /// One of twelve streams says something, a little before or after the time of signatures.
    fn send(&mut self, who: u8, offset: u16) {
        let clock = self.link.state(self.now).clock.units();
        // A square, so that both a unit and more than a minute can be reached.
        let distance = i64::from(offset as i16);
        let units = clock.saturating_add_signed(distance * distance.abs());
        let source = Address::new(1 + who % 4, 1);
        let link_id = (who >> 2) % 3;
        let frame = signed(&self.key, source, link_id, SigningTime::from_units(units));
        let is_believed = self.receive(&frame);
        self.sent_frames.push((frame, is_believed));
    }

    fn repeat(&mut self, index: usize) {
        let Some(index) = index.checked_rem(self.sent_frames.len()) else {
            return;
        };
        let (frame, was_believed) = self.sent_frames[index].clone();
        let is_believed = self.receive(&frame);
        assert!(!(was_believed && is_believed), "a frame was believed twice");
        self.sent_frames[index].1 |= is_believed;
    }

    /// Many streams at once: somebody who holds the key counts through all addresses.
    fn send_burst(&mut self, first: u8) {
        if self.stream_bursts >= MAX_STREAM_BURSTS {
            return;
        }
        self.stream_bursts += 1;
        let clock = self.link.state(self.now).clock;
        for number in 0..STREAM_BURST {
            let source = Address::new(10 + number as u8, 1);
            let frame = signed(&self.key, source, first, clock);
            let is_believed = self.validate(&frame);
            self.sent_frames.push((frame, is_believed));
        }
        let streams = self.link.state(self.now).streams.len();
        assert!(streams <= MAX_STREAMS, "{streams} streams");
    }

    /// Gives a frame to the link and holds the verdict and what is remembered against the oracle.
    fn receive(&mut self, frame: &[u8]) -> bool {
        let before = self.link.state(self.now);
        let expected = expected(&before, frame);
        let is_believed = self.validate(frame);
        assert_eq!(is_believed, expected.is_ok(), "{expected:?}");
        let after = self.link.state(self.now);
        assert!(after.streams.len() <= MAX_STREAMS, "too many streams");
        assert!(after.min_timestamp >= before.min_timestamp && after.clock >= before.clock);
        assert!(is_believed || before == after, "a refused frame left a trace");
        is_believed
    }

    fn validate(&mut self, bytes: &[u8]) -> bool {
        let (link, now) = (&mut self.link, self.now);
        let mut verdicts = Vec::new();
        for_each_frame(bytes, |frame| verdicts.push(link.verify(now, frame)));
        match verdicts[..] {
            [verdict] => verdict.is_ok(),
            _ => panic!("what was encoded is no frame"),
        }
    }

    /// We sign something: later than everything before, until time has run out.
    fn sign(&mut self) {
        let clock = self.link.state(self.now).clock;
        let is_signed = self.link.next_signer(self.now).is_some();
        let own = self.link.state(self.now).last_sent;
        assert_eq!(is_signed, self.own != Some(SigningTime::MAX));
        if is_signed {
            assert!(self.own.is_none_or(|last| own > last), "a stamp was used twice");
            assert!(own >= clock);
            self.own = Some(own);
        }
    }

    /// The session ends well, or is cut right after its memory was written; the date may have fallen meanwhile.
    fn restart(&mut self, how: u8) {
        let memory = self.link.state(self.now);
        let record = MemoryRecord::of(&self.key, &memory);
        // As text it is another part's business, which has no thousand streams.
        assert_eq!(record.memory(), memory);
        let away = TimeDelta::from_millis(i64::from(how >> 2) * 500);
        if how & 1 == 0 {
            self.date = memory.written_at.saturating_add(away);
        }
        let ending = if how & 2 == 0 { ShutdownKind::Clean } else { ShutdownKind::Interrupted };
        let resumed = record.memory().resume(self.date, ending);
        // The last stamp that may have been used: nothing at all may come at or below it.
        if ending == ShutdownKind::Interrupted {
            self.own = Some(resumed.last_sent);
        }
        self.link = opened(&self.key, resumed);
        self.now = Timestamp::ZERO;
    }

    /// Whatever was believed is refused, however much has been heard since.
    fn finish(mut self) {
        let before = self.link.state(self.now);
        for (frame, was_believed) in std::mem::take(&mut self.sent_frames) {
            assert!(!(was_believed && self.validate(&frame)), "a frame was believed twice");
        }
        assert_eq!(self.link.state(self.now), before);
    }
}

fn opened(key: &Key, memory: SigningState) -> LinkSigner {
    LinkSigner::new(SigningConfig {
        key: key.clone(),
        link_id: 7,
        unsigned: UnsignedPolicy::RejectExcept([].into()),
        state: memory,
    })
}

/// What must become of a frame that was signed with the right key.
fn expected(memory: &SigningState, raw: &[u8]) -> Result<(), SignatureError> {
    let source = Address::new(raw[5], raw[6]);
    let Some((_, &[link_id, a, b, c, d, e, f, _, _, _, _, _, _])) = raw.split_last_chunk::<13>() else {
        panic!("a signed frame is longer");
    };
    let timestamp = SigningTime::from_units(u64::from_le_bytes([a, b, c, d, e, f, 0, 0]));
    let last = memory.streams.get(&StreamId { source, link_id });
    match last.map(|heard| heard.timestamp) {
        Some(last) if timestamp <= last => Err(SignatureError::Replayed),
        None if memory.min_timestamp.is_some_and(|floor| timestamp <= floor) => Err(SignatureError::Stale),
        None if memory.clock.units().saturating_sub(timestamp.units()) > MINUTE => Err(SignatureError::Stale),
        Some(_) | None => Ok(()),
    }
}

/// A heartbeat that is signed at a time, which is at least a unit after the first there is.
fn signed(key: &Key, from: Address, link_id: u8, timestamp: SigningTime) -> Vec<u8> {
    let mut sender = LinkSigner::new(SigningConfig {
        key: key.clone(),
        link_id,
        unsigned: UnsignedPolicy::Accept,
        state: SigningState { clock: timestamp, streams: BTreeMap::new(), ..SigningState::default() },
    });
    let mut bytes = Vec::new();
    if let Some(seal) = sender.next_signer(Timestamp::ZERO) {
        Encoder::new(WireVersion::V2).encode_signed(from, &HEARTBEAT, &seal, &mut bytes);
    }
    bytes
}

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });
