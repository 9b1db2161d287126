//! Scanning to owned values.

use posebridge_protocol::framing::{ScanCounters, Scanned, Scanner, ScannerConfig};
use posebridge_telemetry::{Defect, Span, Stamp};

/// What a scanner handed out, owned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Found {
    /// A verified frame.
    Frame(Vec<u8>),
    /// An unknown frame.
    Unknown(Vec<u8>),
    /// A defect.
    Defect(Defect),
}

/// Copies what a scanner found.
pub(crate) fn owned(found: Scanned<'_>) -> Found {
    match found {
        Scanned::Frame(frame) => Found::Frame(frame.raw.to_vec()),
        Scanned::Unknown(frame) => Found::Unknown(frame.raw.to_vec()),
        Scanned::Defect(defect) => Found::Defect(defect),
    }
}

/// Scans `bytes` in chunks at one instant, lets the gap pass, and ends.
pub(crate) fn scan(config: ScannerConfig, bytes: &[u8], chunk: usize) -> (Vec<Found>, ScanCounters) {
    let mut scanner = Scanner::new(config);
    let mut found = Vec::new();
    for part in bytes.chunks(chunk) {
        scanner.push(Stamp::ZERO, part, &mut |item| found.push(owned(item)));
    }
    let late = Stamp::ZERO + config.gap + Span::from_millis(1);
    scanner.tick(late, &mut |item| found.push(owned(item)));
    assert_eq!(scanner.deadline(), None, "nothing may wait after the gap");
    scanner.finish(&mut |item| found.push(owned(item)));
    (found, *scanner.counters())
}

/// The frames and unknown frames among what was found.
pub(crate) fn frames(found: &[Found]) -> Vec<Found> {
    found.iter().filter(|item| !matches!(item, Found::Defect(_))).cloned().collect()
}
