//! By which way frames come and go.

use posebridge_telemetry::{LinkId, PeerId};

/// Most peers of a link that are told apart, and as many routes and senders: what a UDP port remembers.
pub const MAX_PEERS: usize = 4_096;

/// By which way a frame came: a peer of a link. The default is the only peer of the first link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Endpoint {
    /// The link.
    pub link: LinkId,
    /// Which of its peers.
    pub peer: PeerId,
}
