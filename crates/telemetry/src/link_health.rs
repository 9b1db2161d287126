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
    /// Received datagrams that the operating system dropped, because they were not read in time: lost.
    pub kernel_drops: u64,
    /// Received datagrams dropped because their peer sends more than its budget.
    pub flood_drops: u64,
    pub peers: u32,
    pub queued_frames: u32,
    pub queued_bytes: u32,
    /// Measured while frames are queued; `None` while the link keeps up.
    pub capacity_bytes_per_s: Option<f64>,
}

/// The counters of one sender on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceHealth {
    pub source: Address,
    /// Complete frames received.
    pub frames: u64,
    /// Frames missing in its sequence numbers; a late one is subtracted again.
    pub lost: u64,
}

/// Counters and figures of one link since the session began.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkHealth {
    pub bytes_in: u64,
    /// Bytes handed to the link for sending while a peer was there.
    pub bytes_out: u64,
    pub frames_in: u64,
    pub frames_out: u64,
    /// Candidates whose checksum did not match.
    pub checksum_errors: u64,
    /// Bytes outside every frame.
    pub garbage_bytes: u64,
    /// Frames with an unknown message id; their checksum cannot be verified.
    pub unknown_ids: u64,
    /// Frames of dialects that the station verifies and forwards, but does not decode.
    pub foreign_frames: u64,
    /// Candidates given up because their bytes stopped coming.
    pub timeouts: u64,
    /// Frames missing in the sequence numbers, summed over the senders; a late one is subtracted again.
    pub frames_lost: u64,
    /// Times the link came up again after a loss.
    pub reconnects: u64,
    /// Outgoing messages dropped because the link was slow or down, because no peer was there, or because its protocol cannot carry them.
    pub drops_out: u64,
    /// Frames refused because their signature is missing, wrong or old.
    pub rejected_frames: u64,
    /// Frames that came a second time over another link, and were not used again.
    pub duplicates: u64,
    /// Frames with the station's own address that it has not sent: another participant has the same address.
    pub address_conflicts: u64,
    pub forwarded: u64,
    /// Frames rejected by this link's input filter.
    pub filtered: u64,
    /// Forwarded frames and own estimates dropped by this link's rate limits.
    pub rate_limited: u64,
    /// Requests that were not answered, because their peer asked more often than anybody needs.
    pub excess_requests: u64,
    pub port: LinkCounts,
    /// Round-trip time of the last answered time request.
    pub round_trip: Option<TimeDelta>,
    /// Half the width of the clock bounds: the largest error of a converted timestamp.
    pub clock_uncertainty: Option<TimeDelta>,
}

/// One counter of a link, for outputs that list many of them.
#[derive(Clone, Copy, Debug)]
pub struct LinkCounter {
    /// The key in exports, event files and recordings. These are contracts and do not follow the names of the fields.
    pub key: &'static str,
    /// The name in tables and charts.
    pub label: &'static str,
    /// The description in schemas.
    pub help: &'static str,
    pub read: fn(&LinkHealth) -> u64,
}

#[rustfmt::skip]
impl LinkCounter {
    pub const BYTES_IN: Self = Self::new("bytes_in", "received bytes", "Bytes received.", |of| of.bytes_in);
    pub const BYTES_OUT: Self = Self::new("bytes_out", "sent bytes", "Bytes handed to the link.", |of| of.bytes_out);
    pub const FRAMES_IN: Self = Self::new("frames_in", "received", "Frames received whole.", |of| of.frames_in);
    pub const FRAMES_OUT: Self = Self::new("frames_out", "sent", "Frames sent.", |of| of.frames_out);
    pub const CHECKSUM_ERRORS: Self = Self::new("checksum_errors", "damaged", "Candidates with a wrong checksum.", |of| of.checksum_errors);
    pub const GARBAGE_BYTES: Self = Self::new("garbage_bytes", "garbage bytes", "Bytes outside every frame.", |of| of.garbage_bytes);
    pub const UNKNOWN_IDS: Self = Self::new("unknown_ids", "unknown ids", "Frames with an unknown message id.", |of| of.unknown_ids);
    pub const FOREIGN_FRAMES: Self = Self::new("foreign_frames", "foreign dialects", "Frames of dialects that the station forwards and does not decode.", |of| of.foreign_frames);
    pub const TIMEOUTS: Self = Self::new("stalls", "stalls", "Candidates whose bytes stopped coming.", |of| of.timeouts);
    pub const FRAMES_LOST: Self = Self::new("frames_lost", "lost", "Frames missing in the sequence numbers.", |of| of.frames_lost);
    pub const RECONNECTS: Self = Self::new("reconnects", "reconnects", "Times the link came up again.", |of| of.reconnects);
    pub const DROPS_OUT: Self = Self::new("drops_out", "dropped", "Messages dropped because the link was slow or down.", |of| of.drops_out);
    pub const REJECTED_FRAMES: Self = Self::new("refused_frames", "refused", "Frames refused for their signature.", |of| of.rejected_frames);
    pub const DUPLICATES: Self = Self::new("duplicates", "came twice", "Frames that came a second time.", |of| of.duplicates);
    pub const ADDRESS_CONFLICTS: Self = Self::new("namesakes", "by another under our address", "Frames under our own address that we have not sent.", |of| of.address_conflicts);
    pub const FORWARDED: Self = Self::new("forwarded", "passed on to it", "Frames of others passed on to it.", |of| of.forwarded);
    pub const FILTERED: Self = Self::new("filtered", "filtered", "Frames kept out by its filter.", |of| of.filtered);
    pub const RATE_LIMITED: Self = Self::new("thinned", "thinned", "Frames held back by its limits.", |of| of.rate_limited);
    pub const EXCESS_REQUESTS: Self = Self::new("excess_requests", "too many requests", "Requests above the budget of their peer.", |of| of.excess_requests);
    pub const KERNEL_DROPS: Self = Self::new("kernel_drops", "lost in the system", "Received datagrams that the system dropped.", |of| of.port.kernel_drops);
    pub const FLOOD_DROPS: Self = Self::new("flood_drops", "cut of floods", "Received datagrams above the budget of their peer.", |of| of.port.flood_drops);

    /// The counters of the station, in the order of recordings.
    pub const ALL: &[Self] = &[
        Self::BYTES_IN, Self::BYTES_OUT, Self::FRAMES_IN, Self::FRAMES_OUT, Self::CHECKSUM_ERRORS, Self::GARBAGE_BYTES,
        Self::UNKNOWN_IDS, Self::TIMEOUTS, Self::FRAMES_LOST, Self::RECONNECTS, Self::DROPS_OUT, Self::REJECTED_FRAMES,
        Self::DUPLICATES, Self::ADDRESS_CONFLICTS, Self::FORWARDED, Self::FILTERED, Self::RATE_LIMITED,
        Self::EXCESS_REQUESTS, Self::KERNEL_DROPS, Self::FLOOD_DROPS, Self::FOREIGN_FRAMES,
    ];

    /// The drops of the station and of the transport; tables and CSV have their sum.
    pub const UNSENT: Self = Self::new("drops_out", "not sent", "Messages and frames dropped.", |of| of.drops_out + of.port.drops_out);
    pub const QUEUED_FRAMES: Self = Self::new("queued_frames", "waiting", "Frames that wait to be sent.", |of| of.port.queued_frames.into());

    const fn new(key: &'static str, label: &'static str, help: &'static str, read: fn(&LinkHealth) -> u64) -> Self {
        Self { key, label, help, read }
    }
}
