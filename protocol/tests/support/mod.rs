//! Frames, noise and owned results for all tests. The benchmark uses `mix`, and the station's tests `ev3_double`.

pub(crate) mod ev3_double;
pub(crate) mod mix;

use std::collections::BTreeMap;

use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings, brick_protocol};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerCounters, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, PlanarPose, PoseFlags, WireStamp};
use posebridge_telemetry::{
    Address, Arena, HostClock, MetersPerSecond, Pose, RadiansPerSecond, ReceiveError, TimeDelta, Timestamp,
};
use proptest::test_runner::{Config, RngSeed};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

pub(crate) const ROBOT: Address = Address::new(1, 1);
pub(crate) const CAMERA: Address = Address::new(1, 100);
pub(crate) const STATION: Address = Address::new(1, 197);
pub(crate) const GCS: Address = Address::new(255, 190);

pub(crate) const ROVER: Heartbeat = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };
pub(crate) const HEARTBEAT: Message = Message::Heartbeat(ROVER);

pub(crate) fn at(millis: i64) -> Timestamp<HostClock> {
    Timestamp::from_millis(millis)
}

/// Frames by name, made by pymavlink (tests/data/README.md).
pub(crate) fn golden_frames() -> BTreeMap<String, Vec<u8>> {
    frames_by_name(include_str!("../data/golden.json"))
}

pub(crate) fn frames_by_name(json: &str) -> BTreeMap<String, Vec<u8>> {
    let cases: BTreeMap<String, String> = serde_json::from_str(json).expect("names and hexadecimal digits");
    cases.into_iter().map(|(name, hex)| (name, from_hex(&hex))).collect()
}

/// Bytes of hexadecimal digits; anything else between them is left out.
pub(crate) fn from_hex(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.chars().filter_map(|digit| digit.to_digit(16)).map(|digit| digit as u8).collect();
    digits.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect()
}

/// What `inspect` makes of the only verified frame in these bytes, to which all of them belong.
pub(crate) fn with_frame<T>(bytes: &[u8], inspect: impl FnOnce(&FrameRef<'_>) -> T) -> T {
    let mut framer = Framer::new(FramerConfig { accept_v1: true, ..FramerConfig::default() });
    let (mut inspect, mut result) = (Some(inspect), None);
    framer.push(Timestamp::ZERO, bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found {
            result = inspect.take().map(|inspect| inspect(&frame));
        }
    });
    assert_eq!((framer.counters().frames, framer.counters().garbage_bytes), (1, 0));
    result.expect("one verified frame")
}

/// The frame with this sequence number, in MAVLink 2.
pub(crate) fn framed(sequence: u8, source: Address, message: &Message) -> Vec<u8> {
    let mut encoder = Encoder::new(WireVersion::V2);
    let mut bytes = Vec::new();
    for _ in 0..=sequence {
        bytes.clear();
        encoder.encode(source, message, &mut bytes);
    }
    bytes
}

pub(crate) fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut random = Pcg64::seed_from_u64(seed);
    (0..length).map(|_| random.random()).collect()
}

/// Properties run on the same cases each time: new ones are the fuzzer's business.
pub(crate) fn fixed_cases(cases: u32) -> Config {
    Config { cases, rng_seed: RngSeed::Fixed(20_260_101), failure_persistence: None, ..Config::default() }
}

/// A framer's output, owned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum OwnedFramerOutput {
    Frame(Vec<u8>),
    UnknownFrame(Vec<u8>),
    Error(ReceiveError),
}

pub(crate) fn owned(found: FramerOutput<'_>) -> OwnedFramerOutput {
    match found {
        FramerOutput::Frame(frame) => OwnedFramerOutput::Frame(frame.raw.to_vec()),
        FramerOutput::UnknownFrame(frame) => OwnedFramerOutput::UnknownFrame(frame.raw.to_vec()),
        FramerOutput::Error(defect) => OwnedFramerOutput::Error(defect),
    }
}

/// Scans `bytes` in chunks at one instant, lets the gap pass, and ends.
pub(crate) fn scan(config: FramerConfig, bytes: &[u8], chunk: usize) -> (Vec<OwnedFramerOutput>, FramerCounters) {
    let mut framer = Framer::new(config);
    let mut found = Vec::new();
    for part in bytes.chunks(chunk) {
        framer.push(Timestamp::ZERO, part, &mut |item| found.push(owned(item)));
    }
    let late = Timestamp::ZERO + config.gap + TimeDelta::from_millis(1);
    framer.tick(late, &mut |item| found.push(owned(item)));
    assert_eq!(framer.deadline(), None, "nothing may wait after the gap");
    framer.finish(&mut |item| found.push(owned(item)));
    (found, *framer.counters())
}

/// The frames and unknown frames among what was found.
pub(crate) fn frames(found: &[OwnedFramerOutput]) -> Vec<OwnedFramerOutput> {
    found.iter().filter(|item| !matches!(item, OwnedFramerOutput::Error(_))).cloned().collect()
}

/// An event of a codec, owned and without its sender.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum RecordedEvent {
    Message(Message),
    ClockReply { sent: Timestamp<HostClock>, peer_nanos: i64 },
    StatusText(String),
    Error(ReceiveError),
}

pub(crate) fn recorded(event: CodecEvent<'_>) -> RecordedEvent {
    match event {
        CodecEvent::Message { message, .. } => RecordedEvent::Message(message),
        CodecEvent::ClockReply { sent, peer_nanos, .. } => RecordedEvent::ClockReply { sent, peer_nanos },
        CodecEvent::StatusText { text, .. } => RecordedEvent::StatusText(text),
        CodecEvent::Error(defect) => RecordedEvent::Error(defect),
        CodecEvent::ForwardFrame(frame) => panic!("bricks without MAVLink send no {frame:?}"),
    }
}

/// The texts among events and their times.
pub(crate) fn status_texts<T>(events: &[(T, RecordedEvent)]) -> Vec<&str> {
    let texts = events.iter().filter_map(|(_, event)| match event {
        RecordedEvent::StatusText(text) => Some(text.as_str()),
        _ => None,
    });
    texts.collect()
}

/// An estimate at rest, in the brick's time.
pub(crate) fn estimate(micros: u32, pose: Pose<Arena>, covariance: [f64; 6], flags: PoseFlags) -> PlanarPose {
    PlanarPose {
        stamp: WireStamp::Micros32(micros),
        pose,
        forward_speed: MetersPerSecond(0.0),
        turn_rate: RadiansPerSecond(0.0),
        covariance,
        fix_age: None,
        reset_counter: 9,
        flags,
        epoch: 0,
    }
}

/// A codec of this protocol, not yet connected.
pub(crate) fn codec(protocol: &str, settings: &CodecSettings) -> Box<dyn BrickCodec> {
    (brick_protocol(protocol).expect("there is a row of this name").open)(settings)
}
