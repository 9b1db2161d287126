//! What came in, and how.

use posebridge_protocol::bricks::CodecEvent;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{DuplicateStatus, Endpoint};
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, ReceiveError, Timestamp};

/// By which endpoint something came, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceiveInfo {
    pub(crate) endpoint: Endpoint,
    /// When its last byte was there. That may be before the station's present, if it waited for its turn.
    pub(crate) host_time: Timestamp<HostClock>,
}

impl ReceiveInfo {
    /// How something that the station does of itself on a link counts as received.
    pub(crate) fn local(link: LinkId, now: Timestamp<HostClock>) -> Self {
        Self { endpoint: Endpoint { link, peer: PeerId::default() }, host_time: now }
    }
}

/// A message that came in, with its sender.
#[derive(Debug)]
pub(crate) struct ReceivedMessage {
    pub(crate) source: Address,
    pub(crate) duplicate_status: DuplicateStatus,
    pub(crate) message: Message,
}

/// A time request and its answer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimeExchange {
    pub(crate) sent: Timestamp<HostClock>,
    pub(crate) answer: ReceiveInfo,
    /// What the peer's clock showed between the two.
    pub(crate) peer_nanos: i64,
}

/// What a codec has found in one input, in its order. No router sees the messages: only the station understands the protocol.
#[derive(Debug, Default)]
pub(crate) struct CodecEvents(Vec<OwnedCodecEvent>);

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
