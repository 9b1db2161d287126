//! Signatures of a foreign implementation hold, ours are the same bytes, and nothing else is accepted.
//!
//! The frames come from pymavlink (tests/data/README.md). That no changed frame is accepted, bit by bit, the fuzz target `signing` shows.

use std::collections::BTreeSet;

use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::signing::{
    Key, LinkSigner, RADIO_STATUS, ShutdownKind, SigningConfig, SigningState, SigningTime, UnsignedPolicy,
};
use posebridge_telemetry::{Address, HostClock, SignatureError, TimeDelta, Timestamp};
use proptest::prelude::*;

use crate::support::{HEARTBEAT, ROBOT, fixed_cases, from_hex, with_frame};

/// Some instant in 2025.
const NOW: u64 = 34_000_000_000_000;

/// One frame of signed.json.
struct Case {
    name: String,
    key: Option<usize>,
    link_id: u8,
    timestamp: u64,
    frame: Vec<u8>,
}

fn golden() -> (Vec<Key>, Vec<Case>) {
    let text = include_str!("../data/signed.json");
    let json: serde_json::Value = serde_json::from_str(text).expect("JSON");
    let keys = json["keys"].as_array().expect("keys").iter();
    let keys = keys.map(|key| key.as_str().expect("a key").parse().expect("a key"));
    let cases = json["cases"].as_array().expect("cases").iter();
    let cases = cases.map(|case| Case {
        name: case["name"].as_str().expect("a name").to_owned(),
        key: case["key"].as_u64().map(|key| key as usize),
        link_id: case["link_id"].as_u64().expect("a number") as u8,
        timestamp: case["timestamp"].as_u64().expect("a number"),
        frame: from_hex(case["frame"].as_str().expect("hexadecimal")),
    });
    (keys.collect(), cases.collect())
}

fn config(key: &Key, clock: u64) -> SigningConfig {
    let clock = SigningTime::from_units(clock);
    SigningConfig {
        key: key.clone(),
        link_id: 3,
        unsigned: UnsignedPolicy::RejectExcept(BTreeSet::from([RADIO_STATUS])),
        state: SigningState { written_at: clock, clock, ..SigningState::default() },
    }
}

fn key() -> Key {
    Key::from_bytes([0x42; 32])
}

fn link(clock: u64) -> LinkSigner {
    LinkSigner::new(config(&key(), clock))
}

fn verify(link: &mut LinkSigner, now: Timestamp<HostClock>, bytes: &[u8]) -> Result<(), SignatureError> {
    with_frame(bytes, |frame| link.verify(now, frame))
}

/// A heartbeat of a sender, signed at a time by our own signer, which the golden frames vouch for.
fn signed(from: Address, link_id: u8, timestamp: u64) -> Vec<u8> {
    let mut sender = LinkSigner::new(SigningConfig { link_id, ..config(&key(), timestamp) });
    let seal = sender.next_signer(Timestamp::ZERO).expect("it has a time");
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode_signed(from, &HEARTBEAT, &seal, &mut bytes);
    bytes
}

#[test]
fn foreign_signatures_hold_and_ours_are_the_same_bytes() {
    let (keys, cases) = golden();
    let mut checked = 0;
    for case in &cases {
        let Some(key) = case.key.map(|index| &keys[index]) else {
            continue;
        };
        let mut receiver = LinkSigner::new(config(key, case.timestamp));
        assert_eq!(verify(&mut receiver, Timestamp::ZERO, &case.frame), Ok(()), "{}", case.name);
        // A sender's first stamp is 1, because it has used 0 before.
        let Some(before) = case.timestamp.checked_sub(1) else {
            continue;
        };
        let mut sender = LinkSigner::new(SigningConfig {
            link_id: case.link_id,
            state: SigningState { last_sent: SigningTime::from_units(before), ..SigningState::default() },
            ..config(key, 0)
        });
        let seal = sender.next_signer(Timestamp::ZERO).expect("one is left");
        let (from, sequence, message) = with_frame(&case.frame, |frame| {
            let message = decode(frame).expect("it makes sense");
            (frame.source, frame.sequence, message.expect("we know it"))
        });
        let mut encoder = Encoder::new(WireVersion::V2);
        let mut bytes = Vec::new();
        for _ in 0..=sequence {
            bytes.clear();
            encoder.encode_signed(from, &message, &seal, &mut bytes);
        }
        assert_eq!(bytes, case.frame, "{}", case.name);
        checked += 1;
    }
    assert_eq!(checked, 5);
}

