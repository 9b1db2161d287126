//! UDP: listens on a port and answers its peers, or sends to a host first.
//!
//! One socket serves many peers. A peer that has been silent for a while is forgotten, except the host that the URL
//! names. The system's default receive buffer holds 256 small datagrams, five milliseconds of a large class, so it is
//! enlarged, and a smaller grant is reported. An error that one unreachable peer causes is not a loss of the link.
//!
//! Datagrams are delivered peer by peer in turn. A peer that floods gets its own socket (`udp_socket`), and fewer datagrams are
//! read from that per turn: it delays no others and causes no losses for them.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::ops::Bound;
use std::task::{Context, Poll, Waker};

use posebridge_telemetry::{HostClock, PeerId, Recipients, TimeDelta, Timestamp};
use tokio::net::UdpSocket;

use crate::capacity::CapacityMeter;
use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus, ReceivedBytes};
use crate::error::{LinkError, OpenError};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::transport::IDLE;
use crate::transports::open_request::{
    ConnectRole, OpenRequest, QUEUE_BYTES, listening_detail, resolve, with_deadline,
};
use crate::transports::udp_peers::UdpPeerTable;
use crate::transports::udp_socket::{
    bind_first_available, buffer_warning, connect_first_reachable, enlarge_receive_buffer, open_dedicated_socket,
};

/// Datagrams read from the socket per wake-up, so that one flooded link cannot starve the others.
const DRAIN_LIMIT: usize = 64;
/// Datagrams read from the socket of one flooding peer per wake-up.
const BUSY_DRAIN_LIMIT: usize = 16;
/// Most flooding peers with a socket of their own; further ones stay on the common socket.
const MAX_BUSY_PEERS: usize = 64;
/// Pause after a failure to open a peer's own socket: without a free descriptor each datagram would cost another attempt.
const DEDICATED_SOCKET_INTERVAL: TimeDelta = TimeDelta::from_millis(1_000);
/// Largest UDP datagram.
const DATAGRAM_BYTES: usize = 65_535;

pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    with_deadline(&request.url, bind_or_connect(&request)).await
}

async fn bind_or_connect(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let (host, port) = request.url.host_and_port();
    let targets = resolve(host, port).await?;
    // "Every interface" is no place to send to.
    let is_unspecific = |target: &SocketAddr| target.ip().is_unspecified();
    let is_listening =
        host.is_empty() || request.role == ConnectRole::Listen || targets.first().is_some_and(is_unspecific);
    let (socket, target) =
        if is_listening { bind_first_available(&targets)? } else { connect_first_reachable(&targets)? };
    let local_address = socket.local_addr().unwrap_or(target);
    // The reactor learns that the socket takes data; without it the very first frame would wait for another wake-up.
    socket.writable().await.map_err(|source| OpenError::Io { what: local_address.to_string(), source })?;
    let granted_bytes = enlarge_receive_buffer(&socket);
    let idle = TimeDelta::from_millis(1_000 * i64::from(request.url.integer(&IDLE)));
    let mut detail = if is_listening {
        listening_detail(&request.url, local_address)
    } else {
        format!("sending to {target} from {local_address}")
    };
    if let Some(warning) = buffer_warning(granted_bytes) {
        detail.push_str(&warning);
    }
    Ok(Box::new(UdpConnection {
        socket,
        local_address,
        is_listening,
        detail,
        timer: request.timer,
        busy_peers: Vec::new(),
        next_dedicated_socket: Timestamp::ZERO,
        peers: UdpPeerTable::new((!is_listening).then_some(target), idle),
        queue: SendQueue::new(QUEUE_BYTES),
        meter: CapacityMeter::default(),
        inbox: FairInbox::default(),
        was_idle: true,
        loss: None,
        buffer: vec![0; DATAGRAM_BYTES].into_boxed_slice(),
    }))
}

/// Datagrams that were read and not delivered yet, by peer.
#[derive(Default)]
struct FairInbox {
    by_peer: BTreeMap<PeerId, VecDeque<ReceivedBytes>>,
    last_served: PeerId,
}

impl FairInbox {
    fn push(&mut self, incoming: ReceivedBytes) {
        self.by_peer.entry(incoming.peer).or_default().push_back(incoming);
    }

