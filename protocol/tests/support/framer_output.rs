//! Scanning to owned values.

use posebridge_protocol::framing::{Framer, FramerConfig, FramerCounters, FramerOutput};
use posebridge_telemetry::{ReceiveError, TimeDelta, Timestamp};

/// What a scanner handed out, owned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Found {
    /// A verified frame.
    Frame(Vec<u8>),
    /// An unknown frame.
    Unknown(Vec<u8>),
    /// A defect.
    Defect(ReceiveError),
}

/// Copies what a scanner found.
pub(crate) fn owned(found: FramerOutput<'_>) -> Found {
    match found {
        FramerOutput::Frame(frame) => Found::Frame(frame.raw.to_vec()),
        FramerOutput::UnknownFrame(frame) => Found::Unknown(frame.raw.to_vec()),
        FramerOutput::Error(defect) => Found::Defect(defect),
    }
}

/// Scans `bytes` in chunks at one instant, lets the gap pass, and ends.
pub(crate) fn scan(config: FramerConfig, bytes: &[u8], chunk: usize) -> (Vec<Found>, FramerCounters) {
    let mut scanner = Framer::new(config);
    let mut found = Vec::new();
    for part in bytes.chunks(chunk) {
        scanner.push(Timestamp::ZERO, part, &mut |item| found.push(owned(item)));
    }
    let late = Timestamp::ZERO + config.gap + TimeDelta::from_millis(1);
    scanner.tick(late, &mut |item| found.push(owned(item)));
    assert_eq!(scanner.deadline(), None, "nothing may wait after the gap");
    scanner.finish(&mut |item| found.push(owned(item)));
    (found, *scanner.counters())
}

/// The frames and unknown frames among what was found.
pub(crate) fn frames(found: &[Found]) -> Vec<Found> {
    found.iter().filter(|item| !matches!(item, Found::Defect(_))).cloned().collect()
}