#[test]
fn a_frame_is_refused_for_its_own_reason() {
    let (keys, cases) = golden();
    let frame = |name: &str| {
        let found = cases.iter().find(|case| case.name == name);
        &found.expect("it is there").frame
    };
    let mut link = LinkSigner::new(config(&keys[0], 123_456_789));
    let mut check = |name, expected| {
        assert_eq!(verify(&mut link, Timestamp::ZERO, frame(name)), expected, "{name}");
    };
    check("heartbeat_other_key", Err(SignatureError::Invalid));
    check("heartbeat_unsigned", Err(SignatureError::Unsigned));
    check("v1_heartbeat", Err(SignatureError::Unsigned));
    check("radio_status_unsigned", Ok(()));
    check("heartbeat_first_instant", Err(SignatureError::Stale));
    check("heartbeat", Ok(()));
    check("heartbeat", Err(SignatureError::Replayed));
    check("heartbeat_unsigned", Err(SignatureError::Unsigned));
}

#[test]
fn where_unsigned_frames_are_accepted_a_wrong_signature_is_still_refused() {
    let (keys, cases) = golden();
    let mut link = LinkSigner::new(SigningConfig { unsigned: UnsignedPolicy::Accept, ..config(&keys[0], 0) });
    for case in &cases {
        let expected = if case.key == Some(1) { Err(SignatureError::Invalid) } else { Ok(()) };
        // Streams of their own: another test is about the order.
        let mut link = link.clone();
        assert_eq!(verify(&mut link, Timestamp::ZERO, &case.frame), expected, "{}", case.name);
    }
    assert!(link.next_signer(Timestamp::ZERO).is_some());
}

#[test]
fn a_new_stream_may_be_a_minute_behind_and_not_a_unit_more() {
    let later = Timestamp::from_millis(5_000);
    let minute = 6_000_000;
    let seconds = 500_000;
    let edge = NOW + seconds - minute;
    for (timestamp, expected) in [(edge, Ok(())), (edge - 1, Err(SignatureError::Stale))] {
        assert_eq!(verify(&mut link(NOW), later, &signed(ROBOT, 0, timestamp)), expected);
    }
    // An old acquaintance may be as far behind as it likes.
    let mut link = link(NOW);
    verify(&mut link, Timestamp::ZERO, &signed(ROBOT, 0, NOW)).unwrap();
    let much_later = Timestamp::from_millis(3_600_000);
    assert_eq!(verify(&mut link, much_later, &signed(ROBOT, 0, NOW + 1)), Ok(()));
    assert_eq!(verify(&mut link, much_later, &signed(ROBOT, 1, NOW + 1)), Err(SignatureError::Stale));
}

#[test]
fn own_stamps_rise_whatever_the_clock_does() {
    let mut link = link(NOW);
    let mut stamps = Vec::new();
    for millis in [5, 5, 5, 4, -7, 6] {
        let mut bytes = Vec::new();
        let seal = link.next_signer(Timestamp::from_millis(millis)).unwrap();
        Encoder::new(WireVersion::V2).encode_signed(ROBOT, &HEARTBEAT, &seal, &mut bytes);
        let mut wire = [0; 8];
        wire[..6].copy_from_slice(&bytes[bytes.len() - 12..bytes.len() - 6]);
        stamps.push(u64::from_le_bytes(wire));
    }
    assert_eq!(stamps, [500, 501, 502, 503, 504, 600].map(|units| NOW + units));
}

#[test]
fn mavlink_1_is_never_sent_where_frames_are_signed() {
    let mut link = link(NOW);
    let seal = link.next_signer(Timestamp::ZERO).unwrap();
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(WireVersion::V1);
    assert_eq!(encoder.encode_signed(ROBOT, &HEARTBEAT, &seal, &mut bytes), 0);
    assert!(bytes.is_empty());
}

#[test]
fn a_peer_that_is_ahead_sets_our_time_forward() {
    let mut station = link(0);
    let now = Timestamp::from_millis(1_000);
    verify(&mut station, now, &signed(ROBOT, 0, NOW)).unwrap();
    let memory = station.state(now);
    assert_eq!(memory.clock.units(), NOW);
    assert_eq!(memory.written_at.units(), 100_000);
    let second_later = Timestamp::from_millis(2_000);
    assert_eq!(station.state(second_later).clock.units(), NOW + 100_000);
    let seal = station.next_signer(second_later);
    assert!(seal.is_some());
    assert_eq!(station.state(second_later).last_sent.units(), NOW + 100_000);
    // A refused one does not.
    let mut station = link(0);
    let mut forged = signed(ROBOT, 0, NOW);
    *forged.last_mut().unwrap() ^= 1;
    assert_eq!(verify(&mut station, now, &forged), Err(SignatureError::Invalid));
    assert_eq!(station.state(now).clock.units(), 100_000);
}

