//! Several ports behind one `next`, each in its turn.
//!
//! The port that just spoke is asked last, so a flooded link cannot silence the others. A set neither starts tasks nor
//! queues events.

use std::future::poll_fn;
use std::task::{Context, Poll};

use posebridge_telemetry::LinkId;

use crate::error::OpenError;
use crate::port::{Port, PortEvent};

/// The ports of one shard.
#[derive(Debug, Default)]
pub struct PortSet {
    ports: Vec<Port>,
    /// The port that is asked first.
    turn: usize,
}

impl PortSet {
    /// A set of these ports.
    #[must_use]
    pub const fn new(ports: Vec<Port>) -> Self {
        Self { ports, turn: 0 }
    }

    /// Adds a port.
    pub fn push(&mut self, port: Port) {
        self.ports.push(port);
    }

    /// The port with this number.
    pub fn get_mut(&mut self, id: LinkId) -> Option<&mut Port> {
        self.ports.iter_mut().find(|port| port.id() == id)
    }

    /// The ports in the order in which they were added.
    pub fn iter(&self) -> std::slice::Iter<'_, Port> {
        self.ports.iter()
    }

    /// Opens every port once, one after the other; see [`Port::open_first`].
    ///
    /// # Errors
    /// The first error that [stops the start](OpenError::stops_start), with the link that it concerns.
    pub async fn open_first(&mut self) -> Result<(), (LinkId, OpenError)> {
        for port in &mut self.ports {
            let id = port.id();
            port.open_first().await.map_err(|error| (id, error))?;
        }
        Ok(())
    }

    /// The next event of any port. Cancel safe. A set without ports waits for ever.
    pub async fn next(&mut self) -> (LinkId, PortEvent) {
        poll_fn(|cx| self.poll_next(cx)).await
    }

    /// The next event of any port, for callers with a poll loop of their own.
    pub fn poll_next(&mut self, cx: &mut Context<'_>) -> Poll<(LinkId, PortEvent)> {
        let count = self.ports.len();
        for offset in 0..count {
            let index = (self.turn + offset) % count;
            let Some(port) = self.ports.get_mut(index) else {
                break;
            };
            if let Poll::Ready(event) = port.poll_next(cx) {
                self.turn = (index + 1) % count;
                return Poll::Ready((port.id(), event));
            }
        }
        Poll::Pending
    }
}

impl<'a> IntoIterator for &'a PortSet {
    type Item = &'a Port;
    type IntoIter = std::slice::Iter<'a, Port>;
    fn into_iter(self) -> Self::IntoIter {
        self.ports.iter()
    }
}
