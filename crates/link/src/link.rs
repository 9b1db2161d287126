//! A link that reconnects: opens, reads, writes, detects a loss and opens again.
//!
//! A link is a value that the station loop owns and polls; there is no task and no channel behind it, so received bytes
//! are delivered in the same wake-up, and frames are written at once. It waits between attempts, longer each time, and
//! ends only at the end of a file. It handles bytes, not frames.

use std::fmt;
use std::future::poll_fn;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use posebridge_telemetry::{HostClock, LinkCounts, LinkId, PeerId, Priority, Recipients, TimeDelta, Timestamp};
use tokio::time::Sleep;

use crate::backoff::{Backoff, SessionSeed};
use crate::connection::{Connection, LinkCounters, LinkEvent, OutgoingFrame, QueueStatus, ReceivedBytes};
use crate::error::OpenError;
use crate::host_timer::HostTimer;
use crate::pacer::Pacer;
use crate::transport::RATE;
use crate::transports::{self, ConnectRole, LinkTuning, OPEN_DEADLINE_SECS, OpenFuture, OpenRequest, timeout_error};
use crate::url::LinkUrl;

/// After a link was up for this long, the back-off starts again from the shortest delay.
const STABLE_UPTIME: TimeDelta = TimeDelta::from_millis(5_000);

/// The id, URL and role of a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkOpenConfig {
    pub id: LinkId,
    pub url: LinkUrl,
    pub role: ConnectRole,
}

/// Starts to open a connection that this crate does not know: that to a camera.
pub type Opener = Box<dyn Fn(HostTimer) -> OpenFuture + Send>;

/// A link that reconnects by itself.
pub struct Link {
    config: LinkOpenConfig,
    tuning: LinkTuning,
    /// In place of the transport of the URL.
    opener: Option<Opener>,
    timer: HostTimer,
    state: ConnectionState,
    /// The device's path that survives a replug.
    stable_path: Option<PathBuf>,
    backoff: Backoff,
    counters: LinkCounters,
    was_up: bool,
    pending_event: Option<LinkEvent>,
    reported_reason: Option<String>,
}

enum ConnectionState {
    /// To be opened at the next poll.
    Closed,
    /// An attempt is running. One that is overdue is left running: a second open of a device whose first one hangs
    /// would hang as well.
    Opening {
        attempt: OpenFuture,
        deadline: Option<Pin<Box<Sleep>>>,
    },
    BackingOff {
        wake: Pin<Box<Sleep>>,
    },
    Up {
        connection: Box<dyn Connection>,
        /// `None` without a rate limit.
        pacer: Option<Box<Pacer>>,
        since: Timestamp<HostClock>,
    },
    /// A file was played to its end.
    Finished,
}

impl Link {
    pub fn new(config: LinkOpenConfig, timer: HostTimer) -> Self {
        Self::with_tuning(config, LinkTuning::default(), timer)
    }

    pub fn with_tuning(config: LinkOpenConfig, tuning: LinkTuning, timer: HostTimer) -> Self {
        Self {
            backoff: Backoff::new(config.id, config.url.transport(), SessionSeed::from_timer(&timer)),
            config,
            tuning,
            opener: None,
            timer,
            state: ConnectionState::Closed,
            stable_path: None,
            counters: LinkCounters::default(),
            was_up: false,
            pending_event: None,
            reported_reason: None,
        }
    }

    /// A link whose connections `opener` opens.
    pub fn with_opener(config: LinkOpenConfig, opener: Opener, timer: HostTimer) -> Self {
        Self { opener: Some(opener), ..Self::new(config, timer) }
    }

    pub const fn id(&self) -> LinkId {
        self.config.id
    }

    pub const fn url(&self) -> &LinkUrl {
        &self.config.url
    }

    pub fn is_up(&self) -> bool {
        self.connection().is_some()
    }

    /// `None` while the link is not up.
    fn connection(&self) -> Option<&dyn Connection> {
        if let ConnectionState::Up { connection, .. } = &self.state { Some(connection.as_ref()) } else { None }
    }

