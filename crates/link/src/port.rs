//! A supervised link: opens, reads, writes, notices a loss and comes back by itself.
//!
//! A port is a value that the shard loop owns and polls; there is no task and no channel behind it, so what it reads is
//! handed on in the same wake-up, and what is sent is written at once. It waits between attempts, longer each time, and
//! never ends by itself except at the end of a file. It knows bytes, not frames.

use std::fmt;
use std::future::poll_fn;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use posebridge_telemetry::{Audience, HostClock, LinkId, PeerId, PortCounts, Priority, Span, Stamp};
use tokio::time::Sleep;

use crate::backoff::{Backoff, SessionSeed, Waits};
use crate::connection::{Connection, Incoming, Outgoing, Outstanding, PortCounters};
use crate::error::OpenError;
use crate::host_timer::HostTimer;
use crate::pacer::Pacer;
use crate::transports::{
    DeviceDirectories, LineSettings, OPEN_DEADLINE_SECS, OpenFuture, OpenRequest, RATE, Role, timed_out,
};
use crate::url::LinkUrl;

/// A link that was up for this long is trusted again: its next loss is followed by the shortest wait.
const TRUSTED_AFTER: Span = Span::from_millis(5_000);

/// What a port needs to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortConfig {
    /// Its number in this station.
    pub id: LinkId,
    /// What it opens.
    pub url: LinkUrl,
    /// Who calls whom.
    pub role: Role,
}

/// What is the same for every port of an ordinary computer; tests and unusual systems set it otherwise.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PortTuning {
    /// How long to wait between attempts to open.
    pub waits: Waits,
    /// Where the system tells of its devices.
    pub directories: DeviceDirectories,
    /// What becomes of the settings of a serial line.
    pub line_settings: LineSettings,
}

/// What happened on a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortEvent {
    /// Bytes came in: one read of a stream, or one datagram.
    Bytes {
        /// Which peer of the link sent them. Bytes of different peers are different streams.
        peer: PeerId,
        /// When they were read.
        arrival: Stamp<HostClock>,
        /// The bytes, at least one.
        bytes: Vec<u8>,
    },
    /// Bytes can flow.
    Up {
        /// When the link came up.
        at: Stamp<HostClock>,
        /// What was opened, for people.
        detail: String,
    },
    /// The link is down. Told once per loss, and again while it stays down only if the reason changes.
    Down {
        /// When the port noticed.
        at: Stamp<HostClock>,
        /// Why, for people.
        reason: String,
        /// Time until the next attempt; zero if the present attempt just takes long.
        retry_in: Span,
    },
    /// A file came to its end; nothing follows.
    Finished {
        /// When.
        at: Stamp<HostClock>,
    },
}

/// A link that is kept alive.
pub struct Port {
    config: PortConfig,
    directories: DeviceDirectories,
    line_settings: LineSettings,
    timer: HostTimer,
    state: State,
    /// Where the device is found again under whatever number it comes back.
    stable_path: Option<PathBuf>,
    backoff: Backoff,
    counters: PortCounters,
    was_up: bool,
    /// An event that is to be told before anything else happens.
    pending: Option<PortEvent>,
    /// Why the link is down, as far as it was told.
    told_reason: Option<String>,
}

enum State {
    /// To be opened as soon as somebody polls.
    Closed,
    /// An attempt is running. One that is overdue is left running: a second open of a device whose first one hangs
    /// would hang as well.
    Opening { attempt: OpenFuture, deadline: Option<Pin<Box<Sleep>>> },
    /// Between two attempts.
    Waiting { wake: Pin<Box<Sleep>> },
    /// Open.
    Up {
        connection: Box<dyn Connection>,
        /// Where the link has a rate limit.
        pacer: Option<Box<Pacer>>,
        since: Stamp<HostClock>,
    },
    /// A file was played.
    Finished,
}

impl State {
    const fn name(&self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::Opening { .. } => "opening",
            Self::Waiting { .. } => "waiting",
            Self::Up { .. } => "up",
            Self::Finished => "finished",
        }
    }
}

impl Port {
    /// A port that opens its link when it is first polled.
    #[must_use]
    pub fn new(config: PortConfig, timer: HostTimer) -> Self {
        Self::tuned(config, PortTuning::default(), timer)
    }

