//! The interface of an open link, its events and its counters.
//!
//! A transport opens a [`Connection`], and [`crate::Link`] drives it. A connection does not reopen itself: it reports
//! its loss once, and the link drops it.

use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::task::{Context, Poll};

use posebridge_telemetry::{HostClock, PeerId, Priority, Recipients, TimeDelta, Timestamp};

use crate::error::LinkError;

/// Counters of one link since the session began; they only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    pub bytes_in: u64,
    /// Bytes that the operating system accepted, counted for each peer.
    pub bytes_out: u64,
    /// Frames dropped because the link was slow or down: counted for each peer where each peer has its own queue, once where
    /// they wait for the rate limit of the whole link and where the link is down, because the recipients are unknown then.
    pub drops_out: u64,
    /// Received datagrams that the operating system dropped, because they were not read in time.
    pub kernel_drops: u64,
    /// Received datagrams dropped because their peer sends more than its budget.
    pub flood_drops: u64,
    /// Times the link came up again after it had been up before.
    pub reconnects: u64,
}

/// One complete frame to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutgoingFrame<'a> {
    pub to: Recipients,
    pub priority: Priority,
    pub frame: &'a [u8],
}

/// Received bytes: one read of a stream, or one datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceivedBytes {
    /// Each peer is a stream of its own.
    pub peer: PeerId,
    pub arrival: Timestamp<HostClock>,
    /// At least one.
    pub bytes: Vec<u8>,
}

/// An event of a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// Bytes came in, as in [`ReceivedBytes`].
    Bytes { peer: PeerId, arrival: Timestamp<HostClock>, bytes: Vec<u8> },
    Up {
        at: Timestamp<HostClock>,
        /// What was opened, for people.
        detail: String,
    },
    /// The link is down. Reported once per loss, and again while it stays down only if the reason changes.
    Down {
        /// When the link detected the loss.
        at: Timestamp<HostClock>,
        reason: String,
        /// Time until the next attempt; zero if the current attempt is still running.
        retry_in: TimeDelta,
    },
    /// A file came to its end; nothing follows.
    Finished { at: Timestamp<HostClock> },
}

/// The state of an open link's send queue.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QueueStatus {
    pub peers: u32,
    /// Frames that wait to be written and are lost if the connection is dropped, counted like
    /// [`LinkCounters::drops_out`].
    pub frames: u64,
    /// Their unwritten bytes.
    pub bytes: u64,
    /// Throughput in bytes per second, measured while frames wait; `None` while the link keeps up. Of several peers the fastest
    /// counts, so that one that hangs does not make the link look slow.
    pub capacity_bytes_per_s: Option<f64>,
}

/// An open link.
pub trait Connection: Send {
    /// What was opened, for people, such as "/dev/ttyUSB0 at 115200 baud".
    fn detail(&self) -> String;

    /// The local socket address, with the port that the system chose for port 0; `None` where the transport has none.
    fn local_address(&self) -> Option<SocketAddr> {
        None
    }

    /// True if the connection accepts peers at [`Connection::local_address`] that it has not contacted.
    fn is_listening(&self) -> bool {
        false
    }

    /// A path that leads to the same device after it was unplugged and came back with another number; `None` if the link's
    /// target serves as well.
    fn stable_path(&self) -> Option<&Path> {
        None
    }

    /// The network address of a peer; `None` where the transport has none, or the peer is forgotten.
    fn peer_address(&self, _peer: PeerId) -> Option<IpAddr> {
        None
    }

    /// Something that a peer sent was understood; see [`crate::FirstContact`].
    fn admit(&mut self, _peer: PeerId) {}

    fn count_recipients(&self, to: Recipients) -> u32 {
        u32::from(to.includes(PeerId(0)))
    }

    /// Sends one complete frame. Bytes that the system does not accept at once wait in a bounded queue; the next calls of
    /// [`Connection::poll`] write them, and report failures.
    fn send(&mut self, out: &OutgoingFrame<'_>, counters: &mut LinkCounters);

    /// Writes queued frames and returns received bytes, or `None` at the end of a file. An error means that the link is lost;
    /// the connection is unusable then.
    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>>;

    fn queue_status(&self, now: Timestamp<HostClock>) -> QueueStatus;
}