    /// True if each [`LinkEvent::Bytes`] is one datagram, so that no frame crosses two of them.
    pub fn is_datagram(&self) -> bool {
        self.config.url.transport().is_datagram()
    }

    /// The local socket address while the link is up; `None` where the transport has none.
    pub fn local_address(&self) -> Option<SocketAddr> {
        self.connection()?.local_address()
    }

    /// The network address of a peer; `None` where the transport has none, or the peer is forgotten.
    pub fn peer_address(&self, peer: PeerId) -> Option<IpAddr> {
        self.connection()?.peer_address(peer)
    }

    /// True while the link is up and accepts any peer at [`Link::local_address`]: TCP that listens, and UDP without a host to send
    /// to.
    pub fn is_listening(&self) -> bool {
        self.connection().is_some_and(Connection::is_listening)
    }

    pub const fn counters(&self) -> LinkCounters {
        self.counters
    }

    /// Tries to open the link once, so that a program can refuse to start if the error is permanent, or if another program uses the
    /// serial port.
    ///
    /// Returns `Ok` when the link is up, and also when it may come up later (a device that is not plugged in, a server that is not
    /// started): the link goes on trying then. [`Link::next_event`] delivers the events as usual.
    ///
    /// # Errors
    /// An [`OpenError`] that [stops the start](OpenError::prevents_start).
    pub async fn try_open(&mut self) -> Result<(), OpenError> {
        let first = poll_fn(|cx| {
            if self.pending_event.is_some()
                || matches!(self.state, ConnectionState::BackingOff { .. } | ConnectionState::Up { .. })
            {
                return Poll::Ready(Ok(()));
            }
            self.poll_open(cx)
        })
        .await;
        match first {
            Err(error) if error.prevents_start() => {
                self.state = ConnectionState::Closed;
                Err(error)
            }
            Err(error) => {
                self.schedule_retry(error.to_string());
                Ok(())
            }
            Ok(()) => Ok(()),
        }
    }

    /// The next event. Cancel safe: nothing is lost when the future is dropped.
    pub async fn next_event(&mut self) -> LinkEvent {
        poll_fn(|cx| self.poll_event(cx)).await
    }

    /// The next event; opens, waits, writes and reads on the way. After [`LinkEvent::Finished`] it stays pending.
    pub fn poll_event(&mut self, cx: &mut Context<'_>) -> Poll<LinkEvent> {
        loop {
            if let Some(event) = self.pending_event.take() {
                return Poll::Ready(event);
            }
            match &mut self.state {
                ConnectionState::Closed | ConnectionState::Opening { .. } => {
                    if let Err(error) = ready!(self.poll_open(cx)) {
                        self.schedule_retry(error.to_string());
                    }
                }
                ConnectionState::BackingOff { wake } => {
                    ready!(wake.as_mut().poll(cx));
                    self.state = ConnectionState::Closed;
                }
                ConnectionState::Up { connection, pacer, .. } => {
                    if let Some(pacer) = pacer {
                        pacer.poll(cx, connection.as_mut(), &mut self.counters);
                    }
                    match ready!(connection.poll(cx, &mut self.counters)) {
                        Ok(Some(ReceivedBytes { peer, arrival, bytes })) => {
                            self.counters.bytes_in += bytes.len() as u64;
                            return Poll::Ready(LinkEvent::Bytes { peer, arrival, bytes });
                        }
                        Ok(None) => {
                            self.state = ConnectionState::Finished;
                            return Poll::Ready(LinkEvent::Finished { at: self.timer.now() });
                        }
                        Err(loss) => {
                            self.close();
                            self.schedule_retry(loss.to_string());
                        }
                    }
                }
                ConnectionState::Finished => return Poll::Pending,
            }
        }
    }

    /// Sends one complete frame to every peer, with the priority of a forwarded one: written at once as far as the system accepts it;
    /// the rest waits in a bounded queue, whose frames of lowest priority are dropped and counted when it is full. While the link
    /// is down the frame is dropped and counted. Poll the link afterwards; that writes the queue and reports failures.
    pub fn send(&mut self, frame: &[u8]) {
        self.send_outgoing(&OutgoingFrame { to: Recipients::All, priority: Priority::Forwarded, frame });
    }