    /// As [`Port::new`], on a computer that is not ordinary.
    #[must_use]
    pub fn tuned(config: PortConfig, tuning: PortTuning, timer: HostTimer) -> Self {
        Self {
            backoff: Backoff::new(config.id, SessionSeed::of(&timer), tuning.waits),
            config,
            directories: tuning.directories,
            line_settings: tuning.line_settings,
            timer,
            state: State::Closed,
            stable_path: None,
            counters: PortCounters::default(),
            was_up: false,
            pending: None,
            told_reason: None,
        }
    }

    /// The link's number in this station.
    #[must_use]
    pub const fn id(&self) -> LinkId {
        self.config.id
    }

    /// What the port opens.
    #[must_use]
    pub const fn url(&self) -> &LinkUrl {
        &self.config.url
    }

    /// True while bytes can flow.
    #[must_use]
    pub const fn is_up(&self) -> bool {
        matches!(self.state, State::Up { .. })
    }

    /// True if each [`PortEvent::Bytes`] is one datagram, so that no frame crosses two of them.
    #[must_use]
    pub fn is_datagram(&self) -> bool {
        self.config.url.transport().is_datagram()
    }

    /// The local socket address while the link is up; `None` where the transport has none.
    #[must_use]
    pub fn local_address(&self) -> Option<SocketAddr> {
        match &self.state {
            State::Up { connection, .. } => connection.local_address(),
            State::Closed | State::Opening { .. } | State::Waiting { .. } | State::Finished => None,
        }
    }

    /// True while the link is up and hears whoever calls: TCP that listens, and UDP that names nobody to send to. Where it
    /// does, says [`Port::local_address`].
    #[must_use]
    pub fn is_listening(&self) -> bool {
        match &self.state {
            State::Up { connection, .. } => connection.is_listening(),
            State::Closed | State::Opening { .. } | State::Waiting { .. } | State::Finished => false,
        }
    }

    /// Counts since the port was made.
    #[must_use]
    pub const fn counters(&self) -> PortCounters {
        self.counters
    }

    /// Tries to open the link once, so that a program can refuse to start over a link that no waiting will heal, or over a
    /// serial port that another program holds.
    ///
    /// Returns `Ok` when the link is up, and also when it is not yet but may come up later (a device that is not
    /// plugged in, a server that is not started): the port goes on trying then. Events are told by [`Port::next`] as
    /// ever.
    ///
    /// # Errors
    /// An [`OpenError`] that [stops the start](OpenError::stops_start).
    pub async fn open_first(&mut self) -> Result<(), OpenError> {
        let first = poll_fn(|cx| {
            if self.pending.is_some() || matches!(self.state, State::Waiting { .. } | State::Up { .. }) {
                return Poll::Ready(Ok(()));
            }
            self.poll_opening(cx)
        })
        .await;
        match first {
            Err(error) if error.stops_start() => {
                self.state = State::Closed;
                Err(error)
            }
            Err(error) => {
                self.wait_and_tell(error.to_string());
                Ok(())
            }
            Ok(()) => Ok(()),
        }
    }

    /// The next event. Cancel safe: nothing is lost when the future is dropped.
    pub async fn next(&mut self) -> PortEvent {
        poll_fn(|cx| self.poll_next(cx)).await
    }

    /// The next event; opens, waits, writes and reads on the way. After [`PortEvent::Finished`] it stays pending.
    pub fn poll_next(&mut self, cx: &mut Context<'_>) -> Poll<PortEvent> {
        loop {
            if let Some(event) = self.pending.take() {
                return Poll::Ready(event);
            }
            match &mut self.state {
                State::Closed | State::Opening { .. } => {
                    if let Err(error) = ready!(self.poll_opening(cx)) {
                        self.wait_and_tell(error.to_string());
                    }
                }
                State::Waiting { wake } => {
                    ready!(wake.as_mut().poll(cx));
                    self.state = State::Closed;
                }
                State::Up { connection, pacer, .. } => {
                    if let Some(pacer) = pacer {
                        pacer.poll(cx, connection.as_mut(), &mut self.counters);
                    }
                    match ready!(connection.poll(cx, &mut self.counters)) {
                        Ok(incoming) => self.pending = Some(self.receive(incoming)),
                        Err(loss) => {
                            self.close();
                            self.wait_and_tell(loss.to_string());
                        }
                    }
                }
                State::Finished => return Poll::Pending,
            }
        }
    }

