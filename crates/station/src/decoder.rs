//! Decodes frames to messages. The first bad payload of a sender's message is described in words; all are counted.

use std::collections::BTreeSet;

use posebridge_protocol::dialect;
use posebridge_protocol::framing::FrameRef;
use posebridge_protocol::message::Message;
use posebridge_telemetry::Address;

/// Most senders and messages of a link whose bad payloads are described.
const MAX_DESCRIPTIONS: usize = 64;

/// A frame with an invalid payload.
#[derive(Debug)]
pub(crate) struct PayloadError {
    pub(crate) message_id: u32,
    /// The error in words, the first time for this sender and message.
    pub(crate) description: Option<String>,
}

/// Decodes the frames of one link.
#[derive(Debug, Default)]
pub(crate) struct Decoder {
    described: BTreeSet<(Address, u32)>,
}

impl Decoder {
    /// The message of a frame; `None` if the dialect has no such message.
    pub(crate) fn decode(&mut self, frame: &FrameRef<'_>) -> Result<Option<Message>, PayloadError> {
        dialect::decode(frame).map_err(|error| {
            let message_id = error.message_id();
            let is_new = self.described.len() < MAX_DESCRIPTIONS && self.described.insert((frame.source, message_id));
            PayloadError { message_id, description: is_new.then(|| error.to_string()) }
        })
    }
}
