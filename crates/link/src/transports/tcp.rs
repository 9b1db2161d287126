//! TCP: a client, or with [`ConnectRole::Listen`] a server for many clients.
//!
//! Every client of a server is a byte source of its own, and receives what is sent to all. Clients come and go without
//! the link going down; only the loss of the listening socket is a loss. If the system cannot accept another client (no
//! descriptor left, no memory, network down), those that are connected stay, and new ones wait in the system's queue
//! for a moment. Each client has its own send queue, so a slow one delays no other. At a full server a new client takes the place
//! of one that never said anything, or else of the one that has been silent for longest; a robot that is answered keeps its place.
//!
//! Nagle's delay is off, because estimates are small and urgent. Keep-alives detect peers that left without closing, such as a
//! robot that drives out of the access point's range.
//!
//! Linux would let a send buffer grow to 4 MiB, minutes of data on a slow link that nothing can overtake. It is kept small, so
//! that frames for a slow peer wait in the link's own queue, where the newest estimate replaces the one before it. The *peer's*
//! receive buffer is outside our control and adds to the age of what it reads.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use nix::errno::Errno;
use posebridge_telemetry::{
    Admission, AdmissionLimits, ClientNetwork, ConnectionUse, HostClock, Occupant, PeerId, Recipients, TimeDelta,
    Timestamp,
};
use socket2::{SockRef, TcpKeepalive};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::Sleep;

use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus, ReceivedBytes};
use crate::error::{LinkError, OpenError};
use crate::host_timer::HostTimer;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::open_request::{
    ConnectRole, OpenRequest, QUEUE_BYTES, bind_error, dialled_host, listening_detail, no_address, resolve,
    with_deadline,
};

pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    match request.role {
        ConnectRole::Dial => with_deadline(&request.url, dial(&request)).await,
        ConnectRole::Listen => TcpServer::open(&request).await,
    }
}

async fn dial(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let (host, port) = dialled_host(&request.url)?;
    let unreachable = |source| OpenError::Unreachable { peer: format!("{host}:{port}"), source };
    let addresses = resolve(host, port).await?;
    let stream = TcpStream::connect(&addresses[..]).await.map_err(unreachable)?;
    configure(&stream).map_err(unreachable)?;
    let peer = stream.peer_addr().map_err(unreachable)?;
    let mut label = StreamLabel::new(format!("connected to {peer}"));
    label.local_address = stream.local_addr().ok();
    Ok(Box::new(StreamConnection::new(stream, label, request.timer, QUEUE_BYTES)))
}

/// Most clients at a time: a class of robots with a few viewers each. A quarter is left for others than the largest one.
const CLIENT_LIMITS: AdmissionLimits = AdmissionLimits { total: 256, per_client: 192 };

/// Of the system's queue of clients that are not accepted yet; 128 without this.
const MAX_WAITING_CLIENTS: i32 = 1_024;

/// A client that sent something, and was sent something for itself, within this time is in use: as long as a UDP peer is known.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(10_000);

/// Most new clients between two rounds through the present ones, which a flood of new ones must not hold up.
const MAX_ACCEPTS_PER_POLL: usize = 8;

/// Between two warnings that the server is full.
const WARNING_INTERVAL: TimeDelta = TimeDelta::from_millis(60_000);

/// Pause after a failed accept: a lasting failure, such as a full table of descriptors, must not keep the loop busy.
const ACCEPT_PAUSE: TimeDelta = TimeDelta::from_millis(500);

struct TcpServer {
    listener: TcpListener,
    address: SocketAddr,
    detail: String,
    timer: HostTimer,
    clients: Vec<TcpClient>,
    next_peer: u32,
    /// The client that is polled first, so that a flooding one does not starve the others.
    next_index: usize,
    /// The end of the pause after a failure.
    accept_pause: Option<Pin<Box<Sleep>>>,
    /// Whether the last accept failed; reported once.
    is_accept_failing: bool,
    /// When it was last said that the server is full.
    warned_full: Option<Timestamp<HostClock>>,
}

struct TcpClient {
    connection: StreamConnection<TcpStream>,
    peer: PeerId,
    host: IpAddr,
    network: ClientNetwork,
    came: Timestamp<HostClock>,
    /// `None` while nothing was.
    last_received: Option<Timestamp<HostClock>>,
    /// When the station last sent something for this client alone, as it does to a robot that it understands.
    last_addressed: Option<Timestamp<HostClock>>,
}

