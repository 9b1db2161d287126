//! The origin and arrival of received data.

use posebridge_protocol::bricks::CodecEvent;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{DuplicateStatus, Endpoint};
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, ReceiveError, Timestamp};

/// The endpoint and arrival of received data.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceiveInfo {
    pub(crate) endpoint: Endpoint,
    /// When its last byte arrived. That may be before the station's present, if it was queued.
    pub(crate) host_time: Timestamp<HostClock>,
}

impl ReceiveInfo {
    /// For something that the station does by itself on a link.
    pub(crate) fn local(link: LinkId, now: Timestamp<HostClock>) -> Self {
        Self { endpoint: Endpoint { link, peer: PeerId::default() }, host_time: now }
    }
}

#[derive(Debug)]
pub(crate) struct ReceivedMessage {
    pub(crate) source: Address,
    pub(crate) duplicate_status: DuplicateStatus,
    pub(crate) message: Message,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct TimeExchange {
    pub(crate) sent: Timestamp<HostClock>,
    pub(crate) answer: ReceiveInfo,
    /// The peer's clock between the two.
    pub(crate) peer_nanos: i64,
}

/// The output of a codec for one input, in order. No router handles its messages: only the station understands the
/// protocol.
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
