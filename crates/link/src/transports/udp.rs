//! UDP: listens on a port and answers its peers, or sends to a host first.
//!
//! One socket serves many peers. A peer that has been silent for a while is forgotten, except the host that the URL
//! names. The system's default receive buffer holds 256 small datagrams, five milliseconds of a large class, so it is
//! enlarged, and a smaller grant is reported. An error that one unreachable peer causes is not a loss of the link.
//!
//! Each peer has a budget (`udp_peers`); what is above it is dropped before anything else is done with it. Datagrams are
//! delivered peer by peer in turn, those of loud peers and strangers only when no other waits. A peer that floods gets its own
//! socket (`udp_socket`), which is read while its budget lasts: it delays no others and causes no losses for them.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::ops::Bound;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use posebridge_telemetry::{HostClock, PeerId, Priority, Recipients, TimeDelta, Timestamp};
use tokio::time::Sleep;

use crate::capacity::CapacityMeter;
use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus, ReceivedBytes};
use crate::error::{LinkError, OpenError};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::transport::IDLE;
use crate::transports::host_name::HostNameWatch;
use crate::transports::open_request::{
    ConnectRole, OpenRequest, QUEUE_BYTES, listening_detail, resolve, with_deadline,
};
use crate::transports::udp_peers::{PeerStanding, UdpPeerTable};
use crate::transports::udp_socket::{
    DatagramSocket, bind_first_available, buffer_warning, connect_first_reachable, enlarge_receive_buffer,
    open_dedicated_socket,
};

/// Datagrams read from the socket per wake-up, so that one flooded link cannot starve the others.
const DRAIN_LIMIT: usize = 256;
/// Datagrams read in search of one that goes first, before one of a loud peer or a stranger is delivered: about two milliseconds.
const SEARCH_LIMIT: usize = 2048;
/// Datagrams of loud peers and strangers that wait before some are dropped; four times as many wait at most, besides the first of each.
const MAX_LOW_PRIORITY: usize = 1024;
/// Copies of a frame for many peers that are sent before the next datagram is read: 500 of them at once would delay the robots by
/// milliseconds.
const COPIES_AT_ONCE: usize = 16;
/// Most frames of which copies are left to send.
const MAX_BROADCASTS: usize = 16;
/// How long the sockets of flooding peers are left alone when the budgets of all are used up.
const BUDGET_PAUSE: TimeDelta = TimeDelta::from_millis(10);
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
        socket: DatagramSocket::new(socket),
        local_address,
        is_listening,
        name_watch: (!is_listening).then(|| HostNameWatch::new(host, target, request.timer)).flatten(),
        detail,
        timer: request.timer,
        busy_peers: Vec::new(),
        next_dedicated_socket: Timestamp::ZERO,
        budget_pause: None,
        peers: UdpPeerTable::new((!is_listening).then_some(target), idle, request.tuning.first_contact),
        queue: SendQueue::new(QUEUE_BYTES),
        broadcasts: VecDeque::new(),
        meter: CapacityMeter::default(),
        inbox: FairInbox::default(),
        low_priority: FairInbox::default(),
        kernel_drops: 0,
        flood_drops: 0,
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
    count: usize,
}

impl FairInbox {
    fn push(&mut self, incoming: ReceivedBytes) {
        self.count += 1;
        self.by_peer.entry(incoming.peer).or_default().push_back(incoming);
    }

    fn take_all(&mut self, peer: PeerId) -> VecDeque<ReceivedBytes> {
        let queue = self.by_peer.remove(&peer).unwrap_or_default();
        self.count -= queue.len();
        queue
    }

    /// Whether the peer's next datagram is dropped. Above the limit a peer with more than the average waiting is refused; above four
    /// times the limit, every peer with one waiting.
    fn is_full_for(&self, peer: PeerId) -> bool {
        let waiting = self.by_peer.get(&peer).map_or(0, VecDeque::len);
        let is_above_average = waiting * self.by_peer.len() > self.count;
        waiting > 0 && (self.count >= 4 * MAX_LOW_PRIORITY || self.count >= MAX_LOW_PRIORITY && is_above_average)
    }

    /// The oldest datagram of the next peer in turn.
    fn pop(&mut self) -> Option<ReceivedBytes> {
        let after = (Bound::Excluded(self.last_served), Bound::Unbounded);
        let next = self.by_peer.range(after).next();
        let (peer, _) = next.or_else(|| self.by_peer.iter().next())?;
        self.last_served = *peer;
        let queue = self.by_peer.get_mut(&self.last_served)?;
        let incoming = queue.pop_front();
        self.count -= 1;
        if queue.is_empty() {
            self.by_peer.remove(&self.last_served);
        }
        incoming
    }
}

