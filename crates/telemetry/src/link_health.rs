//! How well a link is doing, in counts that only grow.

use crate::clock::Span;

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
    /// Frames missing in the sequence numbers, summed over the senders.
    pub frames_lost: u64,
    /// Times the link came up again after a loss.
    pub reconnects: u64,
    /// Outgoing messages dropped because the link was slow or down.
    pub drops_out: u64,
    /// Round-trip time of the last answered time request.
    pub round_trip: Option<Span>,
    /// Half the width of the clock bounds: how far a converted stamp may be off.
    pub clock_uncertainty: Option<Span>,
}
