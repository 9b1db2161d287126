//! Who speaks to a session.

use posebridge_telemetry::{Address, PeerId};

/// Who sent a message on the session's link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SessionSender {
    /// The address that the message names.
    pub address: Address,
    /// By which peer of the link it came; `None` if that says nothing.
    pub peer: Option<PeerId>,
}