    /// Sends one whole frame to every peer, worth as much as one that is passed on: written at once as far as the system
    /// takes it, the rest waits in a bounded queue whose least worthy frames are dropped and counted when it is full.
    /// While the link is down the frame is dropped and counted. Poll the port afterwards; that writes what waits and
    /// tells of failures.
    pub fn send(&mut self, frame: &[u8]) {
        self.give(&Outgoing { to: Audience::All, priority: Priority::Forwarded, frame });
    }

    /// Sends one whole frame to one peer, otherwise like [`Port::send`]. Nobody hears it if the peer has gone.
    pub fn send_to(&mut self, peer: PeerId, frame: &[u8]) {
        self.give(&Outgoing { to: Audience::Peer(peer), priority: Priority::Forwarded, frame });
    }

    /// Sends one whole frame to whom it is for; what a slow link cannot take is dropped as its priority says.
    pub fn give(&mut self, out: &Outgoing<'_>) {
        match &mut self.state {
            State::Up { connection, pacer, .. } => match pacer {
                Some(pacer) => pacer.give(out, connection.as_mut(), &mut self.counters),
                None => connection.send(out, &mut self.counters),
            },
            State::Closed | State::Opening { .. } | State::Waiting { .. } | State::Finished => {
                self.counters.drops_out += 1;
            }
        }
    }

    /// What the port has counted and what waits in it; nobody and nothing while the link is down.
    #[must_use]
    pub fn counts(&self) -> PortCounts {
        let outstanding = self.outstanding();
        PortCounts {
            bytes_out: self.counters.bytes_out,
            drops_out: self.counters.drops_out,
            peers: outstanding.peers,
            queued_frames: u32::try_from(outstanding.frames).unwrap_or(u32::MAX),
            queued_bytes: u32::try_from(outstanding.bytes).unwrap_or(u32::MAX),
            capacity_bytes_per_s: outstanding.capacity_bytes_per_s,
        }
    }

    fn outstanding(&self) -> Outstanding {
        let State::Up { connection, pacer, .. } = &self.state else {
            return Outstanding::default();
        };
        let now = self.timer.now();
        let below = connection.outstanding(now);
        match pacer {
            Some(pacer) => pacer.outstanding(below, now),
            None => below,
        }
    }

    /// Drives the attempt to open, starting one if none runs. `Ok` means that an event is pending: up, or overdue.
    fn poll_opening(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), OpenError>> {
        if matches!(self.state, State::Closed) {
            self.state = self.start_opening();
        }
        let State::Opening { attempt, deadline } = &mut self.state else {
            return Poll::Ready(Ok(()));
        };
        match attempt.as_mut().poll(cx) {
            Poll::Ready(Ok(connection)) => {
                self.come_up(connection);
                Poll::Ready(Ok(()))
            }
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Pending => {
                let Some(sleep) = deadline else {
                    return Poll::Pending;
                };
                ready!(sleep.as_mut().poll(cx));
                *deadline = None;
                let reason = timed_out(&self.config.url).to_string();
                self.tell_down(reason, Span::ZERO);
                // Nothing is told if the attempt before was overdue too; the attempt itself wakes us then.
                if self.pending.is_some() { Poll::Ready(Ok(())) } else { Poll::Pending }
            }
        }
    }

    fn start_opening(&self) -> State {
        let request = OpenRequest {
            url: self.config.url.clone(),
            role: self.config.role,
            timer: self.timer,
            directories: self.directories.clone(),
            line_settings: self.line_settings,
            stable_path: self.stable_path.clone(),
        };
        let deadline = self.timer.now() + Span::from_millis(1_000 * OPEN_DEADLINE_SECS as i64);
        State::Opening {
            attempt: self.config.url.transport().open(request),
            deadline: Some(self.sleep_until(deadline)),
        }
    }

    fn come_up(&mut self, connection: Box<dyn Connection>) {
        let at = self.timer.now();
        self.counters.reconnects += u64::from(self.was_up);
        self.was_up = true;
        self.told_reason = None;
        self.pending = Some(PortEvent::Up { at, detail: connection.detail() });
        self.stable_path = connection.stable_path().map(PathBuf::from);
        let rate = self.config.url.integer(&RATE);
        self.state =
            State::Up { connection, pacer: (rate > 0).then(|| Box::new(Pacer::new(rate, self.timer))), since: at };
    }

    fn receive(&mut self, incoming: Incoming) -> PortEvent {
        match incoming {
            Incoming::Bytes { peer, arrival, bytes } => {
                self.counters.bytes_in += bytes.len() as u64;
                PortEvent::Bytes { peer, arrival, bytes }
            }
            Incoming::Finished => {
                self.state = State::Finished;
                PortEvent::Finished { at: self.timer.now() }
            }
        }
    }

