//! Any bytes in any chunks: every byte is accounted for, and chunking changes no verified frame.

use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind};
use posebridge_telemetry::Timestamp;

/// Input: one byte of options, the size of chunks, then the bytes of a link.
pub(crate) fn check(data: &[u8]) {
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
