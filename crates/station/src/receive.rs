//! The origin and arrival of received data.

use posebridge_protocol::bricks::CodecEvent;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{DuplicateStatus, Endpoint};
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, Timestamp};

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
    /// It has a signature, which was verified.
    pub(crate) is_signed: bool,
    pub(crate) message: Message,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct TimeExchange {
    pub(crate) sent: Timestamp<HostClock>,
    pub(crate) answer: ReceiveInfo,
    /// The peer's clock between the two.
    pub(crate) peer_nanos: i64,
}

/// An event that outlives the codec's input; `None` for a MAVLink frame inside another protocol that means nothing here:
/// there is no peer to forward it to.
pub(crate) fn owned(event: CodecEvent<'_>) -> Option<CodecEvent<'static>> {
    Some(match event {
        CodecEvent::Message { from, message } => CodecEvent::Message { from, message },
        CodecEvent::ClockReply { from, sent, peer_nanos } => CodecEvent::ClockReply { from, sent, peer_nanos },
        CodecEvent::StatusText { from, severity, text } => CodecEvent::StatusText { from, severity, text },
        CodecEvent::ForwardFrame(_) => return None,
        CodecEvent::Error(error) => CodecEvent::Error(error),
    })
}