    /// Closes the link before it is opened again: a device that is held open keeps its old number busy.
    fn close(&mut self) {
        self.counters.drops_out += self.outstanding().frames;
        if let State::Up { since, .. } = &self.state
            && self.timer.now() - *since >= TRUSTED_AFTER
        {
            self.backoff.reset();
        }
        self.state = State::Closed;
    }

    fn wait_and_tell(&mut self, reason: String) {
        let wait = self.backoff.next_wait();
        self.state = State::Waiting { wake: self.sleep_until(self.timer.now() + wait) };
        self.tell_down(reason, wait);
    }

    /// Tells that the link is down, unless that has been told with the same words.
    fn tell_down(&mut self, reason: String, retry_in: Span) {
        if self.told_reason.as_ref() == Some(&reason) {
            return;
        }
        self.told_reason = Some(reason.clone());
        self.pending = Some(PortEvent::Down { at: self.timer.now(), reason, retry_in });
    }

    fn sleep_until(&self, stamp: Stamp<HostClock>) -> Pin<Box<Sleep>> {
        Box::pin(tokio::time::sleep_until(self.timer.instant(stamp)))
    }
}

impl fmt::Debug for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Port")
            .field("config", &self.config)
            .field("state", &self.state.name())
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::oneshot;

    /// A port whose attempt to open lasts until the test lets it go.
    fn hanging_port() -> (Port, oneshot::Sender<OpenError>) {
        let config =
            PortConfig { id: LinkId(7), url: LinkUrl::parse("serial:/dev/rfcomm0").expect("a link"), role: Role::Dial };
        let mut port = Port::new(config, HostTimer::start());
        let (release, released) = oneshot::channel();
        port.state = State::Opening {
            attempt: Box::pin(async move { Err(released.await.expect("the test lets it go")) }),
            deadline: Some(port.sleep_until(Stamp::from_millis(5_000))),
        };
        (port, release)
    }

    #[tokio::test(start_paused = true)]
    async fn an_open_that_hangs_is_told_and_not_started_twice() {
        let (mut port, release) = hanging_port();
        let PortEvent::Down { at, reason, retry_in } = port.next().await else {
            panic!("it cannot be open");
        };
        assert_eq!(reason, "serial:/dev/rfcomm0 did not open within 5 s");
        assert_eq!(retry_in, Span::ZERO);
        assert!(at - Stamp::from_millis(5_000) <= Span::from_millis(2));
        assert!(matches!(port.state, State::Opening { deadline: None, .. }));

        release.send(timed_out(&port.config.url)).expect("it waits");
        let told_again = tokio::time::timeout(std::time::Duration::from_millis(200), port.next()).await;
        assert!(told_again.is_err(), "the same reason twice: {told_again:?}");
        assert!(matches!(port.state, State::Waiting { .. }));
    }

    #[tokio::test(start_paused = true)]
    async fn an_open_that_hangs_does_not_hang_the_start() {
        let (mut port, _release) = hanging_port();
        port.open_first().await.expect("it may open later");
        assert!(matches!(port.next().await, PortEvent::Down { .. }));
    }

    #[tokio::test(start_paused = true)]
    async fn an_open_that_hangs_does_not_hang_the_other_links() {
        let (hanging, _release) = hanging_port();
        let config =
            PortConfig { id: LinkId(8), url: LinkUrl::parse("udp://127.0.0.1:0").expect("a link"), role: Role::Listen };
        let mut set = crate::PortSet::new(vec![hanging, Port::new(config, HostTimer::start())]);
        set.open_first().await.expect("both may open later");
        let mut told = Vec::new();
        for _ in 0..2 {
            let (id, event) = set.next().await;
            told.push((id.0, matches!(event, PortEvent::Up { .. })));
        }
        told.sort_unstable();
        assert_eq!(told, [(7, false), (8, true)]);
        let address = set.get_mut(LinkId(8)).and_then(|port| port.local_address()).expect("it listens");
        let brick = std::net::UdpSocket::bind("127.0.0.1:0").expect("a free port");
        for number in 0..100 {
            brick.send_to(&[number], address).expect("loopback");
            let (id, event) = set.next().await;
            assert_eq!(id, LinkId(8));
            assert!(matches!(event, PortEvent::Bytes { bytes, .. } if bytes == [number]));
        }
    }
}
