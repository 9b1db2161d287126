//! Several senders, repeated frames, time that passes and sessions that end: who holds the key is believed once per frame.
//!
//! # Oracle
//! ```text
//! stream known     believed when its timestamp is later than the last believed one, else Replayed
//! stream not known Stale below the floor or more than a minute behind the clock, else believed
//! ```

use std::collections::BTreeMap;

use posebridge::config::MemoryRecord;
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::signing::{Ending, Key, LinkSigning, Memory, SigningConfig, StreamId, Timestamp, Unsigned};
use posebridge_telemetry::{Address, HostClock, Refusal, Span, Stamp};

use super::{frames, key, start};
use crate::operands::Operands;

/// Most streams that a link may remember.
const MOST_STREAMS: usize = 1_024;
/// A minute, in units of 10 µs.
const MINUTE: u64 = 6_000_000;
/// Frames of one input, all in all.
const MOST_FRAMES: usize = 2_000;
/// Streams that begin by one operation, and operations that may do so: together a few more than are remembered.
const CROWD: u16 = 240;
const MOST_CROWDS: u8 = 5;

/// Input: time, then operations.
pub(super) fn check(mut operands: Operands<'_>) {
    let mut talk = Talk::new(start(operands.byte()));
    while !operands.is_empty() && talk.said.len() < MOST_FRAMES {
        match operands.byte() % 8 {
            0 => talk.pass(Span::from_millis(i64::from(operands.number()))),
            1..=3 => talk.say(operands.byte(), operands.number()),
            4 => talk.repeat(usize::from(operands.number())),
            5 => talk.sign(),
            6 => talk.crowd(operands.byte()),
            _ => talk.restart(operands.byte()),
        }
    }
    talk.finish();
}

struct Talk {
    key: Key,
    link: LinkSigning,
    now: Stamp<HostClock>,
    /// The computer's date at the host clock's zero.
    date: Timestamp,
    /// Every frame that was ever sent, with whether it was believed.
    said: Vec<(Vec<u8>, bool)>,
    own: Option<Timestamp>,
    crowds: u8,
}

impl Talk {
    fn new(date: Timestamp) -> Self {
        let key = key(0);
        let memory = Memory { written: date, clock: date, ..Memory::default() };
        Self { link: opened(&key, memory), key, now: Stamp::ZERO, date, said: Vec::new(), own: None, crowds: 0 }
    }

    fn pass(&mut self, span: Span) {
        let before = self.link.memory(self.now);
        self.now = self.now + span;
        let after = self.link.memory(self.now);
        assert!(after.clock >= before.clock && after.written >= before.written);
        assert_eq!((after.own, after.streams), (before.own, before.streams));
    }

    /// One of twelve streams says something, a little before or after the time of signatures.
    fn say(&mut self, who: u8, offset: u16) {
        let clock = self.link.memory(self.now).clock.units();
        // A square, so that both a unit and more than a minute can be reached.
        let distance = i64::from(offset as i16);
        let units = clock.saturating_add_signed(distance * distance.abs());
        let source = Address::new(1 + who % 4, 1);
        let link_id = (who >> 2) % 3;
        let frame = signed(&self.key, source, link_id, Timestamp::from_units(units));
        let is_believed = self.hear(&frame);
        self.said.push((frame, is_believed));
    }

    fn repeat(&mut self, index: usize) {
        let Some(index) = index.checked_rem(self.said.len()) else {
            return;
        };
        let (frame, was_believed) = self.said[index].clone();
        let is_believed = self.hear(&frame);
        assert!(!(was_believed && is_believed), "a frame was believed twice");
        self.said[index].1 |= is_believed;
    }

    /// Many streams at once: somebody who holds the key counts through all addresses.
    fn crowd(&mut self, first: u8) {
        if self.crowds >= MOST_CROWDS {
            return;
        }
        self.crowds += 1;
        let clock = self.link.memory(self.now).clock;
        for number in 0..CROWD {
            let source = Address::new(10 + number as u8, 1);
            let frame = signed(&self.key, source, first, clock);
            let is_believed = self.judge(&frame);
            self.said.push((frame, is_believed));
        }
        let streams = self.link.memory(self.now).streams.len();
        assert!(streams <= MOST_STREAMS, "{streams} streams");
    }

