//! MAVLink as a brick protocol: scanner, codec and sequence accounting put together.

use posebridge_telemetry::{Address, Defect, HostClock, Stamp};

use super::{BrickCodec, Heard};
use crate::dialect::{Encoder, decode};
use crate::framing::{FrameRef, Scanned, Scanner, ScannerConfig, SequenceTracker, WireVersion};
use crate::message::Message;

/// The state of one link that speaks MAVLink.
#[derive(Debug)]
struct Mavlink {
    scanner: Scanner,
    sequences: SequenceTracker,
    encoder: Encoder,
}

pub(super) fn open(config: ScannerConfig) -> Box<dyn BrickCodec> {
    Box::new(Mavlink {
        scanner: Scanner::new(config),
        sequences: SequenceTracker::new(),
        encoder: Encoder::new(WireVersion::V2),
    })
}

impl BrickCodec for Mavlink {
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
        self.scanner
            .tick(now, &mut |found| hear((now, &mut *sequences), found, sink));
    }

    fn encode(&mut self, from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        self.encoder.encode(from, message, out)
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
                sink(Heard::Defect(Defect::Lost {
                    source: frame.source,
                    frames: missing,
                }));
            }
            sink(meaning(&frame));
        }
    }
}

fn meaning<'a>(frame: &FrameRef<'a>) -> Heard<'a> {
    match decode(frame) {
        Ok(Some(message)) => Heard::Message {
            from: frame.source,
            message,
        },
        Ok(None) => Heard::Other(*frame),
        Err(error) => Heard::Defect(Defect::Payload {
            message_id: error.message_id(),
        }),
    }
}
