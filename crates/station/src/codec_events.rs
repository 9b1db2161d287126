//! What a codec has found in one input, in its order.
//!
//! The messages of a robot without MAVLink are treated like others. No router sees them: only the station understands its protocol.

use posebridge_protocol::bricks::CodecEvent;
use posebridge_protocol::message::Message;
use posebridge_telemetry::{Address, HostClock, ReceiveError, Timestamp};

/// Events of a codec, with their bytes dropped.
#[derive(Debug, Default)]
pub(crate) struct CodecEvents(Vec<OwnedCodecEvent>);

/// One event.
#[derive(Debug)]
pub(crate) enum OwnedCodecEvent {
    Message(Address, Message),
    ClockReply { from: Address, sent: Timestamp<HostClock>, peer_nanos: i64 },
    StatusText { from: Address, severity: u8, text: String },
    Error(ReceiveError),
}

impl CodecEvents {
    pub(crate) fn push(&mut self, event: CodecEvent<'_>) {
        self.0.push(match event {
            CodecEvent::Message { from, message } => OwnedCodecEvent::Message(from, message),
            CodecEvent::ClockReply { from, sent, peer_nanos } => OwnedCodecEvent::ClockReply { from, sent, peer_nanos },
            CodecEvent::StatusText { from, severity, text } => OwnedCodecEvent::StatusText { from, severity, text },
            // MAVLink frames inside another protocol that mean nothing here; there is no peer to forward them to.
            CodecEvent::ForwardFrame(_) => return,
            CodecEvent::Error(error) => OwnedCodecEvent::Error(error),
        });
    }

    pub(crate) fn into_events(self) -> impl Iterator<Item = OwnedCodecEvent> {
        self.0.into_iter()
    }
}
