//! The stages for the frames of one input: verifier, router, decoder.
//!
//! All frames of an input are verified and routed before the station acts on the first of their messages.

use posebridge_protocol::frame_verifier::{FrameVerifier, VerifiedSender};
use posebridge_protocol::framing::{FrameRef, FramerOutput};
use posebridge_protocol::routing::DuplicateStatus;
use posebridge_telemetry::{Address, HostClock, PeerId, ReceiveError, Timestamp};

use crate::decoder::Decoder;
use crate::forwarding::ForwardingPass;
use crate::receive::ReceivedMessage;

/// The result of one input.
#[derive(Debug, Default)]
pub(crate) struct ReceivedBatch {
    pub(crate) messages: Vec<ReceivedMessage>,
    pub(crate) errors: Vec<ReceiveError>,
    /// Descriptions of invalid payloads, with their senders.
    pub(crate) descriptions: Vec<(Address, String)>,
    pub(crate) rejected_frames: u64,
}

pub(crate) struct ReceivePass<'a> {
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) peer: PeerId,
    pub(crate) verifier: &'a mut FrameVerifier,
    pub(crate) forwarding: ForwardingPass<'a>,
    pub(crate) decoder: &'a mut Decoder,
    pub(crate) batch: ReceivedBatch,
}

impl ReceivePass<'_> {
    pub(crate) fn push(&mut self, found: FramerOutput<'_>) {
        let verified = self.verifier.verify(self.now, self.peer, &found);
        match (found, verified) {
            (FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame), Err(reason)) => {
                self.batch.rejected_frames += 1;
                self.batch.errors.push(ReceiveError::SignatureRejected { source: frame.source, reason });
            }
            (FramerOutput::Frame(frame), Ok(sender)) => self.route(&frame, sender),
            (FramerOutput::UnknownFrame(frame), Ok(sender)) => {
                self.forwarding.route(&frame, sender.check);
            }
            (FramerOutput::Error(error), _) => self.batch.errors.push(error),
        }
    }

    fn route(&mut self, frame: &FrameRef<'_>, sender: VerifiedSender) {
        if sender.missing > 0 {
            let gap = ReceiveError::SequenceGap { source: frame.source, frames: sender.missing };
            self.batch.errors.push(gap);
        }
        match self.forwarding.route(frame, sender.check) {
            Some(DuplicateStatus::AddressConflict) => {
                self.batch.errors.push(ReceiveError::AddressConflict { message_id: frame.message_id });
            }
            // The station's own frames are no input, least of all its own estimate.
            None | Some(DuplicateStatus::Echo) => {}
            Some(duplicate_status) => self.decode(frame, duplicate_status),
        }
    }

    fn decode(&mut self, frame: &FrameRef<'_>, duplicate_status: DuplicateStatus) {
        match self.decoder.decode(frame) {
            Ok(Some(message)) => {
                self.batch.messages.push(ReceivedMessage { source: frame.source, duplicate_status, message });
            }
            Ok(None) => {}
            Err(error) => {
                self.batch.errors.push(ReceiveError::Payload { message_id: error.message_id });
                self.batch.descriptions.extend(error.description.map(|text| (frame.source, text)));
            }
        }
    }
}
