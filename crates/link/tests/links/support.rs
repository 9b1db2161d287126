//! What the tests of the ports share: ports from texts, and waiting for one kind of event.

use std::future::poll_fn;
use std::task::Poll;

use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, PortEvent, Role};
use posebridge_telemetry::{LinkId, Span};

/// A port of link 1 for `url`.
pub(crate) fn port(url: &str, role: Role, timer: HostTimer) -> Port {
    let config = PortConfig { id: LinkId(1), url: LinkUrl::parse(url).expect("the test's own link"), role };
    Port::new(config, timer)
}

/// Waits for the link to come up and returns what it says about itself.
pub(crate) async fn up(port: &mut Port) -> String {
    loop {
        if let PortEvent::Up { detail, .. } = port.next().await {
            return detail;
        }
    }
}

/// Waits for the link to go down and returns why, and the wait before the next attempt.
pub(crate) async fn down(port: &mut Port) -> (String, Span) {
    loop {
        if let PortEvent::Down { reason, retry_in, .. } = port.next().await {
            return (reason, retry_in);
        }
    }
}

/// Waits until `count` bytes have come in.
pub(crate) async fn bytes(port: &mut Port, count: usize) -> Vec<u8> {
    let mut all = Vec::new();
    while all.len() < count {
        match port.next().await {
            PortEvent::Bytes { bytes, .. } => all.extend(bytes),
            event => panic!("{event:?} instead of bytes"),
        }
    }
    all
}

/// Polls both ports until the first has an event; the second keeps working meanwhile, its events are dropped.
pub(crate) async fn next_beside(port: &mut Port, other: &mut Port) -> PortEvent {
    poll_fn(|cx| {
        while other.poll_next(cx).is_ready() {}
        port.poll_next(cx)
    })
    .await
}

/// Polls the port exactly once.
pub(crate) async fn poll_once(port: &mut Port) -> Option<PortEvent> {
    poll_fn(|cx| {
        Poll::Ready(match port.poll_next(cx) {
            Poll::Ready(event) => Some(event),
            Poll::Pending => None,
        })
    })
    .await
}
