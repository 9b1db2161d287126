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
    decode_readdressed(data);
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
    assert!(decode_readdressed(&bytes), "{message:?}");
}

/// Whether bytes are a frame that can be given another sender; then it is still a frame that says the same, else nothing was changed.
fn decode_readdressed(bytes: &[u8]) -> bool {
    let sender = Address::new(9, 9);
    let mut readdressed = bytes.to_vec();
    let outcome = Encoder::new(WireVersion::V2).readdress(&mut readdressed, sender);
    let differs = bytes.iter().zip(&readdressed).filter(|(a, b)| a != b);
    // The number, the two bytes of the address, and those of the checksum.
    assert!(differs.count() <= 5 && (outcome.is_ok() || readdressed == bytes));
    if outcome.is_ok() {
        let mut again = readdressed.clone();
        assert_eq!(Encoder::new(WireVersion::V2).readdress(&mut again, sender), Ok(()));
        assert_eq!(again, readdressed, "number 0 stays number 0");
    }
    outcome.is_ok()
}