    /// The oldest datagram of the next peer in turn.
    fn pop(&mut self) -> Option<ReceivedBytes> {
        let after = (Bound::Excluded(self.last_served), Bound::Unbounded);
        let next = self.by_peer.range(after).next();
        let (peer, _) = next.or_else(|| self.by_peer.iter().next())?;
        self.last_served = *peer;
        let queue = self.by_peer.get_mut(&self.last_served)?;
        let incoming = queue.pop_front();
        if queue.is_empty() {
            self.by_peer.remove(&self.last_served);
        }
        incoming
    }
}

/// A peer with a socket of its own.
struct BusyPeer {
    address: SocketAddr,
    socket: UdpSocket,
    /// Its earlier datagrams are in the common socket and have to be delivered first.
    is_shared_pending: bool,
}

struct UdpConnection {
    socket: UdpSocket,
    busy_peers: Vec<BusyPeer>,
    /// When the next peer may get its own socket.
    next_dedicated_socket: Timestamp<HostClock>,
    local_address: SocketAddr,
    is_listening: bool,
    detail: String,
    timer: HostTimer,
    peers: UdpPeerTable,
    queue: SendQueue<SocketAddr>,
    meter: CapacityMeter,
    inbox: FairInbox,
    /// Nothing was available at the last poll, so the next datagram is probably alone.
    was_idle: bool,
    /// Reported after everything that arrived before has been delivered.
    loss: Option<io::Error>,
    buffer: Box<[u8]>,
}

/// Whether a socket can still be used.
#[derive(PartialEq, Eq)]
enum SocketState {
    Open,
    Failed,
}

impl UdpConnection {
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut LinkCounters) {
        let mut taken = 0;
        while let Some((to, frame)) = self.queue.head() {
            let Poll::Ready(result) = self.socket.poll_send_to(cx, frame, *to) else {
                break;
            };
            taken += frame.len();
            count_sent(&result, counters);
            self.queue.pop_head();
        }
        self.record_write(taken);
    }

    fn record_write(&mut self, taken: usize) {
        self.meter.record_write_if_busy(|| self.timer.now(), taken, self.queue.backlog());
    }

    /// The first datagram after a pause. It bypasses the inbox: the socket is read again after it has been answered.
    fn receive_first(&mut self) -> Option<ReceivedBytes> {
        match self.socket.try_recv_from(&mut self.buffer) {
            Ok((length, from)) => self.received_datagram(length, from),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => None,
            Err(error) if is_about_one_peer(&error) => None,
            Err(error) => {
                self.loss = Some(error);
                None
            }
        }
    }

    /// Reads the datagrams of the common socket, up to the limit.
    fn drain(&mut self) {
        for _ in 0..DRAIN_LIMIT {
            match self.socket.try_recv_from(&mut self.buffer) {
                Ok((length, from)) => {
                    self.deliver(length, from);
                    if self.peers.is_busy(from) {
                        self.dedicate_socket(from);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    for loud in &mut self.busy_peers {
                        loud.is_shared_pending = true;
                    }
                    return;
                }
                Err(error) if is_about_one_peer(&error) => {}
                Err(error) => {
                    self.loss = Some(error);
                    return;
                }
            }
        }
    }

    /// Gives a flooding peer its own socket, if it has none and one can be opened.
    fn dedicate_socket(&mut self, address: SocketAddr) {
        let has_one = self.busy_peers.iter().any(|loud| loud.address == address);
        let now = self.timer.now();
        if has_one || self.busy_peers.len() >= MAX_BUSY_PEERS || now < self.next_dedicated_socket {
            return;
        }
        match open_dedicated_socket(&self.socket, self.local_address, address) {
            Ok(socket) => {
                tracing::info!(peer = %address, at = %self.local_address, "a loud peer is read apart");
                self.busy_peers.push(BusyPeer { address, socket, is_shared_pending: false });
            }
            Err(error) => {
                self.next_dedicated_socket = now + DEDICATED_SOCKET_INTERVAL;
                tracing::debug!(peer = %address, %error, "a loud peer stays");
            }
        }
    }

    /// Reads some datagrams of each flooding peer; false, with a waker registered at each, if there are none.
    fn drain_busy_peers(&mut self, cx: &mut Context<'_>) -> bool {
        let mut loud = std::mem::take(&mut self.busy_peers);
        let mut found = false;
        loud.retain(|one| {
            if one.is_shared_pending {
                match one.socket.poll_recv_ready(cx) {
                    Poll::Pending => {}
                    Poll::Ready(Err(_)) => return false,
                    Poll::Ready(Ok(())) => {
                        found = true;
                        if self.drain_datagram(&one.socket) == SocketState::Failed {
                            return false;
                        }
                    }
                }
            }
            self.peers.contains(one.address)
        });
        // No peer was given its own socket in the meantime: that happens in `drain` only.
        self.busy_peers = loud;
        found
    }

    fn drain_datagram(&mut self, socket: &UdpSocket) -> SocketState {
        for _ in 0..BUSY_DRAIN_LIMIT {
            match socket.try_recv_from(&mut self.buffer) {
                Ok((length, from)) => self.deliver(length, from),
                Err(error) if is_about_one_peer(&error) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return SocketState::Open,
                // The common socket receives the peer again when this one is closed.
                Err(_) => return SocketState::Failed,
            }
        }
        SocketState::Open
    }

    fn deliver(&mut self, length: usize, from: SocketAddr) {
        if let Some(incoming) = self.received_datagram(length, from) {
            self.inbox.push(incoming);
        }
    }

    /// The datagram in the buffer; `None` for an empty one, which only makes the peer known.
    fn received_datagram(&mut self, length: usize, from: SocketAddr) -> Option<ReceivedBytes> {
        let arrival = self.timer.now();
        let peer = self.peers.record_activity(from, arrival);
        let bytes = self.buffer.get(..length).unwrap_or_default().to_vec();
        (!bytes.is_empty()).then_some(ReceivedBytes { peer, arrival, bytes })
    }
}