/// A peer with a socket of its own.
struct BusyPeer {
    address: SocketAddr,
    socket: DatagramSocket,
    /// Its earlier datagrams are in the common socket and have to be delivered first.
    is_shared_pending: bool,
}

/// A frame for many peers, and those that have not been sent it.
struct Broadcast {
    priority: Priority,
    frame: Vec<u8>,
    recipients: std::vec::IntoIter<SocketAddr>,
}

struct UdpConnection {
    socket: DatagramSocket,
    busy_peers: Vec<BusyPeer>,
    /// When the next peer may get its own socket.
    next_dedicated_socket: Timestamp<HostClock>,
    /// The end of the pause in reading flooding peers.
    budget_pause: Option<Pin<Box<Sleep>>>,
    local_address: SocketAddr,
    is_listening: bool,
    /// Of a host that was dialled by name.
    name_watch: Option<HostNameWatch>,
    detail: String,
    timer: HostTimer,
    peers: UdpPeerTable,
    queue: SendQueue<SocketAddr>,
    broadcasts: VecDeque<Broadcast>,
    meter: CapacityMeter,
    inbox: FairInbox,
    /// Of loud peers and strangers: delivered while nothing else waits.
    low_priority: FairInbox,
    /// Not reported yet.
    kernel_drops: u64,
    flood_drops: u64,
    /// Nothing was available at the last poll, so the next datagram is probably alone.
    was_idle: bool,
    /// Reported after everything that arrived before has been delivered.
    loss: Option<io::Error>,
    buffer: Box<[u8]>,
}

/// A way to read the next datagram: its length and sender.
type Receive = fn(&mut DatagramSocket, &mut [u8], &mut u64) -> io::Result<(usize, SocketAddr)>;

/// Whether a socket can still be used.
#[derive(PartialEq, Eq)]
enum SocketState {
    Open,
    Failed,
}

/// What became of a datagram.
enum Arrival {
    /// To be delivered at once.
    Prompt(ReceivedBytes),
    /// It waits, or was empty.
    Kept(PeerStanding),
    /// Its peer is above its budget.
    Cut,
}

