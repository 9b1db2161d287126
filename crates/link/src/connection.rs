//! What an open link can do, and what a port counts about it.
//!
//! A transport opens a [`Connection`]; the port drives it. A connection neither reopens itself nor waits between
//! attempts: when it is lost it says so once, and the port drops it.

use std::net::SocketAddr;
use std::path::Path;
use std::task::{Context, Poll};

use posebridge_telemetry::{Audience, HostClock, PeerId, Priority, Stamp};

use crate::error::LinkLoss;

/// Counts of one port since the session began; they only grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Bytes received.
    pub bytes_in: u64,
    /// Bytes that the operating system took, once per peer.
    pub bytes_out: u64,
    /// Frames dropped because the link was slow or down: once per peer where each peer has a queue of its own, once in all
    /// where they wait for the allowed rate of the whole link and where the link is down, since nobody knows then who would
    /// have heard them.
    pub drops_out: u64,
    /// Times the link came up again after it had been up before.
    pub reconnects: u64,
}

/// One whole frame on its way out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outgoing<'a> {
    /// For whom.
    pub to: Audience,
    /// What may happen to it while the link backs up.
    pub priority: Priority,
    /// The frame.
    pub frame: &'a [u8],
}

/// What an open link delivers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// Bytes of one read, or one datagram.
    Bytes {
        /// Who sent them.
        peer: PeerId,
        /// When they were read.
        arrival: Stamp<HostClock>,
        /// The bytes, at least one.
        bytes: Vec<u8>,
    },
    /// The end of a file; nothing follows.
    Finished,
}

/// What has been given to an open link and not been written.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outstanding {
    /// Peers at the moment.
    pub peers: u32,
    /// Frames that wait to be written and are lost if the connection is dropped, counted like
    /// [`PortCounters::drops_out`].
    pub frames: u64,
    /// Their unwritten bytes.
    pub bytes: u64,
    /// What the link takes, bytes per second, measured while frames wait; `None` while it keeps up. Of several peers
    /// the fastest counts, so that one that hangs does not make the link look slow.
    pub capacity_bytes_per_s: Option<f64>,
}

/// An open link.
pub trait Connection: Send {
    /// What was opened, for people, such as "/dev/ttyUSB0 at 115200 baud".
    fn detail(&self) -> String;

    /// The local socket address; `None` where the transport has none. This is how a caller learns the port that the
    /// system chose for port 0.
    fn local_address(&self) -> Option<SocketAddr> {
        None
    }

    /// True if whoever reaches [`Connection::local_address`] is heard without having been called.
    fn is_listening(&self) -> bool {
        false
    }

    /// A path that leads to the same device after it was unplugged and came back under another number; `None` where the
    /// link's own target is as good as any.
    fn stable_path(&self) -> Option<&Path> {
        None
    }

    /// How many peers hear a frame for `to`.
    fn reach(&self, to: Audience) -> u32 {
        u32::from(to.includes(PeerId(0)))
    }

    /// Offers one whole frame. What the system does not take at once waits in a bounded queue and is written by the
    /// next calls of [`Connection::poll`]; a failure is told there too.
    fn send(&mut self, out: &Outgoing<'_>, counters: &mut PortCounters);

    /// Writes what waits and delivers what has arrived.
    ///
    /// # Errors
    /// [`LinkLoss`] when the link is gone; the connection is of no use afterwards.
    fn poll(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>>;

    /// What waits to be written, and how fast the link takes it.
    fn outstanding(&self, now: Stamp<HostClock>) -> Outstanding;
}
