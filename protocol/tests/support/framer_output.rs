//! Scanning to owned values.

use posebridge_protocol::framing::{Framer, FramerConfig, FramerCounters, FramerOutput};
use posebridge_telemetry::{ReceiveError, TimeDelta, Timestamp};

/// What a framer handed out, owned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum OwnedFramerOutput {
    /// A verified frame.
    Frame(Vec<u8>),
    /// An unknown frame.
    UnknownFrame(Vec<u8>),
    /// A defect.
    Error(ReceiveError),
}

/// Copies what a framer found.
pub(crate) fn owned(found: FramerOutput<'_>) -> OwnedFramerOutput {
    match found {
        FramerOutput::Frame(frame) => OwnedFramerOutput::Frame(frame.raw.to_vec()),
        FramerOutput::UnknownFrame(frame) => OwnedFramerOutput::UnknownFrame(frame.raw.to_vec()),
        FramerOutput::Error(defect) => OwnedFramerOutput::Error(defect),
    }
}

/// Scans `bytes` in chunks at one instant, lets the gap pass, and ends.
pub(crate) fn scan(config: FramerConfig, bytes: &[u8], chunk: usize) -> (Vec<OwnedFramerOutput>, FramerCounters) {
    let mut framer = Framer::new(config);
    let mut found = Vec::new();
    for part in bytes.chunks(chunk) {
        framer.push(Timestamp::ZERO, part, &mut |item| found.push(owned(item)));
    }
    let late = Timestamp::ZERO + config.gap + TimeDelta::from_millis(1);
    framer.tick(late, &mut |item| found.push(owned(item)));
    assert_eq!(framer.deadline(), None, "nothing may wait after the gap");
    framer.finish(&mut |item| found.push(owned(item)));
    (found, *framer.counters())
}

/// The frames and unknown frames among what was found.
pub(crate) fn frames(found: &[OwnedFramerOutput]) -> Vec<OwnedFramerOutput> {
    found.iter().filter(|item| !matches!(item, OwnedFramerOutput::Error(_))).cloned().collect()
}
