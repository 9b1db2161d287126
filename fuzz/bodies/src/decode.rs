//! Any payload of any message that we understand: what decodes also encodes, scans and decodes again.

use posebridge_protocol::dialect::{Encoder, MESSAGES, decode};
use posebridge_protocol::framing::{FrameRef, Scanned, Scanner, ScannerConfig, WireVersion};
use posebridge_telemetry::{Address, Stamp};

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
    let Ok(Some(message)) = decode(&frame) else {
        return;
    };
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode(source, &message, &mut bytes);
    let mut seen = 0;
    Scanner::new(ScannerConfig::default()).push(Stamp::ZERO, &bytes, &mut |found| {
        if let Scanned::Frame(frame) = found {
            assert_eq!(frame.message_id, info.id);
            assert!(matches!(decode(&frame), Ok(Some(_))), "{message:?}");
            seen += 1;
        }
    });
    assert_eq!(seen, 1);
}
