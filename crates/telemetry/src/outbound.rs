//! Recipients and priority of outgoing frames.

use crate::ids::PeerId;

/// The recipients of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Recipients {
    /// Every peer of the link.
    All,
    /// One peer; nobody if it is no longer there.
    Peer(PeerId),
    /// Every peer but the one from which a forwarded frame came.
    AllExcept(PeerId),
}

impl Recipients {
    /// Whether a peer is among the recipients.
    pub fn includes(self, peer: PeerId) -> bool {
        match self {
            Self::All => true,
            Self::Peer(only) => only == peer,
            Self::AllExcept(origin) => origin != peer,
        }
    }
}

/// The priority of a frame while a slow link backs up. Earlier variants are sent first, and more of them are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// A frame that is not sent again by itself. It goes first and is never displaced. It is dropped only when too many wait
    /// already, when the system refuses it, or when the connection breaks (docs/links.md).
    Command,
    /// Heartbeats and time requests: repeated soon.
    Session,
    /// Forwarded frames.
    Forwarded,
    /// An estimate; the next one of the same stream replaces it.
    Estimate {
        /// The stream: the message id.
        stream: u32,
    },
}
