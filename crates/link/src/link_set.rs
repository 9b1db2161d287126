//! Several links behind one `next`, polled in turn.
//!
//! The link that delivered last is polled last, so a flooded link cannot starve the others. A set starts no tasks and
//! queues no events.

use std::future::poll_fn;
use std::task::{Context, Poll};

use posebridge_telemetry::LinkId;

use crate::connection::LinkEvent;
use crate::error::OpenError;
use crate::link::Link;

/// The links of one station loop.
#[derive(Debug, Default)]
pub struct LinkSet {
    links: Vec<Link>,
    /// The link that is polled first.
    next_index: usize,
}

impl LinkSet {
    pub const fn new(links: Vec<Link>) -> Self {
        Self { links, next_index: 0 }
    }

    pub fn push(&mut self, port: Link) {
        self.links.push(port);
    }

    pub fn get_mut(&mut self, id: LinkId) -> Option<&mut Link> {
        self.links.iter_mut().find(|port| port.id() == id)
    }

    pub fn iter(&self) -> std::slice::Iter<'_, Link> {
        self.links.iter()
    }

    /// Opens every link once, one after the other; see [`Link::try_open`].
    ///
    /// # Errors
    /// The first error that [stops the start](OpenError::prevents_start), with the link that it concerns.
    pub async fn try_open_all(&mut self) -> Result<(), (LinkId, OpenError)> {
        for port in &mut self.links {
            let id = port.id();
            port.try_open().await.map_err(|error| (id, error))?;
        }
        Ok(())
    }

    /// The next event of any link. Cancel safe. A set without links waits for ever.
    pub async fn next_event(&mut self) -> (LinkId, LinkEvent) {
        poll_fn(|cx| self.poll_event(cx)).await
    }

    /// The next event of any link, for callers with a poll loop of their own.
    pub fn poll_event(&mut self, cx: &mut Context<'_>) -> Poll<(LinkId, LinkEvent)> {
        let count = self.links.len();
        for offset in 0..count {
            let index = (self.next_index + offset) % count;
            let Some(port) = self.links.get_mut(index) else {
                break;
            };
            if let Poll::Ready(event) = port.poll_event(cx) {
                self.next_index = (index + 1) % count;
                return Poll::Ready((port.id(), event));
            }
        }
        Poll::Pending
    }
}

impl<'a> IntoIterator for &'a LinkSet {
    type Item = &'a Link;
    type IntoIter = std::slice::Iter<'a, Link>;
    fn into_iter(self) -> Self::IntoIter {
        self.links.iter()
    }
}