impl UdpConnection {
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut LinkCounters) {
        let mut taken = 0;
        while let Some((to, frame)) = self.queue.head() {
            let Poll::Ready(result) = self.socket.socket.poll_send_to(cx, frame, *to) else {
                break;
            };
            taken += frame.len();
            count_sent(&result, counters);
            self.queue.pop_head();
        }
        self.record_write(taken);
    }

    /// Sends up to `limit` copies of the oldest frame for many peers.
    fn send_copies(&mut self, limit: usize, counters: &mut LinkCounters) {
        let Some(mut broadcast) = self.broadcasts.pop_front() else {
            return;
        };
        for to in broadcast.recipients.by_ref().take(limit) {
            self.send_to(to, broadcast.priority, &broadcast.frame, counters);
        }
        if broadcast.recipients.len() > 0 {
            self.broadcasts.push_front(broadcast);
        }
    }

    fn send_to(&mut self, to: SocketAddr, priority: Priority, frame: &[u8], counters: &mut LinkCounters) {
        if self.queue.is_empty()
            && let Poll::Ready(result) =
                self.socket.socket.poll_send_to(&mut Context::from_waker(Waker::noop()), frame, to)
        {
            count_sent(&result, counters);
            return;
        }
        counters.drops_out += self.queue.push(to, priority, frame);
    }

    fn record_write(&mut self, taken: usize) {
        self.meter.record_write_if_busy(|| self.timer.now(), taken, self.queue.backlog());
    }

    /// The first datagram after a pause. It bypasses the inbox: the socket is read again after it has been answered.
    fn receive_first(&mut self) -> Option<ReceivedBytes> {
        match self.socket.try_recv_from(&mut self.buffer, &mut self.kernel_drops) {
            Ok((length, from)) => match self.accept(length, from) {
                // Both inboxes are empty after a pause.
                Arrival::Prompt(incoming) => Some(incoming),
                Arrival::Kept(_) | Arrival::Cut => None,
            },
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => None,
            Err(error) if is_about_one_peer(&error) => None,
            Err(error) => {
                self.loss = Some(error);
                None
            }
        }
    }

    /// Reads the datagrams of the common socket with `receive`, up to the limit.
    fn drain(&mut self, receive: Receive) {
        for _ in 0..DRAIN_LIMIT {
            match receive(&mut self.socket, &mut self.buffer, &mut self.kernel_drops) {
                Ok((length, from)) => self.accept_shared(length, from),
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

    /// The next datagram of a loud peer or a stranger, or one of another peer that has come meanwhile.
    fn pop_low_priority(&mut self) -> Option<ReceivedBytes> {
        if self.low_priority.count == 0 {
            return None;
        }
        for _ in 0..SEARCH_LIMIT {
            // An error is seen again by the next regular read.
            let Ok((length, from)) = self.socket.recv_from_now(&mut self.buffer, &mut self.kernel_drops) else { break };
            self.accept_shared(length, from);
            if self.inbox.count > 0 {
                break;
            }
        }
        self.inbox.pop().or_else(|| self.low_priority.pop())
    }

    fn accept_shared(&mut self, length: usize, from: SocketAddr) {
        match self.accept(length, from) {
            Arrival::Prompt(incoming) => self.inbox.push(incoming),
            Arrival::Kept(PeerStanding::Calm | PeerStanding::Stranger) => {}
            Arrival::Kept(PeerStanding::Loud) | Arrival::Cut => self.dedicate_socket(from),
        }
    }

    /// Gives a flooding peer its own socket, if it has none and one can be opened.
    fn dedicate_socket(&mut self, address: SocketAddr) {
        let has_one = self.busy_peers.iter().any(|loud| loud.address == address);
        let now = self.timer.now();
        if has_one || self.busy_peers.len() >= MAX_BUSY_PEERS || now < self.next_dedicated_socket {
            return;
        }
        match open_dedicated_socket(&self.socket.socket, self.local_address, address) {
            Ok(socket) => {
                tracing::info!(peer = %address, at = %self.local_address, "a loud peer is read apart");
                let socket = DatagramSocket::new(socket);
                self.busy_peers.push(BusyPeer { address, socket, is_shared_pending: false });
            }
            Err(error) => {
                self.next_dedicated_socket = now + DEDICATED_SOCKET_INTERVAL;
                tracing::debug!(peer = %address, %error, "a loud peer stays");
            }
        }
    }

    fn poll_receive(&mut self, cx: &mut Context<'_>) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        loop {
            if let Some(incoming) = self.inbox.pop().or_else(|| self.pop_low_priority()) {
                return Poll::Ready(Ok(Some(incoming)));
            }
            if let Some(error) = self.loss.take() {
                return Poll::Ready(Err(error.into()));
            }
            let common = self.socket.socket.poll_recv_ready(cx);
            match common {
                Poll::Ready(Ok(())) => {
                    if std::mem::take(&mut self.was_idle)
                        && let Some(first) = self.receive_first()
                    {
                        return Poll::Ready(Ok(Some(first)));
                    }
                    self.drain(DatagramSocket::try_recv_from);
                }
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error.into())),
                // The runtime does not tell that the socket is empty if its last datagram was read in search of one that goes first.
                Poll::Pending if self.busy_peers.iter().any(|loud| !loud.is_shared_pending) => {
                    self.drain(DatagramSocket::recv_from_now);
                }
                Poll::Pending => {}
            }
            let is_busy = self.drain_busy_peers(cx);
            if self.inbox.count + self.low_priority.count > 0 || self.loss.is_some() {
                continue;
            }
            if !is_busy && common.is_pending() {
                self.was_idle = true;
                return Poll::Pending;
            }
            // All that was read was cut: the other links have their turn.
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
    }

    /// Reads some datagrams of each flooding peer; false, with a waker registered, if there are none within the budgets.
    fn drain_busy_peers(&mut self, cx: &mut Context<'_>) -> bool {
        let mut loud = std::mem::take(&mut self.busy_peers);
        let (mut found, mut has_paused) = (false, false);
        loud.retain_mut(|one| {
            if one.is_shared_pending && !self.peers.has_budget(one.address, self.timer.now()) {
                has_paused = true;
            } else if one.is_shared_pending {
                match one.socket.socket.poll_recv_ready(cx) {
                    Poll::Pending => {}
                    Poll::Ready(Err(_)) => return false,
                    Poll::Ready(Ok(())) => {
                        found = true;
                        if self.drain_dedicated(one) == SocketState::Failed {
                            return false;
                        }
                    }
                }
            }
            self.peers.contains(one.address)
        });
        // No peer was given its own socket in the meantime: that happens for the common socket only.
        self.busy_peers = loud;
        if !found && has_paused {
            let end = self.timer.instant(self.timer.now() + BUDGET_PAUSE);
            let pause = self.budget_pause.get_or_insert_with(|| Box::pin(tokio::time::sleep_until(end)));
            if pause.as_mut().poll(cx).is_ready() {
                self.budget_pause = None;
                cx.waker().wake_by_ref();
            }
        }
        found
    }

    fn drain_dedicated(&mut self, one: &mut BusyPeer) -> SocketState {
        for _ in 0..BUSY_DRAIN_LIMIT {
            // What the system drops here is this peer's.
            match one.socket.try_recv_from(&mut self.buffer, &mut self.flood_drops) {
                Ok((length, from)) => match self.accept(length, from) {
                    Arrival::Prompt(incoming) => self.inbox.push(incoming),
                    Arrival::Kept(_) => {}
                    // The rest waits for its budget.
                    Arrival::Cut => break,
                },
                Err(error) if is_about_one_peer(&error) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return SocketState::Open,
                // The common socket receives the peer again when this one is closed.
                Err(_) => return SocketState::Failed,
            }
        }
        SocketState::Open
    }

    /// What waits of a peer is not overtaken by what comes after.
    fn promote(&mut self, peer: PeerId) {
        for waiting in self.low_priority.take_all(peer) {
            self.inbox.push(waiting);
        }
    }

    /// Decides about the datagram in the buffer; an empty one only makes its peer known.
    fn accept(&mut self, length: usize, from: SocketAddr) -> Arrival {
        let arrival = self.timer.now();
        if let Some(watch) = &mut self.name_watch {
            watch.record_arrival();
        }
        let Some((peer, standing)) = self.peers.receive(from, length, arrival) else {
            self.flood_drops += 1;
            return Arrival::Cut;
        };
        if length == 0 {
            return Arrival::Kept(standing);
        }
        // A peer's first datagram is never dropped: the station learns of peers in the order of their numbers.
        if standing != PeerStanding::Calm && self.low_priority.is_full_for(peer) {
            self.flood_drops += 1;
            return Arrival::Kept(standing);
        }
        let bytes = self.buffer.get(..length).unwrap_or_default().to_vec();
        let incoming = ReceivedBytes { peer, arrival, bytes };
        match standing {
            PeerStanding::Calm => {
                self.promote(peer);
                Arrival::Prompt(incoming)
            }
            PeerStanding::Loud | PeerStanding::Stranger => {
                self.low_priority.push(incoming);
                Arrival::Kept(standing)
            }
        }
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

    fn admit(&mut self, peer: PeerId) {
        self.peers.admit(peer);
        self.promote(peer);
    }

    fn send(&mut self, out: &OutgoingFrame<'_>, counters: &mut LinkCounters) {
        let recipients = self.peers.recipient_addresses(out.to, self.timer.now());
        if recipients.len() <= COPIES_AT_ONCE {
            for to in recipients {
                self.send_to(to, out.priority, out.frame, counters);
            }
        } else {
            if self.broadcasts.len() >= MAX_BROADCASTS {
                self.send_copies(usize::MAX, counters);
            }
            let (priority, frame) = (out.priority, out.frame.to_vec());
            self.broadcasts.push_back(Broadcast { priority, frame, recipients: recipients.into_iter() });
        }
        self.record_write(0);
    }

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        self.flush(cx, counters);
        self.send_copies(COPIES_AT_ONCE, counters);
        let polled = self.poll_receive(cx);
        if polled.is_pending() && !self.broadcasts.is_empty() {
            cx.waker().wake_by_ref();
        }
        counters.kernel_drops += std::mem::take(&mut self.kernel_drops);
        counters.flood_drops += std::mem::take(&mut self.flood_drops);
        if polled.is_pending()
            && let Some(watch) = &mut self.name_watch
        {
            return watch.poll_move(cx).map(Err);
        }
        polled
    }

    fn count_recipients(&self, to: Recipients) -> u32 {
        self.peers.count_recipients(to, self.timer.now())
    }

    fn queue_status(&self, now: Timestamp<HostClock>) -> QueueStatus {
        let copies = self.broadcasts.iter().map(|broadcast| broadcast.recipients.len() as u64).sum::<u64>();
        QueueStatus {
            peers: self.peers.count_recipients(Recipients::All, now),
            frames: self.queue.len() as u64 + copies,
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
