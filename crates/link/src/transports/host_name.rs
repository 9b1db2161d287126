//! A host that was dialled by name over UDP and has fallen silent: its name may have another address by now, and UDP tells nobody.

use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use posebridge_telemetry::TimeDelta;
use tokio::time::Sleep;

use crate::error::{LinkError, OpenError};
use crate::host_timer::HostTimer;
use crate::transports::open_request::resolve;

/// After this long without a datagram the name is looked up again, and then as often.
const SILENCE: TimeDelta = TimeDelta::from_millis(5_000);

type Lookup = Pin<Box<dyn Future<Output = Result<Vec<SocketAddr>, OpenError>> + Send>>;

fn look_up(host: &str, port: u16) -> Lookup {
    let host = host.to_owned();
    Box::pin(async move { resolve(&host, port).await })
}

/// Looks a silent host's name up again.
pub(super) struct HostNameWatch {
    host: String,
    address: SocketAddr,
    timer: HostTimer,
    look_up: fn(&str, u16) -> Lookup,
    deadline: Pin<Box<Sleep>>,
    lookup: Option<Lookup>,
    was_heard: bool,
}

impl HostNameWatch {
    /// `None` if the host is an address.
    pub(super) fn new(host: &str, address: SocketAddr, timer: HostTimer) -> Option<Self> {
        let is_address = host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok();
        (!is_address).then(|| Self::with_lookup(host, address, timer, look_up))
    }

    fn with_lookup(host: &str, address: SocketAddr, timer: HostTimer, look_up: fn(&str, u16) -> Lookup) -> Self {
        let deadline = Box::pin(tokio::time::sleep_until(timer.instant(timer.now() + SILENCE)));
        Self { host: host.to_owned(), address, timer, look_up, deadline, lookup: None, was_heard: false }
    }

    pub(super) const fn record_arrival(&mut self) {
        self.was_heard = true;
    }

    /// Ready with the loss of the link when the name has other addresses only. A name that cannot be looked up changes nothing.
    pub(super) fn poll_move(&mut self, cx: &mut Context<'_>) -> Poll<LinkError> {
        loop {
            if let Some(lookup) = &mut self.lookup {
                let found = ready!(lookup.as_mut().poll(cx));
                self.lookup = None;
                if let Ok(addresses) = found
                    && !addresses.contains(&self.address)
                {
                    return Poll::Ready(LinkError::HostMoved { host: self.host.clone(), from: self.address });
                }
            } else {
                ready!(self.deadline.as_mut().poll(cx));
                if !std::mem::take(&mut self.was_heard) {
                    self.lookup = Some((self.look_up)(&self.host, self.address.port()));
                }
                self.deadline.as_mut().reset(self.timer.instant(self.timer.now() + SILENCE));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::poll_fn;

    const OLD: SocketAddr = SocketAddr::new(IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 1)), 14_550);

    /// The old address and another one under one name, the other one under a second, nothing under a third.
    fn fake_lookup(host: &str, port: u16) -> Lookup {
        let new = SocketAddr::from(([192, 0, 2, 7], port));
        let found = match host {
            "both" => Ok(vec![new, OLD]),
            "moved" => Ok(vec![new]),
            _ => Err(crate::transports::open_request::no_address(host)),
        };
        Box::pin(std::future::ready(found))
    }

    /// What the watch of a name finds within a minute, and when.
    async fn found_within_a_minute(host: &str, heard: TimeDelta) -> Option<(String, TimeDelta)> {
        let timer = HostTimer::start();
        let mut watch = HostNameWatch::with_lookup(host, OLD, timer, fake_lookup);
        let mut arrival = Box::pin(tokio::time::sleep_until(timer.instant(timer.now() + heard)));
        let found = poll_fn(|cx| {
            if timer.now().as_nanos() < 20_000_000_000 && arrival.as_mut().poll(cx).is_ready() {
                watch.record_arrival();
                arrival.as_mut().reset(timer.instant(timer.now() + heard));
                let _armed = arrival.as_mut().poll(cx);
            }
            watch.poll_move(cx)
        });
        let found = tokio::time::timeout(std::time::Duration::from_mins(1), found).await.ok()?;
        Some((found.to_string(), timer.now() - posebridge_telemetry::Timestamp::ZERO))
    }

    #[tokio::test(start_paused = true)]
    async fn a_silent_host_whose_name_moved_is_dialled_anew_and_no_other() {
        let never = TimeDelta::from_millis(3_600_000);
        let (reason, after) = found_within_a_minute("moved", never).await.unwrap();
        assert_eq!(reason, "moved is no longer 192.0.2.1:14550, and is silent there");
        assert!((5_000..5_010).contains(&(after.as_nanos() / 1_000_000)), "{after:?}");
        assert_eq!(found_within_a_minute("both", never).await, None);
        assert_eq!(found_within_a_minute("unknown", never).await, None);
        // It was heard for 20 seconds.
        let (_, after) = found_within_a_minute("moved", TimeDelta::from_millis(1_000)).await.unwrap();
        assert!((20_000..30_010).contains(&(after.as_nanos() / 1_000_000)), "{after:?}");
    }

    #[test]
    fn an_address_is_not_looked_up() {
        for host in ["192.0.2.1", "[2001:db8::1]", "2001:db8::1"] {
            assert!(HostNameWatch::new(host, OLD, HostTimer::start()).is_none());
        }
    }
}
