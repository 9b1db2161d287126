//! How well a link is doing, in counts that only grow; but a frame that was missing and comes late is taken off its count.

use crate::clock::Span;

use crate::ids::Address;

/// What the port of a link knows and nobody else: what became of the bytes that it was given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PortCounts {
    /// Bytes that the operating system took, once per peer.
    pub bytes_out: u64,
    /// Frames dropped because the link was slow or down: once per peer where each peer has a queue of its own, once in all
    /// where they wait for the allowed rate of the whole link and where the link is down.
    pub drops_out: u64,
    /// Peers at the moment.
    pub peers: u32,
    /// Frames that wait at the moment.
    pub queued_frames: u32,
    /// Bytes that wait at the moment.
    pub queued_bytes: u32,
    /// What the link takes, bytes per second, measured while frames wait; `None` while it has kept up.
    pub capacity_bytes_per_s: Option<f64>,
}

/// What one sender has sent on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceHealth {
    /// Who.
    pub source: Address,
    /// Frames received whole.
    pub frames: u64,
    /// Frames missing in its sequence numbers; one that comes late is taken off again.
    pub lost: u64,
}

/// Counters and figures of one link since the session began.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkHealth {
    /// Bytes received.
    pub bytes_in: u64,
    /// Bytes handed to the link for sending.
    pub bytes_out: u64,
    /// Frames received whole.
    pub frames_in: u64,
    /// Frames sent.
    pub frames_out: u64,
    /// Candidates whose checksum did not match.
    pub checksum_errors: u64,
    /// Bytes outside every frame.
    pub garbage_bytes: u64,
    /// Frames with a message id that we do not know (counted; their checksum cannot be verified).
    pub unknown_ids: u64,
    /// Candidates given up because their bytes stopped coming.
    pub stalls: u64,
    /// Frames missing in the sequence numbers, summed over the senders; one that comes late is taken off again.
    pub frames_lost: u64,
    /// Times the link came up again after a loss.
    pub reconnects: u64,
    /// Outgoing messages dropped because the link was slow or down, or because it does not have them.
    pub drops_out: u64,
    /// Frames refused because their signature is missing, wrong or old.
    pub refused_frames: u64,
    /// Frames that came a second time, by another way, and were not used again.
    pub duplicates: u64,
    /// Frames under the station's own address that it has not sent: somebody else has the same one.
    pub namesakes: u64,
    /// Frames of others that were passed on to this link.
    pub forwarded: u64,
    /// Frames that this link's inward filter kept out.
    pub filtered: u64,
    /// Frames of others and estimates of ours that this link's rate limits held back.
    pub thinned: u64,
    /// What the port has counted, as of its last word.
    pub port: PortCounts,
    /// Round-trip time of the last answered time request.
    pub round_trip: Option<Span>,
    /// Half the width of the clock bounds: how far a converted stamp may be off.
    pub clock_uncertainty: Option<Span>,
}
