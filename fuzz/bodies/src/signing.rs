//! Signatures: no frame is accepted twice or after a change, own timestamps only increase, and the stored state
//! survives a session.
//!
//! The first byte selects the meaning of the others: bytes of a link with foreign signatures, an exchange of several
//! senders, the text of a key file, or the text of the state that is stored beside a key.

use std::collections::{BTreeMap, BTreeSet};

use posebridge::config::MemoryRecord;
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput, START_BYTE_V2, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::signing::{
    FLAG_SIGNED, Key, KeyError, LinkSigner, RADIO_STATUS, ShutdownKind, SigningConfig, SigningState, SigningTime,
    StreamId, UnsignedPolicy,
};
use posebridge_telemetry::{Address, HostClock, SignatureError, TimeDelta, Timestamp};

use crate::operands::Operands;

/// Input: one byte that chooses the part, then what that part reads.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    match operands.byte() % 4 {
        0 => check_wire(operands),
        1 => check_exchange(operands),
        2 => check_key(operands.remaining()),
        _ => check_memory(operands.remaining()),
    }
}

/// The two keys of protocol/tests/data/signed.json, so that its frames can be seeds.
fn key(choice: u8) -> Key {
    let byte = |at: u8| match choice % 2 {
        0 => at,
        _ => 0xFF_u8.wrapping_sub(at.wrapping_mul(5)),
    };
    let mut bytes = [0; 32];
    for (at, place) in (0..).zip(&mut bytes) {
        *place = byte(at);
    }
    Key::from_bytes(bytes)
}

/// A start time: the first possible one, one in 2025, one shortly before the last, and the last.
fn start(choice: u8) -> SigningTime {
    let last = SigningTime::MAX.units();
    SigningTime::from_units(match choice % 4 {
        0 => 0,
        1 => 34_000_000_000_000,
        2 => last - 20_000_000,
        _ => last - u64::from(choice / 4),
    })
}

/// Calls `visit` with every verified frame in some bytes, MAVLink 1 included.
fn for_each_frame(bytes: &[u8], mut visit: impl FnMut(&FrameRef<'_>)) {
    let mut framer = Framer::new(FramerConfig { accept_v1: true, ..FramerConfig::default() });
    let mut on_output = |found: FramerOutput<'_>| {
        if let FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame) = found {
            visit(&frame);
        }
    };
    framer.push(Timestamp::ZERO, bytes, &mut on_output);
    if let Some(deadline) = framer.deadline() {
        framer.tick(deadline, &mut on_output);
    }
}

/// Bits of a believed frame that are turned over, spread over its length; a heartbeat has as many.
const MAX_FLIPS: usize = 264;
/// Believed frames of one input of which bits are turned over.
const MAX_FLIPPED_BITS: u32 = 3;

/// Input: key, time, one byte of options, then the bytes of a link.
fn check_wire(mut operands: Operands<'_>) {
    let key = key(operands.byte());
    let clock = start(operands.byte());
    let options = operands.byte();
    let unsigned = if options & 1 == 0 {
        UnsignedPolicy::RejectExcept(BTreeSet::from([RADIO_STATUS]))
    } else {
        UnsignedPolicy::Accept
    };
    let mut link = LinkSigner::new(SigningConfig {
        key,
        link_id: options >> 1,
        unsigned,
        state: SigningState { written_at: clock, clock, ..SigningState::default() },
    });
    let mut flipped = 0;
    for_each_frame(operands.remaining(), |frame| {
        if check_frame(&mut link, frame) && flipped < MAX_FLIPPED_BITS {
            flipped += 1;
            let before = link.state(Timestamp::ZERO);
            check_flips(&mut link, frame);
            assert_eq!(link.state(Timestamp::ZERO), before, "a changed frame left a trace");
        }
    });
}

/// Whether the frame was believed for its signature.
fn check_frame(link: &mut LinkSigner, frame: &FrameRef<'_>) -> bool {
    let before = link.state(Timestamp::ZERO);
    let verdict = link.verify(Timestamp::ZERO, frame);
    let after = link.state(Timestamp::ZERO);
    let is_signed =
        frame.raw.starts_with(&[START_BYTE_V2]) && frame.raw.get(2).is_some_and(|flags| flags & FLAG_SIGNED != 0);
    if verdict.is_err() || !is_signed {
        assert_eq!(before, after, "a refused or unsigned frame left a trace");
    }
    if !is_signed {
        assert!(matches!(verdict, Ok(()) | Err(SignatureError::Unsigned)));
        return false;
    }
    if verdict.is_ok() {
        assert!(after.clock >= before.clock);
        assert_eq!(link.verify(Timestamp::ZERO, frame), Err(SignatureError::Replayed));
        assert_eq!(link.state(Timestamp::ZERO), after, "a repeated frame left a trace");
    }
    verdict.is_ok()
}

