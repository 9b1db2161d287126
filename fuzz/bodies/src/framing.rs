//! Any bytes of a link and any payload of a message: every byte is accounted for, chunking changes no verified frame, what decodes
//! can be encoded, framed and decoded again, and a detected protocol explains no more bytes than there are.

use posebridge_protocol::detect::{Protocol, recognise};
use posebridge_protocol::dialect::csv_lines::CsvLines;
use posebridge_protocol::dialect::definitions::definitions;
use posebridge_protocol::dialect::fields::{FullPayload, columns, frame};
use posebridge_protocol::dialect::message_json::{read_json, write_json};
use posebridge_protocol::dialect::{Encoder, MESSAGES, decode, ids};
use posebridge_protocol::framing::{
    FrameRef, Framer, FramerConfig, FramerOutput, TransportKind, VerifiedFrame, WireVersion, verify,
};
use posebridge_telemetry::{Address, Timestamp};

/// Input: one byte of options, the size of chunks, then the bytes of a link.
pub(crate) fn check_scanner(data: &[u8]) {
    let [options, chunk, bytes @ ..] = data else {
        return;
    };
    let config = FramerConfig { accept_v1: options & 1 != 0, ..FramerConfig::default() };
    let chunk = usize::from(*chunk).max(1);
    let (whole, whole_bytes) = scan(config, bytes, bytes.len().max(1));
    let (chunked, chunked_bytes) = scan(config, bytes, chunk);
    assert_eq!(whole, chunked);
    assert_eq!(whole_bytes, bytes.len() as u64);
    assert_eq!(chunked_bytes, bytes.len() as u64);

    let datagrams = FramerConfig { transport: TransportKind::Datagram, ..config };
    let (_, accounted) = scan(datagrams, bytes, chunk);
    assert_eq!(accounted, bytes.len() as u64);
}

/// The verified frames, and how many bytes were handed out or counted.
fn scan(config: FramerConfig, bytes: &[u8], chunk: usize) -> (Vec<Vec<u8>>, u64) {
    let mut framer = Framer::new(config);
    let mut frames = Vec::new();
    let mut accounted = 0;
    let mut take = |found: FramerOutput<'_>| match found {
        FramerOutput::Frame(frame) => {
            accounted += frame.raw.len() as u64;
            frames.push(frame.raw.to_vec());
        }
        FramerOutput::UnknownFrame(frame) => accounted += frame.raw.len() as u64,
        FramerOutput::Error(_) => {}
    };
    for part in bytes.chunks(chunk) {
        framer.push(Timestamp::ZERO, part, &mut take);
    }
    if let Some(deadline) = framer.deadline() {
        framer.tick(deadline, &mut take);
    }
    assert!(framer.deadline().is_none());
    framer.finish(&mut take);
    accounted += framer.counters().garbage_bytes;
    (frames, accounted)
}

/// Input: one byte that chooses the message, then the payload.
pub(crate) fn check_decode(data: &[u8]) {
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
    // Two messages have the same meaning, and one of them is written.
    let written_id = match info.id {
        ids::GLOBAL_VISION_POSITION_ESTIMATE => ids::VISION_POSITION_ESTIMATE,
        ids::SET_MODE => ids::COMMAND_LONG,
        other => other,
    };
    let mut seen = 0;
    Framer::new(FramerConfig::default()).push(Timestamp::ZERO, &bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found {
            assert_eq!(frame.message_id, written_id);
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

/// Input: the bytes of a link.
pub(crate) fn check_recognise(data: &[u8]) {
    let found = recognise(data);
    assert!(found.frame_bytes <= data.len(), "{found:?}");
    assert!(found.frames <= found.frame_bytes, "{found:?}");
    assert_eq!(found.protocol.is_known(), found.frames > 0, "{found:?}");
    assert_eq!(found.protocol == Protocol::NoData, data.is_empty());
}

/// Input: two bytes that choose a message, a version, then its payload; or the JSON text of one.
pub(crate) fn check_fields(data: &[u8]) {
    let [low, high, version, rest @ ..] = data else {
        return;
    };
    let all = definitions();
    let definition = &all[usize::from(u16::from_le_bytes([*low, *high])) % all.len()];
    let source = Address::new(3, 4);
    if let Ok(made) = read_json(definition, source, rest) {
        assert!(matches!(verify(&made), VerifiedFrame::Frame(_)));
    }
    let is_v1 = version & 1 != 0 && definition.id <= 0xFF;
    let version = if is_v1 { WireVersion::V1 } else { WireVersion::V2 };
    let payload = FullPayload::new(&rest[..rest.len().min(255)]);
    let mut lines = CsvLines::new(&[], definition);
    lines.clear();
    lines.push_payload(payload);
    let unquoted = lines.as_bytes().split(|byte| *byte == b'"').step_by(2).flatten();
    assert_eq!(unquoted.filter(|byte| **byte == b',').count() + 1, columns(definition).len());
    let Some(sent) = frame(definition, version, source, 5, &payload) else {
        panic!("{} has no frame", definition.name);
    };
    let VerifiedFrame::Frame(read) = verify(&sent) else {
        panic!("{} is not verified", definition.name);
    };
    let text = write_json(definition, &read);
    let again = read_json(definition, source, text.as_bytes());
    assert!(again.is_ok_and(|again| again == sent), "{text}");
}
