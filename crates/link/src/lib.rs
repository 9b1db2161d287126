//! Links: transports, and connections that reopen by themselves.
//!
//! A [`LinkUrl`] names a link. A [`Link`] opens it, reads, writes, detects a loss and reconnects. The loop that owns
//! the station owns the links too, so a reply passes no channel on its way to the socket. This crate handles bytes and
//! arrival times, not frames, messages or robots. [`HostTimer`] is the only code of posebridge that reads a clock.
//!
//! ```
//! use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkUrl};
//! use posebridge_telemetry::LinkId;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(async {
//! let config = LinkOpenConfig {
//!     id: LinkId(0),
//!     url: LinkUrl::parse("udp://127.0.0.1:0")?,
//!     role: ConnectRole::Listen,
//! };
//! let mut link = Link::new(config, HostTimer::start());
//! link.try_open().await?;
//! assert!(matches!(link.next_event().await, LinkEvent::Up { .. }));
//! # Ok(())
//! # })
//! # }
//! ```

mod backoff;
pub mod capacity;
pub mod connection;
pub mod error;
pub mod host_timer;
pub mod link;
pub mod link_set;
mod pacer;
mod send_queue;
mod stream;
#[cfg(test)]
#[path = "../tests/links/traffic.rs"]
mod traffic;
pub mod transport;
pub mod transports;
#[cfg(test)]
#[path = "../tests/links/udev.rs"]
mod udev;
pub mod url;

#[cfg(test)]
extern crate self as posebridge_link;

pub use capacity::{Backlog, CapacityMeter};
pub use connection::{Connection, LinkCounters, LinkEvent, OutgoingFrame, QueueStatus, ReceivedBytes};
pub use error::{LinkError, OpenError};
pub use host_timer::{DeadlineTimer, HostTimer};
pub use link::{Link, LinkOpenConfig, Opener};
pub use link_set::LinkSet;
pub use transport::{OptionHelp, OptionKind, TRANSPORTS, Transport, VERSION};
pub use transports::{
    ConnectRole, DeviceDirectories, FirstContact, LineSettingsPolicy, LinkTuning, OpenFuture, UDP_RECEIVE_BUFFER_BYTES,
};
pub use url::{BluetoothAddress, LinkUrl, Target, UrlError};
