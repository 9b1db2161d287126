//! Counters of links. They only grow, except that a missing frame which arrives late is subtracted again.

use crate::clock::TimeDelta;
use crate::ids::Address;

/// The counters of a link's transport.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkCounts {
    /// Bytes that the operating system accepted, counted for each peer.
    pub bytes_out: u64,
    /// Frames dropped because the link was slow or down: counted for each peer where each peer has its own queue, once
    /// where they wait for the rate limit of the whole link and where the link is down.
    pub drops_out: u64,
    /// Peers now.
    pub peers: u32,
    /// Queued frames now.
    pub queued_frames: u32,
    /// Queued bytes now.
    pub queued_bytes: u32,
    /// Measured throughput while frames are queued, bytes per second; `None` while the link keeps up.
    pub capacity_bytes_per_s: Option<f64>,
}

/// The counters of one sender on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceHealth {
    /// The sender.
    pub source: Address,
    /// Frames received whole.
    pub frames: u64,
    /// Frames missing in its sequence numbers; a late one is subtracted again.
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
    /// Frames with an unknown message id; their checksum cannot be verified.
    pub unknown_ids: u64,
    /// Candidates given up because their bytes stopped coming.
    pub timeouts: u64,
    /// Frames missing in the sequence numbers, summed over the senders; a late one is subtracted again.
    pub frames_lost: u64,
    /// Times the link came up again after a loss.
    pub reconnects: u64,
    /// Outgoing messages dropped because the link was slow or down, or because its protocol does not have them.
    pub drops_out: u64,
    /// Frames refused because their signature is missing, wrong or old.
    pub rejected_frames: u64,
    /// Frames that came a second time over another link, and were not used again.
    pub duplicates: u64,
    /// Frames with the station's own address that it has not sent: another participant has the same address.
    pub address_conflicts: u64,
    /// Frames forwarded to this link.
    pub forwarded: u64,
    /// Frames rejected by this link's input filter.
    pub filtered: u64,
    /// Forwarded frames and own estimates dropped by this link's rate limits.
    pub rate_limited: u64,
    /// The last counters of the transport.
    pub port: LinkCounts,
    /// Round-trip time of the last answered time request.
    pub round_trip: Option<TimeDelta>,
    /// Half the width of the clock bounds: the largest error of a converted timestamp.
    pub clock_uncertainty: Option<TimeDelta>,
}