impl TcpClient {
    fn occupant(&self, now: Timestamp<HostClock>) -> Occupant {
        let is_recent = |at: Option<Timestamp<HostClock>>| at.is_some_and(|at| now - at <= MAX_SILENCE);
        let usage = if self.last_received.is_none() {
            ConnectionUse::Unproven
        } else if is_recent(self.last_received) && is_recent(self.last_addressed) {
            ConnectionUse::Active
        } else {
            ConnectionUse::Idle
        };
        Occupant { client: self.network, usage, since: self.last_received.unwrap_or(self.came) }
    }
}

fn network_of(address: SocketAddr) -> ClientNetwork {
    let ip = match address.ip() {
        IpAddr::V4(v4) => v4.to_ipv6_mapped(),
        IpAddr::V6(v6) => v6,
    };
    ClientNetwork::from_ipv6_octets(ip.octets())
}

impl TcpServer {
    /// Listens at the link's host and port.
    async fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
        let (host, port) = request.url.host_and_port();
        let mut failure = None;
        for address in resolve(host, port).await? {
            match TcpListener::bind(address).await {
                Ok(listener) => {
                    // Works without, then a crowd makes others try again after a second.
                    drop(SockRef::from(&listener).listen(MAX_WAITING_CLIENTS));
                    let address = listener.local_addr().unwrap_or(address);
                    return Ok(Box::new(Self {
                        listener,
                        address,
                        detail: listening_detail(&request.url, address),
                        timer: request.timer,
                        clients: Vec::new(),
                        next_peer: 0,
                        next_index: 0,
                        accept_pause: None,
                        is_accept_failing: false,
                        warned_full: None,
                    }));
                }
                Err(error) => failure = Some(bind_error(address, error)),
            }
        }
        Err(failure.unwrap_or_else(|| no_address(host)))
    }

    fn accept(&mut self, cx: &mut Context<'_>, counters: &mut LinkCounters) -> Result<(), LinkError> {
        for _ in 0..MAX_ACCEPTS_PER_POLL {
            if let Some(pause) = &mut self.accept_pause {
                if pause.as_mut().poll(cx).is_pending() {
                    return Ok(());
                }
                self.accept_pause = None;
            }
            match self.listener.poll_accept(cx) {
                Poll::Pending => return Ok(()),
                Poll::Ready(Ok((stream, from))) => {
                    self.is_accept_failing = false;
                    self.add_client(stream, from, counters);
                }
                // The client left before it was greeted; that is its own business.
                Poll::Ready(Err(error)) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Poll::Ready(Err(error)) if is_listener_failure(&error) => return Err(error.into()),
                Poll::Ready(Err(error)) => self.pause_accepting(&error),
            }
        }
        // More may wait: they get the next turn.
        cx.waker().wake_by_ref();
        Ok(())
    }

    fn pause_accepting(&mut self, error: &io::Error) {
        if !self.is_accept_failing {
            self.is_accept_failing = true;
            tracing::warn!(at = %self.address, %error, clients = self.clients.len(), "no further client can be had");
        }
        let end = self.timer.instant(self.timer.now() + ACCEPT_PAUSE);
        self.accept_pause = Some(Box::pin(tokio::time::sleep_until(end)));
    }

    fn add_client(&mut self, stream: TcpStream, from: SocketAddr, counters: &mut LinkCounters) {
        let (network, now) = (network_of(from), self.timer.now());
        let occupants: Vec<Occupant> = self.clients.iter().map(|client| client.occupant(now)).collect();
        match CLIENT_LIMITS.admit(network, &occupants) {
            Admission::Free => {}
            Admission::Replaces(index) => {
                self.warn_full(now, from, "the server is full: a new client takes the place of the longest silent one");
                self.remove_client(index, "made room for another", counters);
            }
            Admission::ClientFull | Admission::AllFull => {
                self.warn_full(now, from, "the server is full of clients in use: turned a new one away");
                return;
            }
        }
        if let Err(error) = configure(&stream) {
            tracing::debug!(%from, %error, "a client left at once");
            return;
        }
        let peer = PeerId(self.next_peer);
        let label = StreamLabel {
            detail: format!("client {from}"),
            local_address: Some(self.address),
            stable_path: None,
            peer,
        };
        self.next_peer = self.next_peer.wrapping_add(1);
        tracing::debug!(%from, at = %self.address, "client came");
        let connection = StreamConnection::new(stream, label, self.timer, QUEUE_BYTES);
        self.clients.push(TcpClient {
            connection,
            peer,
            host: from.ip(),
            network,
            came: now,
            last_received: None,
            last_addressed: None,
        });
    }

    /// Warns now and then, so that a flood of clients fills no log.
    fn warn_full(&mut self, now: Timestamp<HostClock>, from: SocketAddr, what: &str) {
        if self.warned_full.is_none_or(|at| now - at >= WARNING_INTERVAL) {
            self.warned_full = Some(now);
            let AdmissionLimits { total, per_client } = CLIENT_LIMITS;
            tracing::warn!(%from, at = %self.address, limit = total, limit_of_one_address = per_client, "{what}");
        }
    }

    /// Closes a client; the order of the others, whose turns are positions in it, stays.
    fn remove_client(&mut self, index: usize, why: &str, counters: &mut LinkCounters) {
        let client = self.clients.remove(index);
        tracing::debug!(client = %client.connection.detail(), why, "client went");
        counters.drops_out += client.connection.queue_status(self.timer.now()).frames;
        if index < self.next_index {
            self.next_index -= 1;
        }
    }

    /// Polls every client once, beginning with `next_index`.
    fn poll_clients(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        let mut polled = 0;
        while polled < self.clients.len() {
            let index = self.next_index % self.clients.len();
            let Some(client) = self.clients.get_mut(index) else {
                break;
            };
            match client.connection.poll(cx, counters) {
                Poll::Ready(Ok(incoming)) => {
                    client.last_received = incoming.as_ref().map(|received| received.arrival);
                    self.next_index = index + 1;
                    return Poll::Ready(Ok(incoming));
                }
                Poll::Ready(Err(loss)) => {
                    self.next_index = index;
                    self.remove_client(index, &loss.to_string(), counters);
                }
                Poll::Pending => {
                    self.next_index = index + 1;
                    polled += 1;
                }
            }
        }
        Poll::Pending
    }
}