    /// Sends one complete frame to its recipients, otherwise like [`Link::send`]. It is lost if a peer is no longer there.
    pub fn send_outgoing(&mut self, out: &OutgoingFrame<'_>) {
        let ConnectionState::Up { connection, pacer, .. } = &mut self.state else {
            self.counters.drops_out += 1;
            return;
        };
        match pacer {
            Some(pacer) => pacer.send(out, connection.as_mut(), &mut self.counters),
            None => connection.send(out, &mut self.counters),
        }
    }

    /// Something that a peer sent was understood, so it is no stranger any more.
    pub fn admit(&mut self, peer: PeerId) {
        if let ConnectionState::Up { connection, .. } = &mut self.state {
            connection.admit(peer);
        }
    }

    /// The counters and the state of the queue; without peers and frames while the link is down.
    pub fn port_counts(&self) -> LinkCounts {
        let outstanding = self.queue_status();
        LinkCounts {
            bytes_out: self.counters.bytes_out,
            drops_out: self.counters.drops_out,
            kernel_drops: self.counters.kernel_drops,
            flood_drops: self.counters.flood_drops,
            peers: outstanding.peers,
            queued_frames: u32::try_from(outstanding.frames).unwrap_or(u32::MAX),
            queued_bytes: u32::try_from(outstanding.bytes).unwrap_or(u32::MAX),
            capacity_bytes_per_s: outstanding.capacity_bytes_per_s,
        }
    }

    fn queue_status(&self) -> QueueStatus {
        let ConnectionState::Up { connection, pacer, .. } = &self.state else {
            return QueueStatus::default();
        };
        let now = self.timer.now();
        let below = connection.queue_status(now);
        match pacer {
            Some(pacer) => pacer.queue_status(below, now),
            None => below,
        }
    }

    /// Drives the attempt to open, starting one if none runs. `Ok` means that an event is pending: up, or overdue.
    fn poll_open(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), OpenError>> {
        if matches!(self.state, ConnectionState::Closed) {
            self.state = self.start_open();
        }
        let ConnectionState::Opening { attempt, deadline } = &mut self.state else {
            return Poll::Ready(Ok(()));
        };
        match attempt.as_mut().poll(cx) {
            Poll::Ready(Ok(connection)) => {
                self.mark_up(connection);
                Poll::Ready(Ok(()))
            }
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Pending => {
                let Some(sleep) = deadline else {
                    return Poll::Pending;
                };
                ready!(sleep.as_mut().poll(cx));
                *deadline = None;
                let reason = timeout_error(&self.config.url).to_string();
                self.report_down(reason, TimeDelta::ZERO);
                // Nothing is reported if the attempt before was overdue too; the attempt itself wakes us then.
                if self.pending_event.is_some() { Poll::Ready(Ok(())) } else { Poll::Pending }
            }
        }
    }

    fn start_open(&self) -> ConnectionState {
        let attempt = match &self.opener {
            Some(open) => open(self.timer),
            None => transports::open(OpenRequest {
                url: self.config.url.clone(),
                role: self.config.role,
                timer: self.timer,
                tuning: self.tuning.clone(),
                stable_path: self.stable_path.clone(),
            }),
        };
        let deadline = self.timer.now() + TimeDelta::from_millis(1_000 * OPEN_DEADLINE_SECS as i64);
        ConnectionState::Opening { attempt, deadline: Some(self.sleep_until(deadline)) }
    }

    fn mark_up(&mut self, connection: Box<dyn Connection>) {
        let at = self.timer.now();
        self.counters.reconnects += u64::from(self.was_up);
        self.was_up = true;
        self.reported_reason = None;
        self.pending_event = Some(LinkEvent::Up { at, detail: connection.detail() });
        self.stable_path = connection.stable_path().map(PathBuf::from);
        let rate = self.config.url.integer(&RATE);
        self.state = ConnectionState::Up {
            connection,
            pacer: (rate > 0).then(|| Box::new(Pacer::new(rate, self.timer))),
            since: at,
        };
    }

