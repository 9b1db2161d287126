//! How something came in.

use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{DuplicateStatus, Endpoint};
use posebridge_telemetry::{Address, HostClock, Timestamp};

/// By which endpoint something came, and when.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceiveInfo {
    pub(crate) endpoint: Endpoint,
    /// When its last byte was there. That may be before the station's present, if it waited for its turn.
    pub(crate) host_time: Timestamp<HostClock>,
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