impl Connection for TcpServer {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    fn local_address(&self) -> Option<SocketAddr> {
        Some(self.address)
    }

    fn is_listening(&self) -> bool {
        true
    }

    fn peer_address(&self, peer: PeerId) -> Option<IpAddr> {
        self.clients.iter().find(|client| client.peer == peer).map(|client| client.host)
    }

    fn send(&mut self, out: &OutgoingFrame<'_>, counters: &mut LinkCounters) {
        let addressed = if let Recipients::Peer(peer) = out.to { Some(peer) } else { None };
        for client in &mut self.clients {
            if addressed == Some(client.peer) {
                client.last_addressed = Some(self.timer.now());
            }
            client.connection.send(out, counters);
        }
    }

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        if let Err(loss) = self.accept(cx, counters) {
            return Poll::Ready(Err(loss));
        }
        self.poll_clients(cx, counters)
    }

    fn count_recipients(&self, to: Recipients) -> u32 {
        self.clients.iter().map(|client| client.connection.count_recipients(to)).sum()
    }

    fn queue_status(&self, now: Timestamp<HostClock>) -> QueueStatus {
        let mut all =
            QueueStatus { capacity_bytes_per_s: (!self.clients.is_empty()).then_some(0.0), ..QueueStatus::default() };
        for client in &self.clients {
            let one = client.connection.queue_status(now);
            all.peers += one.peers;
            all.frames += one.frames;
            all.bytes += one.bytes;
            // The fastest client counts, and one that keeps up is faster than any figure.
            let fastest = all.capacity_bytes_per_s.zip(one.capacity_bytes_per_s);
            all.capacity_bytes_per_s = fastest.map(|(a, b)| a.max(b));
        }
        all
    }
}

/// Whether an error of accept(2) means that the listening socket is lost. All others concern one client, the network or the
/// system's resources.
fn is_listener_failure(error: &io::Error) -> bool {
    let code = error.raw_os_error().map(Errno::from_raw);
    matches!(code, Some(Errno::EBADF | Errno::EINVAL | Errno::ENOTSOCK | Errno::EOPNOTSUPP))
}

/// Silence before the first keep-alive probe.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
/// Unanswered probes before the connection counts as lost.
const KEEPALIVE_RETRIES: u32 = 3;
/// How long sent data may stay unacknowledged: as long as the keep-alives take.
const USER_TIMEOUT: Duration = Duration::from_secs(11);

/// Send buffer; Linux doubles it for its own bookkeeping. It also limits the bytes in flight: at a round-trip time of 20 ms
/// to 800 kB/s, a hundred times the rate of a robot's link.
const SEND_BUFFER_BYTES: usize = 16 * 1024;
/// Unsent bytes above which the system accepts no more (tcp(7), TCP_NOTSENT_LOWAT): about seven of the longest frames (280
/// bytes), so that the link never idles.
const UNSENT_BYTES: u32 = 2 * 1024;

pub(super) fn configure(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    socket.set_tcp_keepalive(
        &TcpKeepalive::new()
            .with_time(KEEPALIVE_IDLE)
            .with_interval(KEEPALIVE_INTERVAL)
            .with_retries(KEEPALIVE_RETRIES),
    )?;
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.set_tcp_notsent_lowat(UNSENT_BYTES)?;
    socket.set_tcp_user_timeout(Some(USER_TIMEOUT))
}