    /// Closes the link before it is opened again: an open device keeps its old number in use.
    fn close(&mut self) {
        self.counters.drops_out += self.queue_status().frames;
        if let ConnectionState::Up { since, .. } = &self.state
            && self.timer.now() - *since >= STABLE_UPTIME
        {
            self.backoff.reset();
        }
        self.state = ConnectionState::Closed;
    }

    fn schedule_retry(&mut self, reason: String) {
        let wait = self.backoff.next_delay();
        self.state = ConnectionState::BackingOff { wake: self.sleep_until(self.timer.now() + wait) };
        self.report_down(reason, wait);
    }

    /// Reports that the link is down, unless the reason is the same as before.
    fn report_down(&mut self, reason: String, retry_in: TimeDelta) {
        if self.reported_reason.as_ref() == Some(&reason) {
            return;
        }
        self.reported_reason = Some(reason.clone());
        self.pending_event = Some(LinkEvent::Down { at: self.timer.now(), reason, retry_in });
    }

    fn sleep_until(&self, stamp: Timestamp<HostClock>) -> Pin<Box<Sleep>> {
        Box::pin(tokio::time::sleep_until(self.timer.instant(stamp)))
    }
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Link")
            .field("config", &self.config)
            .field("is_up", &self.is_up())
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::oneshot;

    /// A link whose attempt to open lasts until the test releases it.
    fn hanging_port() -> (Link, oneshot::Sender<OpenError>) {
        let config = LinkOpenConfig {
            id: LinkId(7),
            url: LinkUrl::parse("serial:/dev/rfcomm0").expect("a link"),
            role: ConnectRole::Dial,
        };
        let mut port = Link::new(config, HostTimer::start());
        let (release, released) = oneshot::channel();
        port.state = ConnectionState::Opening {
            attempt: Box::pin(async move { Err(released.await.expect("the test lets it go")) }),
            deadline: Some(port.sleep_until(Timestamp::from_millis(5_000))),
        };
        (port, release)
    }

    #[tokio::test(start_paused = true)]
    async fn an_open_that_hangs_is_reported_and_not_started_twice() {
        let (mut port, release) = hanging_port();
        let LinkEvent::Down { at, reason, retry_in } = port.next_event().await else {
            panic!("it cannot be open");
        };
        assert_eq!(reason, "serial:/dev/rfcomm0 did not open within 5 s");
        assert_eq!(retry_in, TimeDelta::ZERO);
        assert!(at - Timestamp::from_millis(5_000) <= TimeDelta::from_millis(2));
        assert!(matches!(port.state, ConnectionState::Opening { deadline: None, .. }));

        release.send(timeout_error(&port.config.url)).expect("it waits");
        let second_event = tokio::time::timeout(std::time::Duration::from_millis(200), port.next_event()).await;
        assert!(second_event.is_err(), "the same reason twice: {second_event:?}");
        assert!(matches!(port.state, ConnectionState::BackingOff { .. }));
    }

    #[tokio::test(start_paused = true)]
    async fn an_open_that_hangs_does_not_hang_the_other_links() {
        let (hanging, _release) = hanging_port();
        let config = LinkOpenConfig {
            id: LinkId(8),
            url: LinkUrl::parse("udp://127.0.0.1:0").expect("a link"),
            role: ConnectRole::Listen,
        };
        let mut set = crate::LinkSet::new(vec![hanging, Link::new(config, HostTimer::start())]);
        set.try_open_all().await.expect("both may open later");
        let mut events = Vec::new();
        for _ in 0..2 {
            let (id, event) = set.next_event().await;
            events.push((id.0, matches!(event, LinkEvent::Up { .. })));
        }
        events.sort_unstable();
        assert_eq!(events, [(7, false), (8, true)]);
        let address = set.get_mut(LinkId(8)).and_then(|port| port.local_address()).expect("it listens");
        let brick = std::net::UdpSocket::bind("127.0.0.1:0").expect("a free port");
        for number in 0..100 {
            brick.send_to(&[number], address).expect("loopback");
            let (id, event) = set.next_event().await;
            assert_eq!(id, LinkId(8));
            assert!(matches!(event, LinkEvent::Bytes { bytes, .. } if bytes == [number]));
        }
    }
}
