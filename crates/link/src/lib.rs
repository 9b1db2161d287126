//! Links to the outside: transports, and the supervised ports that keep them alive.
//!
//! A [`LinkUrl`] names a link, a [`Port`] holds it open: it opens, reads, writes, notices a loss and comes back by
//! itself. The shard loop that owns the pipelines owns the ports too, so no queue stands between a socket and the
//! reply. This crate knows bytes and arrival times; frames, messages and robots are the business of others. It also
//! holds the one place of the house that reads a clock, [`HostTimer`].
//!
//! ```
//! use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, PortEvent, Role};
//! use posebridge_telemetry::LinkId;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(async {
//! let config = PortConfig {
//!     id: LinkId(0),
//!     url: LinkUrl::parse("udp://127.0.0.1:0")?,
//!     role: Role::Listen,
//! };
//! let mut port = Port::new(config, HostTimer::start());
//! port.open_first().await?;
//! assert!(matches!(port.next().await, PortEvent::Up { .. }));
//! # Ok(())
//! # })
//! # }
//! ```

pub mod backoff;
pub mod capacity;
pub mod connection;
pub mod error;
pub mod host_timer;
mod pacer;
pub mod port;
pub mod port_set;
mod send_queue;
mod stream;
mod token_bucket;
pub mod transports;
pub mod url;

pub use backoff::Waits;
pub use capacity::{Backlog, CapacityMeter};
pub use connection::{Connection, Incoming, Outgoing, Outstanding, PortCounters};
pub use error::{LinkLoss, OpenError};
pub use host_timer::{Alarm, HostTimer};
pub use port::{Port, PortConfig, PortEvent, PortTuning};
pub use port_set::PortSet;
pub use transports::{
    DeviceDirectories, LineSettings, OpenRequest, Role, TRANSPORTS, Transport, UDP_RECEIVE_BUFFER_BYTES,
};
pub use url::{BluetoothAddress, LinkUrl, OptionHelp, OptionKind, Target, UrlError};