/// Whoever turns bits over on the way, and mends the checksum, is not believed.
fn check_flips(link: &mut LinkSigner, frame: &FrameRef<'_>) {
    let bits = 8 * frame.raw.len();
    let mut raw = frame.raw.to_vec();
    for bit in (0..bits).step_by(bits.div_ceil(MAX_FLIPS)) {
        let (place, mask) = (bit / 8, 1 << (bit % 8));
        if place == 0 || (place == 2 && mask == FLAG_SIGNED) {
            // It is then a frame without a signature, and judged as one.
            continue;
        }
        raw[place] ^= mask;
        let changed = reread(&raw, frame);
        let verdict = link.verify(Timestamp::ZERO, &changed);
        assert_eq!(verdict, Err(SignatureError::Invalid), "bit {bit}");
        raw[place] ^= mask;
    }
}

/// The frame of changed bytes, as a framer that does not look at checksums would hand it out.
fn reread<'a>(raw: &'a [u8], whole: &FrameRef<'a>) -> FrameRef<'a> {
    let byte = |at: usize| raw.get(at).copied().unwrap_or(0);
    FrameRef {
        message_id: u32::from_le_bytes([byte(7), byte(8), byte(9), 0]),
        source: Address::new(byte(5), byte(6)),
        sequence: byte(4),
        payload: raw.get(10..10 + whole.payload.len()).unwrap_or_default(),
        raw,
        version: whole.version,
    }
}

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
fn check_exchange(mut operands: Operands<'_>) {
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
        let expected = expected_verdict(&before, frame);
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
fn expected_verdict(memory: &SigningState, raw: &[u8]) -> Result<(), SignatureError> {
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

/// Digits of a key.
const DIGITS: usize = 64;

/// Input: the text of a key file; bytes that are none never come this far.
fn check_key(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let characters: Vec<char> = text.trim().chars().collect();
    match text.parse::<Key>() {
        Ok(key) => {
            let hex = key.reveal_hex();
            assert_eq!(hex, text.trim().to_lowercase());
            assert_eq!(hex.parse::<Key>().as_ref(), Ok(&key));
            let shown = format!("{key:?} {}", key.name());
            // Eight digits of a hash may stand in a key by chance; sixteen of its own must not stand in what is shown.
            let mut parts = hex.as_bytes().windows(16);
            assert!(parts.all(|part| !shown.as_bytes().windows(16).any(|seen| seen == part)));
        }
        Err(KeyError::Length { found }) => {
            assert_eq!(found, characters.len());
            assert_ne!(found, DIGITS);
        }
        Err(KeyError::Digit { position }) => {
            assert_eq!(characters.len(), DIGITS);
            let first = characters.iter().position(|digit| !digit.is_ascii_hexdigit());
            assert_eq!(first, position.checked_sub(1));
        }
        Err(other) => panic!("{other}"),
    }
}

/// Input: the text of a memory, as it stands in a file beside a key and in a recording's configuration.
fn check_memory(data: &[u8]) {
    let Ok(record) = std::str::from_utf8(data)
        .map_or_else(|_no_text| Err(None), |text| toml::from_str::<MemoryRecord>(text).map_err(Some))
    else {
        return;
    };
    let memory = record.memory();
    check_written(&memory);
    for ending in [ShutdownKind::Clean, ShutdownKind::Interrupted] {
        for utc in (0..4).map(start) {
            check_resumed(&memory, utc, ending);
        }
    }
}

/// A memory is read as it was written.
fn check_written(memory: &SigningState) {
    let written = toml::to_string(&MemoryRecord::of(&key(0), memory)).map_err(|error| error.to_string());
    let again =
        written.and_then(|text| toml::from_str::<MemoryRecord>(&text).map_err(|error| format!("{error}\n{text}")));
    match again {
        Ok(again) => assert_eq!(again.memory(), *memory),
        Err(error) => panic!("a memory cannot be kept: {error}"),
    }
}

/// No time goes back by a restart, and what was used is not used again.
fn check_resumed(memory: &SigningState, utc: SigningTime, ending: ShutdownKind) {
    let resumed = memory.clone().resume(utc, ending);
    assert_eq!(resumed.written_at, utc);
    assert!(resumed.clock >= memory.clock && resumed.clock >= utc);
    assert!(resumed.last_sent >= memory.last_sent);
    assert_eq!(resumed.min_timestamp, memory.min_timestamp);
    assert_eq!(resumed.streams.len(), memory.streams.len());
    for (stream, heard) in &memory.streams {
        let after = resumed.streams.get(stream).map(|heard| heard.timestamp);
        assert!(after >= Some(heard.timestamp), "{stream:?}");
    }
    let own = resumed.last_sent;
    let mut link =
        LinkSigner::new(SigningConfig { key: key(0), link_id: 0, unsigned: UnsignedPolicy::Accept, state: resumed });
    let is_signed = link.next_signer(Timestamp::ZERO).is_some();
    assert_eq!(is_signed, own < SigningTime::MAX, "{own:?}");
    assert!(link.state(Timestamp::ZERO).last_sent > own || !is_signed);
}