impl Connection for UdpConnection {
    fn detail(&self) -> String {
        self.detail.clone()
    }

    fn local_address(&self) -> Option<SocketAddr> {
        Some(self.local_address)
    }

    fn is_listening(&self) -> bool {
        self.is_listening
    }

    fn peer_address(&self, peer: PeerId) -> Option<IpAddr> {
        self.peers.address_of(peer).map(|address| address.ip())
    }

    fn send(&mut self, out: &OutgoingFrame<'_>, counters: &mut LinkCounters) {
        let frame = out.frame;
        let mut cx = Context::from_waker(Waker::noop());
        for to in self.peers.recipient_addresses(out.to, self.timer.now()) {
            if !self.queue.is_empty() {
                counters.drops_out += self.queue.push(to, out.priority, frame);
                continue;
            }
            match self.socket.poll_send_to(&mut cx, frame, to) {
                Poll::Ready(result) => count_sent(&result, counters),
                Poll::Pending => counters.drops_out += self.queue.push(to, out.priority, frame),
            }
        }
        self.record_write(0);
    }

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        self.flush(cx, counters);
        loop {
            if let Some(incoming) = self.inbox.pop() {
                return Poll::Ready(Ok(Some(incoming)));
            }
            if let Some(error) = self.loss.take() {
                return Poll::Ready(Err(error.into()));
            }
            let common = self.socket.poll_recv_ready(cx);
            match common {
                Poll::Ready(Ok(())) => {
                    if std::mem::take(&mut self.was_idle)
                        && let Some(first) = self.receive_first()
                    {
                        return Poll::Ready(Ok(Some(first)));
                    }
                    self.drain();
                }
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error.into())),
                Poll::Pending => {}
            }
            if !self.drain_busy_peers(cx) && common.is_pending() {
                self.was_idle = true;
                return Poll::Pending;
            }
        }
    }

    fn count_recipients(&self, to: Recipients) -> u32 {
        self.peers.count_recipients(to, self.timer.now())
    }

    fn queue_status(&self, now: Timestamp<HostClock>) -> QueueStatus {
        QueueStatus {
            peers: self.peers.count_recipients(Recipients::All, now),
            frames: self.queue.len() as u64,
            bytes: self.queue.bytes() as u64,
            capacity_bytes_per_s: self.meter.bytes_per_s(now),
        }
    }
}

/// A datagram that the system refuses concerns one peer or one moment, never the link.
fn count_sent(result: &io::Result<usize>, counters: &mut LinkCounters) {
    match result {
        Ok(count) => counters.bytes_out += *count as u64,
        Err(_) => counters.drops_out += 1,
    }
}

/// Errors on the socket that earlier datagrams to an unreachable peer caused.
fn is_about_one_peer(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::ConnectionRefused
            | io::ErrorKind::ConnectionReset
            | io::ErrorKind::HostUnreachable
            | io::ErrorKind::NetworkUnreachable
            | io::ErrorKind::Interrupted
    )
}
