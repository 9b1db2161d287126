//! Frames made by pymavlink (tests/data/README.md), and what they are held against.

use std::collections::BTreeMap;

use posebridge_protocol::dialect::{Encoder, PayloadError, decode};
use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::Message;
use posebridge_telemetry::Timestamp;

/// The frames by name.
pub(crate) fn golden() -> BTreeMap<String, Vec<u8>> {
    let text = include_str!("../data/golden.json");
    let cases: BTreeMap<String, String> = serde_json::from_str(text).expect("golden.json");
    cases.into_iter().map(|(name, hex)| (name, from_hex(&hex))).collect()
}

fn from_hex(hex: &str) -> Vec<u8> {
    hex.as_bytes()
        .chunks(2)
        .map(|pair| {
            let digits = std::str::from_utf8(pair).expect("ASCII");
            u8::from_str_radix(digits, 16).expect("hexadecimal")
        })
        .collect()
}

/// Scans the bytes, which must be exactly one verified frame, and looks at it.
pub(crate) fn with_frame<T>(bytes: &[u8], look: impl Fn(&FrameRef<'_>) -> T) -> T {
    let mut framer = Framer::new(FramerConfig { accept_v1: true, ..FramerConfig::default() });
    let mut seen = Vec::new();
    framer.push(Timestamp::ZERO, bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found {
            seen.push(look(&frame));
        }
    });
    assert_eq!(framer.counters().frames, 1);
    assert_eq!(framer.counters().garbage_bytes, 0);
    seen.pop().expect("one frame")
}

/// What a frame says.
pub(crate) fn decode_golden(name: &str) -> Result<Option<Message>, PayloadError> {
    with_frame(&golden()[name], decode)
}

/// Decodes to `expected`, and `expected` encodes to the same bytes.
pub(crate) fn check(name: &str, expected: &Message) {
    let bytes = &golden()[name];
    let decoded = with_frame(bytes, decode).expect(name).expect(name);
    assert_eq!(&decoded, expected, "{name}");
    check_encoding(name, expected, WireVersion::V2);
}

/// The message encodes to the frame's bytes, with the number that it bears.
pub(crate) fn check_encoding(name: &str, message: &Message, version: WireVersion) {
    let bytes = &golden()[name];
    let (source, sequence) = with_frame(bytes, |frame| (frame.source, frame.sequence));
    let mut encoder = Encoder::new(version);
    let mut written = Vec::new();
    for _ in 0..=sequence {
        written.clear();
        encoder.encode(source, message, &mut written);
    }
    assert_eq!(&written, bytes, "{name}");
}
