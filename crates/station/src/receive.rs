//! How something came in.

use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{DuplicateStatus, Endpoint};
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, Timestamp};

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