#[test]
fn the_number_of_streams_is_bounded_and_evicted_frames_are_rejected() {
    let mut link = link(NOW);
    let sender = |k: u64| Address::new((k / 200) as u8, (k % 200) as u8);
    for k in 0..1_025 {
        let frame = signed(sender(k), 0, NOW + k);
        assert_eq!(verify(&mut link, Timestamp::ZERO, &frame), Ok(()), "{k}");
    }
    let memory = link.state(Timestamp::ZERO);
    assert_eq!(memory.streams.len(), 1_024);
    assert_eq!(memory.min_timestamp.map(SigningTime::units), Some(NOW));
    assert_eq!(link.streams_seen(), 1_025);
    let again = signed(sender(0), 0, NOW);
    assert_eq!(verify(&mut link, Timestamp::ZERO, &again), Err(SignatureError::Stale));
    let goes_on = signed(sender(0), 0, NOW + 2_000);
    assert_eq!(verify(&mut link, Timestamp::ZERO, &goes_on), Ok(()));
}

/// What happens to a station in the next test.
#[derive(Clone, Debug)]
enum SigningEvent {
    /// This much time passes.
    Wait(i64),
    /// A sender sends a new frame, and it arrives.
    Send(u8),
    /// An earlier frame arrives once more.
    Replay(prop::sample::Index),
    /// The memory is written down.
    Write,
    /// The station is cut off and starts again.
    Restart,
}

fn event() -> impl Strategy<Value = SigningEvent> {
    prop_oneof![
        3 => (0..2_000_i64).prop_map(SigningEvent::Wait),
        6 => (0..3_u8).prop_map(SigningEvent::Send),
        6 => any::<prop::sample::Index>().prop_map(SigningEvent::Replay),
        1 => Just(SigningEvent::Write),
        1 => Just(SigningEvent::Restart),
    ]
}

/// A station that writes its memory down as the program does: each second, and when a stream is new.
struct Station {
    link: LinkSigner,
    started_ms: i64,
    written: SigningState,
    written_ms: i64,
    written_streams: u64,
}

impl Station {
    fn start(memory: SigningState, now_ms: i64) -> Self {
        let written = memory.clone();
        let memory = SigningConfig { state: memory, ..config(&key(), NOW) };
        Self { link: LinkSigner::new(memory), started_ms: now_ms, written, written_ms: now_ms, written_streams: 0 }
    }

    fn receive(&mut self, now_ms: i64, frame: &[u8]) -> Result<(), SignatureError> {
        let now = Timestamp::from_millis(now_ms - self.started_ms);
        let verdict = verify(&mut self.link, now, frame);
        if self.link.streams_seen() > self.written_streams || now_ms - self.written_ms >= 1_000 {
            self.write(now_ms);
        }
        verdict
    }

    fn write(&mut self, now_ms: i64) {
        self.written = self.link.state(Timestamp::from_millis(now_ms - self.started_ms));
        self.written_ms = now_ms;
        self.written_streams = self.link.streams_seen();
    }

    fn restart(self, now_ms: i64) -> Self {
        let utc = utc(now_ms);
        Self::start(self.written.resume(utc, ShutdownKind::Interrupted), now_ms)
    }
}

fn utc(now_ms: i64) -> SigningTime {
    SigningTime::from_units(NOW).saturating_add(TimeDelta::from_millis(now_ms))
}

proptest! {
    #![proptest_config(fixed_cases(256))]

    #[test]
    fn no_frame_is_accepted_twice_however_often_the_station_is_killed(
        events in prop::collection::vec(event(), 1..120)
    ) {
        let mut now_ms = 0;
        let mut station = Station::start(config(&key(), NOW).state, now_ms);
        let mut sent: Vec<Vec<u8>> = Vec::new();
        let mut senders = [0_u64; 3];
        for event in events {
            match event {
                SigningEvent::Wait(millis) => {
                    now_ms += millis;
                    // The shell writes each second whether anything is received or not.
                    if now_ms - station.written_ms >= 1_000 {
                        station.write(now_ms);
                    }
                }
                SigningEvent::Send(k) => {
                    let last = &mut senders[usize::from(k)];
                    *last = utc(now_ms).units().max(*last + 1);
                    let frame = signed(Address::new(k, 1), 0, *last);
                    // Whatever the verdict: from now on it is old.
                    let _verdict = station.receive(now_ms, &frame);
                    sent.push(frame);
                }
                SigningEvent::Replay(_) if sent.is_empty() => {}
                SigningEvent::Replay(index) => {
                    let frame = index.get(&sent).clone();
                    prop_assert!(station.receive(now_ms, &frame).is_err());
                }
                SigningEvent::Write => station.write(now_ms),
                SigningEvent::Restart => station = station.restart(now_ms),
            }
        }
    }
}
