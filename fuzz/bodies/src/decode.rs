//! Any payload of any known message: what decodes can be encoded, framed and decoded again.

use posebridge_protocol::dialect::{Encoder, MESSAGES, decode};
use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_telemetry::{Address, Timestamp};

/// Input: one byte that chooses the message, then the payload.
pub(crate) fn check(data: &[u8]) {
    let [which, payload @ ..] = data else {
        return;
    };
    let info = MESSAGES[usize::from(*which) % MESSAGES.len()];
    let source = Address::new(1, 1);
    let frame = FrameRef {
        version: WireVersion::V2,
        message_id: info.id,
        source,
        sequence: 0,
        payload: &payload[..payload.len().min(255)],
        raw: &[],
    };
    decode_numbered(data);
    let Ok(Some(message)) = decode(&frame) else {
        return;
    };
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode(source, &message, &mut bytes);
    let mut seen = 0;
    Framer::new(FramerConfig::default()).push(Timestamp::ZERO, &bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found {
            assert_eq!(frame.message_id, info.id);
            assert!(matches!(decode(&frame), Ok(Some(_))), "{message:?}");
            seen += 1;
        }
    });
    assert_eq!(seen, 1);
    assert!(decode_numbered(&bytes), "{message:?}");
}

/// Whether bytes are a frame that can be given another number; then it is still a frame that says the same, else nothing was changed.
fn decode_numbered(bytes: &[u8]) -> bool {
    let mut renumbered = bytes.to_vec();
    let outcome = Encoder::new(WireVersion::V2).renumber(&mut renumbered);
    let differs = bytes.iter().zip(&renumbered).filter(|(a, b)| a != b);
    // The number, and the checksum's two bytes.
    assert!(differs.count() <= 3 && (outcome.is_ok() || renumbered == bytes));
    if outcome.is_ok() {
        let mut back = renumbered.clone();
        assert_eq!(Encoder::new(WireVersion::V2).renumber(&mut back), Ok(()));
        assert_eq!(back, renumbered, "number 0 stays number 0");
    }
    outcome.is_ok()
}
