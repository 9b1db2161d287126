//! Keys, start times and frames for the other modules.

use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput};
use posebridge_protocol::signing::{Key, SigningTime};
use posebridge_telemetry::Timestamp;

/// The two keys of protocol/tests/data/signed.json, so that its frames can be seeds.
pub(super) fn key(choice: u8) -> Key {
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
pub(super) fn start(choice: u8) -> SigningTime {
    let last = SigningTime::MAX.units();
    SigningTime::from_units(match choice % 4 {
        0 => 0,
        1 => 34_000_000_000_000,
        2 => last - 20_000_000,
        _ => last - u64::from(choice / 4),
    })
}

/// Calls `visit` with every verified frame in some bytes, MAVLink 1 included.
pub(super) fn for_each_frame(bytes: &[u8], mut visit: impl FnMut(&FrameRef<'_>)) {
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
