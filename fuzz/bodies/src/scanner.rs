//! Any bytes in any chunks: every byte is accounted for, and chunking changes no verified frame.

use posebridge_protocol::framing::{Framing, Scanned, Scanner, ScannerConfig};
use posebridge_telemetry::Stamp;

/// Input: one byte of options, the size of chunks, then the bytes of a link.
pub(crate) fn check(data: &[u8]) {
    let [options, chunk, bytes @ ..] = data else {
        return;
    };
    let config = ScannerConfig { accept_v1: options & 1 != 0, ..ScannerConfig::default() };
    let chunk = usize::from(*chunk).max(1);
    let (whole, whole_bytes) = scan(config, bytes, bytes.len().max(1));
    let (chunked, chunked_bytes) = scan(config, bytes, chunk);
    assert_eq!(whole, chunked);
    assert_eq!(whole_bytes, bytes.len() as u64);
    assert_eq!(chunked_bytes, bytes.len() as u64);

    let datagrams = ScannerConfig { transport: Framing::Datagram, ..config };
    let (_, accounted) = scan(datagrams, bytes, chunk);
    assert_eq!(accounted, bytes.len() as u64);
}

/// The verified frames, and how many bytes were handed out or counted.
fn scan(config: ScannerConfig, bytes: &[u8], chunk: usize) -> (Vec<Vec<u8>>, u64) {
    let mut scanner = Scanner::new(config);
    let mut frames = Vec::new();
    let mut accounted = 0;
    let mut take = |found: Scanned<'_>| match found {
        Scanned::Frame(frame) => {
            accounted += frame.raw.len() as u64;
            frames.push(frame.raw.to_vec());
        }
        Scanned::Unknown(frame) => accounted += frame.raw.len() as u64,
        Scanned::Defect(_) => {}
    };
    for part in bytes.chunks(chunk) {
        scanner.push(Stamp::ZERO, part, &mut take);
    }
    if let Some(deadline) = scanner.deadline() {
        scanner.tick(deadline, &mut take);
    }
    assert!(scanner.deadline().is_none());
    scanner.finish(&mut take);
    accounted += scanner.counters().garbage_bytes;
    (frames, accounted)
}
