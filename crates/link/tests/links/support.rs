//! Shared by the tests of links: links from URLs, and waiting for one kind of event.

use std::future::poll_fn;
use std::task::Poll;

use posebridge_link::{ConnectRole, HostTimer, Link, LinkEvent, LinkOpenConfig, LinkUrl};
use posebridge_telemetry::{LinkId, TimeDelta};

/// A port of link 1 for `url`.
pub(crate) fn port(url: &str, role: ConnectRole, timer: HostTimer) -> Link {
    let config = LinkOpenConfig { id: LinkId(1), url: LinkUrl::parse(url).expect("the test's own link"), role };
    Link::new(config, timer)
}

/// Waits for the link to come up and returns its detail text.
pub(crate) async fn up(port: &mut Link) -> String {
    loop {
        if let LinkEvent::Up { detail, .. } = port.next_event().await {
            return detail;
        }
    }
}

/// Waits for the link to go down and returns why, and the wait before the next attempt.
pub(crate) async fn down(port: &mut Link) -> (String, TimeDelta) {
    loop {
        if let LinkEvent::Down { reason, retry_in, .. } = port.next_event().await {
            return (reason, retry_in);
        }
    }
}

/// Waits until `count` bytes have come in.
pub(crate) async fn bytes(port: &mut Link, count: usize) -> Vec<u8> {
    let mut all = Vec::new();
    while all.len() < count {
        match port.next_event().await {
            LinkEvent::Bytes { bytes, .. } => all.extend(bytes),
            event => panic!("{event:?} instead of bytes"),
        }
    }
    all
}

/// Polls both ports until the first has an event; the second keeps working meanwhile, its events are dropped.
pub(crate) async fn next_beside(port: &mut Link, other: &mut Link) -> LinkEvent {
    poll_fn(|cx| {
        while other.poll_event(cx).is_ready() {}
        port.poll_event(cx)
    })
    .await
}

/// Polls the port exactly once.
pub(crate) async fn poll_once(port: &mut Link) -> Option<LinkEvent> {
    poll_fn(|cx| {
        Poll::Ready(match port.poll_event(cx) {
            Poll::Ready(event) => Some(event),
            Poll::Pending => None,
        })
    })
    .await
}