    /// Gives a frame to the link and holds the verdict and what is remembered against the oracle.
    fn hear(&mut self, frame: &[u8]) -> bool {
        let before = self.link.memory(self.now);
        let expected = expected(&before, frame);
        let is_believed = self.judge(frame);
        assert_eq!(is_believed, expected.is_ok(), "{expected:?}");
        let after = self.link.memory(self.now);
        assert!(after.streams.len() <= MOST_STREAMS, "too many streams");
        assert!(after.floor >= before.floor && after.clock >= before.clock);
        assert!(is_believed || before == after, "a refused frame left a trace");
        is_believed
    }

    fn judge(&mut self, bytes: &[u8]) -> bool {
        let (link, now) = (&mut self.link, self.now);
        let mut verdicts = Vec::new();
        frames(bytes, |frame| verdicts.push(link.judge(now, frame)));
        match verdicts[..] {
            [verdict] => verdict.is_ok(),
            _ => panic!("what was encoded is no frame"),
        }
    }

    /// We sign something: later than everything before, until time has run out.
    fn sign(&mut self) {
        let clock = self.link.memory(self.now).clock;
        let is_signed = self.link.next_seal(self.now).is_some();
        let own = self.link.memory(self.now).own;
        assert_eq!(is_signed, self.own != Some(Timestamp::MAX));
        if is_signed {
            assert!(self.own.is_none_or(|last| own > last), "a stamp was used twice");
            assert!(own >= clock);
            self.own = Some(own);
        }
    }

    /// The session ends well, or is cut right after its memory was written; the date may have fallen meanwhile.
    fn restart(&mut self, how: u8) {
        let memory = self.link.memory(self.now);
        let record = MemoryRecord::of(&self.key, &memory);
        // As text it is another part's business, which has no thousand streams.
        assert_eq!(record.memory(), memory);
        let away = Span::from_millis(i64::from(how >> 2) * 500);
        if how & 1 == 0 {
            self.date = memory.written.later(away);
        }
        let ending = if how & 2 == 0 { Ending::Closed } else { Ending::Cut };
        let resumed = record.memory().resumed(self.date, ending);
        // The last stamp that may have been used: nothing at all may come at or below it.
        if ending == Ending::Cut {
            self.own = Some(resumed.own);
        }
        self.link = opened(&self.key, resumed);
        self.now = Stamp::ZERO;
    }

    /// Whatever was believed is refused, however much has been heard since.
    fn finish(mut self) {
        let before = self.link.memory(self.now);
        for (frame, was_believed) in std::mem::take(&mut self.said) {
            assert!(!(was_believed && self.judge(&frame)), "a frame was believed twice");
        }
        assert_eq!(self.link.memory(self.now), before);
    }
}

fn opened(key: &Key, memory: Memory) -> LinkSigning {
    LinkSigning::new(SigningConfig {
        key: key.clone(),
        link_id: 7,
        unsigned: Unsigned::RefuseExcept([].into()),
        memory,
    })
}

/// What must become of a frame that was signed with the right key.
fn expected(memory: &Memory, raw: &[u8]) -> Result<(), Refusal> {
    let source = Address::new(raw[5], raw[6]);
    let Some((_, &[link_id, a, b, c, d, e, f, _, _, _, _, _, _])) = raw.split_last_chunk::<13>() else {
        panic!("a signed frame is longer");
    };
    let timestamp = Timestamp::from_units(u64::from_le_bytes([a, b, c, d, e, f, 0, 0]));
    let last = memory.streams.get(&StreamId { source, link_id });
    match last.map(|heard| heard.timestamp) {
        Some(last) if timestamp <= last => Err(Refusal::Replayed),
        None if memory.floor.is_some_and(|floor| timestamp <= floor) => Err(Refusal::Stale),
        None if memory.clock.units().saturating_sub(timestamp.units()) > MINUTE => Err(Refusal::Stale),
        Some(_) | None => Ok(()),
    }
}

/// A heartbeat that is signed at a time, which is at least a unit after the first there is.
fn signed(key: &Key, from: Address, link_id: u8, timestamp: Timestamp) -> Vec<u8> {
    let mut sender = LinkSigning::new(SigningConfig {
        key: key.clone(),
        link_id,
        unsigned: Unsigned::Accept,
        memory: Memory { clock: timestamp, streams: BTreeMap::new(), ..Memory::default() },
    });
    let mut bytes = Vec::new();
    if let Some(seal) = sender.next_seal(Stamp::ZERO) {
        Encoder::new(WireVersion::V2).encode_signed(from, &HEARTBEAT, &seal, &mut bytes);
    }
    bytes
}

const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });
