//! MAVLink as a brick protocol: scanner, codec and sequence accounting put together.

use posebridge_telemetry::{Address, Defect, HostClock, SourceHealth, Stamp};

use super::{BrickCodec, BrickSettings, Heard};
use crate::dialect::{Encoder, decode};
use crate::framing::{FrameRef, ScanCounters, Scanned, Scanner, ScannerConfig, SequenceTracker, WireVersion};
use crate::message::Message;

/// The state of one link that speaks MAVLink.
#[derive(Debug)]
struct Mavlink {
    config: ScannerConfig,
    scanner: Scanner,
    /// What was counted before the link came up last.
    before: ScanCounters,
    sequences: SequenceTracker,
    encoder: Encoder,
}

pub(super) fn open(settings: &BrickSettings) -> Box<dyn BrickCodec> {
    Box::new(Mavlink {
        config: settings.scanner,
        scanner: Scanner::new(settings.scanner),
        before: ScanCounters::default(),
        sequences: SequenceTracker::new(),
        encoder: Encoder::new(WireVersion::V2),
    })
}

impl BrickCodec for Mavlink {
    fn begin(&mut self, _now: Stamp<HostClock>) {
        let before = *self.scanner.counters();
        self.scanner = Scanner::new(self.config);
        self.before = self.before.plus(&before);
        self.sequences.break_off();
    }

    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        let sequences = &mut self.sequences;
        self.scanner.push(now, bytes, &mut |found| {
            hear((now, &mut *sequences), found, sink);
        });
    }

    fn deadline(&self) -> Option<Stamp<HostClock>> {
        self.scanner.deadline()
    }

    fn tick(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>)) {
        let sequences = &mut self.sequences;
        self.scanner.tick(now, &mut |found| hear((now, &mut *sequences), found, sink));
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        // It speaks by itself.
        None
    }

    fn encode(&mut self, _now: Stamp<HostClock>, from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        self.encoder.encode(from, message, out)
    }

    fn counters(&self) -> ScanCounters {
        self.before.plus(self.scanner.counters())
    }

    fn sources(&self) -> Vec<SourceHealth> {
        self.sequences.sources().collect()
    }
}

fn hear(
    (now, sequences): (Stamp<HostClock>, &mut SequenceTracker),
    found: Scanned<'_>,
    sink: &mut dyn FnMut(Heard<'_>),
) {
    match found {
        Scanned::Defect(defect) => sink(Heard::Defect(defect)),
        // Unverified: its sequence number is not believed either.
        Scanned::Unknown(frame) => sink(Heard::Other(frame)),
        Scanned::Frame(frame) => {
            let missing = sequences.take(&frame, now);
            if missing > 0 {
                sink(Heard::Defect(Defect::Lost { source: frame.source, frames: missing }));
            }
            sink(meaning(&frame));
        }
    }
}

fn meaning<'a>(frame: &FrameRef<'a>) -> Heard<'a> {
    match decode(frame) {
        Ok(Some(message)) => Heard::Message { from: frame.source, message },
        Ok(None) => Heard::Other(*frame),
        Err(error) => Heard::Defect(Defect::Payload { message_id: error.message_id() }),
    }
}
