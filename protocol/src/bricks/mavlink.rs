//! MAVLink as a brick protocol: framer, decoder and sequence tracking.

use posebridge_telemetry::{Address, HostClock, ReceiveError, SourceHealth, Timestamp};

use super::codec::{BrickCodec, CodecEvent, CodecEventSink, CodecSettings};
use crate::dialect::{Encoder, decode};
use crate::framing::{FrameRef, Framer, FramerConfig, FramerCounters, FramerOutput, SequenceTracker, WireVersion};
use crate::message::Message;

#[derive(Debug)]
struct MavlinkCodec {
    config: FramerConfig,
    framer: Framer,
    /// The counters before the link came up last.
    previous_counters: FramerCounters,
    sequences: SequenceTracker,
    encoder: Encoder,
}

pub(super) fn open(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    Box::new(MavlinkCodec {
        config: settings.framer,
        framer: Framer::new(settings.framer),
        previous_counters: FramerCounters::default(),
        sequences: SequenceTracker::new(),
        encoder: Encoder::new(WireVersion::V2),
    })
}

impl BrickCodec for MavlinkCodec {
    fn on_link_up(&mut self, _now: Timestamp<HostClock>) {
        let before = *self.framer.counters();
        self.framer = Framer::new(self.config);
        self.previous_counters = self.previous_counters.merged(&before);
        self.sequences.handle_link_loss();
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: CodecEventSink<'_>) {
        let sequences = &mut self.sequences;
        self.framer.push(now, bytes, &mut |found| {
            handle_frame(now, sequences, found, sink);
        });
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.framer.deadline()
    }

    fn tick(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        let sequences = &mut self.sequences;
        self.framer.tick(now, &mut |found| handle_frame(now, sequences, found, sink));
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        // It sends unasked.
        None
    }

    fn encode(&mut self, _now: Timestamp<HostClock>, from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        self.encoder.encode(from, message, out)
    }

    fn counters(&self) -> FramerCounters {
        self.previous_counters.merged(self.framer.counters())
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        self.sequences.source_health().collect()
    }
}

fn handle_frame(
    now: Timestamp<HostClock>,
    sequences: &mut SequenceTracker,
    found: FramerOutput<'_>,
    sink: CodecEventSink<'_>,
) {
    match found {
        FramerOutput::Error(defect) => sink(CodecEvent::Error(defect)),
        // Unverified: its sequence number is not used either.
        FramerOutput::UnknownFrame(frame) => sink(CodecEvent::ForwardFrame(frame)),
        FramerOutput::Frame(frame) => {
            let missing = sequences.record(&frame, now);
            if missing > 0 {
                sink(CodecEvent::Error(ReceiveError::SequenceGap { source: frame.source, frames: missing }));
            }
            sink(decode_frame(&frame));
        }
    }
}

fn decode_frame<'a>(frame: &FrameRef<'a>) -> CodecEvent<'a> {
    match decode(frame) {
        Ok(Some(message)) => CodecEvent::Message { from: frame.source, message },
        Ok(None) => CodecEvent::ForwardFrame(*frame),
        Err(error) => CodecEvent::Error(ReceiveError::Payload { message_id: error.message_id() }),
    }
}
