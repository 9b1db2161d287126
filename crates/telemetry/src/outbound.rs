//! For whom outgoing bytes are, and what may happen to them on a slow link.

use crate::ids::PeerId;

/// For whom a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Audience {
    /// Every peer of the link.
    All,
    /// One of them; nobody if it has gone.
    Peer(PeerId),
    /// Every peer but one: the one that a forwarded frame came from.
    AllBut(PeerId),
}

impl Audience {
    /// Whether a peer belongs to it.
    #[must_use]
    pub fn includes(self, peer: PeerId) -> bool {
        match self {
            Self::All => true,
            Self::Peer(only) => only == peer,
            Self::AllBut(origin) => origin != peer,
        }
    }
}

/// What a frame is worth while a slow link backs up: of an earlier variant more is kept, and it is sent before a later one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// Somebody waits for it and will not ask twice: it goes first and makes room for nothing. It is given up only when too
    /// many wait already, when the system refuses it, and when the connection breaks (docs/links.md).
    Command,
    /// Heartbeats and time requests: said again soon.
    Conversation,
    /// Telemetry of somebody else that is passed on.
    Forwarded,
    /// An estimate: worth nothing once the next one of the same stream is there.
    Estimate {
        /// Which stream of the link: the message id.
        stream: u32,
    },
}
