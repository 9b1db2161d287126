//! UDP: listens on a port and answers whom it hears, or sends to a host first.
//!
//! One socket, many peers. A peer that has been silent for a while is forgotten, except the host that the link names. The
//! system's default receive buffer holds 256 small datagrams, five milliseconds of a large class, so it is enlarged and
//! what was really granted is told. Errors that one unreachable peer causes are not a loss of the link.
//!
//! What was drained is delivered peer by peer in turn, and a peer that floods gets a socket of its own (`udp_socket`), of
//! which less is taken per turn: it delays nobody and costs nobody a datagram.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::net::SocketAddr;
use std::ops::Bound;
use std::task::{Context, Poll, Waker};

use posebridge_telemetry::{Audience, HostClock, PeerId, Span, Stamp};
use tokio::net::UdpSocket;

use crate::capacity::CapacityMeter;
use crate::connection::{Connection, Incoming, Outgoing, Outstanding, PortCounters};
use crate::error::{LinkLoss, OpenError};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::transports::udp_peers::Peers;
use crate::transports::udp_socket::{bind_first, buffer_warning, call_first, enlarge_receive_buffer, split_off};
use crate::transports::{
    OpenFuture, OpenRequest, QUEUE_BYTES, RATE, Role, Transport, listening_detail, resolve, with_deadline,
};
use crate::url::{OptionHelp, OptionKind, TargetKind};

/// Datagrams taken from the socket per wake-up, so that one flooded port cannot starve the others.
const DRAIN_LIMIT: usize = 64;
/// Datagrams taken from the socket of one loud peer in the same time.
const LOUD_DRAIN_LIMIT: usize = 16;
/// Most loud peers with a socket of their own; further ones stay with the others.
const MAX_LOUD: usize = 64;
/// How long nobody is set apart after an attempt has failed: without a descriptor left each datagram of a loud peer would
/// cost another attempt.
const APART_PAUSE: Span = Span::from_millis(1_000);
/// Largest UDP datagram.
const DATAGRAM_BYTES: usize = 65_535;

/// When a peer is forgotten. Ten heartbeats of MAVLink may be lost before the default.
const IDLE: OptionHelp = OptionHelp {
    name: "idle_s",
    kind: OptionKind::Integer { min: 1, max: 86_400, default: 10 },
    help: "seconds of silence after which a peer is not written to any more",
};

/// See the module.
pub(crate) struct Udp;

impl Transport for Udp {
    fn scheme(&self) -> &'static str {
        "udp"
    }
    fn summary(&self) -> &'static str {
        "UDP: without a host it listens and answers whom it hears, with a host it sends there first"
    }
    fn example(&self) -> &'static str {
        "udp://:14550"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Host
    }
    fn options(&self) -> &'static [OptionHelp] {
        &[IDLE, RATE]
    }
    fn is_datagram(&self) -> bool {
        true
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(async move { with_deadline(&request.url, open(&request)).await })
    }
}

async fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let (host, port) = request.url.host_and_port();
    let targets = resolve(host, port).await?;
    // "Every interface" is no place to send to.
    let is_unspecific = |target: &SocketAddr| target.ip().is_unspecified();
    let is_listening = host.is_empty() || request.role == Role::Listen || targets.first().is_some_and(is_unspecific);
    let (socket, target) = if is_listening { bind_first(&targets)? } else { call_first(&targets)? };
    let local_address = socket.local_addr().unwrap_or(target);
    // The reactor learns that the socket takes data; without it the very first frame would wait for another wake-up.
    socket.writable().await.map_err(|source| OpenError::Io { what: local_address.to_string(), source })?;
    let granted_bytes = enlarge_receive_buffer(&socket);
    let idle = Span::from_millis(1_000 * i64::from(request.url.integer(&IDLE)));
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
        loud: Vec::new(),
        next_apart: Stamp::ZERO,
        peers: Peers::new((!is_listening).then_some(target), idle),
        queue: SendQueue::new(QUEUE_BYTES),
        meter: CapacityMeter::default(),
        inbox: Inbox::default(),
        was_idle: true,
        loss: None,
        buffer: vec![0; DATAGRAM_BYTES].into_boxed_slice(),
    }))
}

/// What was drained from the sockets and not delivered yet, peer by peer.
#[derive(Default)]
struct Inbox {
    by_peer: BTreeMap<PeerId, VecDeque<Incoming>>,
    /// The peer that was served last.
    turn: PeerId,
}

impl Inbox {
    fn push(&mut self, peer: PeerId, incoming: Incoming) {
        self.by_peer.entry(peer).or_default().push_back(incoming);
    }

    /// The oldest datagram of the next peer in turn.
    fn pop(&mut self) -> Option<Incoming> {
        let after = (Bound::Excluded(self.turn), Bound::Unbounded);
        let next = self.by_peer.range(after).next();
        let (peer, _) = next.or_else(|| self.by_peer.iter().next())?;
        self.turn = *peer;
        let queue = self.by_peer.get_mut(&self.turn)?;
        let incoming = queue.pop_front();
        if queue.is_empty() {
            self.by_peer.remove(&self.turn);
        }
        incoming
    }
}

/// A peer with a socket of its own.
struct Loud {
    address: SocketAddr,
    socket: UdpSocket,
    /// What it sent before lies in the common socket and has to be delivered first.
    is_next: bool,
}

struct UdpConnection {
    socket: UdpSocket,
    loud: Vec<Loud>,
    /// When a loud peer may be set apart again.
    next_apart: Stamp<HostClock>,
    local_address: SocketAddr,
    is_listening: bool,
    detail: String,
    timer: HostTimer,
    peers: Peers,
    queue: SendQueue<SocketAddr>,
    meter: CapacityMeter,
    inbox: Inbox,
    /// Nothing was to be had when it was last polled: what comes next is alone, mostly.
    was_idle: bool,
    /// Told when everything that arrived before has been delivered.
    loss: Option<io::Error>,
    buffer: Box<[u8]>,
}

/// Whether a socket is of further use.
#[derive(PartialEq, Eq)]
enum Usable {
    Yes,
    No,
}

impl UdpConnection {
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) {
        let mut taken = 0;
        while let Some((to, frame)) = self.queue.head() {
            let Poll::Ready(result) = self.socket.poll_send_to(cx, frame, *to) else {
                break;
            };
            taken += frame.len();
            count_sent(&result, counters);
            self.queue.drop_head();
        }
        self.measure(taken);
    }

    fn measure(&mut self, taken: usize) {
        self.meter.note_if_busy(|| self.timer.now(), taken, self.queue.backlog());
    }

    /// The first datagram after a pause. It goes past the inbox: whether there are others is asked when it has been answered.
    fn take_first(&mut self) -> Option<Incoming> {
        match self.socket.try_recv_from(&mut self.buffer) {
            Ok((length, from)) => self.incoming(length, from),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => None,
            Err(error) if is_about_one_peer(&error) => None,
            Err(error) => {
                self.loss = Some(error);
                None
            }
        }
    }

    /// Takes what the common socket holds, up to the limit.
    fn drain(&mut self) {
        for _ in 0..DRAIN_LIMIT {
            match self.socket.try_recv_from(&mut self.buffer) {
                Ok((length, from)) => {
                    self.deliver(length, from);
                    if self.peers.is_loud(from) {
                        self.set_apart(from);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    for loud in &mut self.loud {
                        loud.is_next = true;
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

    /// Gives a loud peer a socket of its own, if it has none and there is one to have.
    fn set_apart(&mut self, address: SocketAddr) {
        let has_one = self.loud.iter().any(|loud| loud.address == address);
        let now = self.timer.now();
        if has_one || self.loud.len() >= MAX_LOUD || now < self.next_apart {
            return;
        }
        match split_off(&self.socket, self.local_address, address) {
            Ok(socket) => {
                tracing::info!(peer = %address, at = %self.local_address, "a loud peer is read apart");
                self.loud.push(Loud { address, socket, is_next: false });
            }
            Err(error) => {
                self.next_apart = now + APART_PAUSE;
                tracing::debug!(peer = %address, %error, "a loud peer stays");
            }
        }
    }

    /// Takes a share of what the loud peers have sent; false, with a waker left at each, if there is nothing.
    fn drain_loud(&mut self, cx: &mut Context<'_>) -> bool {
        let mut loud = std::mem::take(&mut self.loud);
        let mut found = false;
        loud.retain(|one| {
            if one.is_next {
                match one.socket.poll_recv_ready(cx) {
                    Poll::Pending => {}
                    Poll::Ready(Err(_)) => return false,
                    Poll::Ready(Ok(())) => {
                        found = true;
                        if self.drain_one(&one.socket) == Usable::No {
                            return false;
                        }
                    }
                }
            }
            self.peers.knows(one.address)
        });
        // Nobody was set apart in the meantime: that happens in `drain` only.
        self.loud = loud;
        found
    }

    fn drain_one(&mut self, socket: &UdpSocket) -> Usable {
        for _ in 0..LOUD_DRAIN_LIMIT {
            match socket.try_recv_from(&mut self.buffer) {
                Ok((length, from)) => self.deliver(length, from),
                Err(error) if is_about_one_peer(&error) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Usable::Yes,
                // The common socket hears the peer again when this one is closed.
                Err(_) => return Usable::No,
            }
        }
        Usable::Yes
    }

    fn deliver(&mut self, length: usize, from: SocketAddr) {
        if let Some(incoming) = self.incoming(length, from)
            && let Incoming::Bytes { peer, .. } = incoming
        {
            self.inbox.push(peer, incoming);
        }
    }

    /// What lies in the buffer; `None` for an empty datagram, which makes a peer known and says nothing else.
    fn incoming(&mut self, length: usize, from: SocketAddr) -> Option<Incoming> {
        let arrival = self.timer.now();
        let peer = self.peers.heard(from, arrival);
        let bytes = self.buffer.get(..length).unwrap_or_default().to_vec();
        (!bytes.is_empty()).then_some(Incoming::Bytes { peer, arrival, bytes })
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

    fn send(&mut self, out: &Outgoing<'_>, counters: &mut PortCounters) {
        let frame = out.frame;
        let mut cx = Context::from_waker(Waker::noop());
        for to in self.peers.audience(out.to, self.timer.now()) {
            if !self.queue.is_empty() {
                counters.drops_out += self.queue.push(to, out.priority, frame);
                continue;
            }
            match self.socket.poll_send_to(&mut cx, frame, to) {
                Poll::Ready(result) => count_sent(&result, counters),
                Poll::Pending => counters.drops_out += self.queue.push(to, out.priority, frame),
            }
        }
        self.measure(0);
    }

    fn poll(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>> {
        self.flush(cx, counters);
        loop {
            if let Some(incoming) = self.inbox.pop() {
                return Poll::Ready(Ok(incoming));
            }
            if let Some(error) = self.loss.take() {
                return Poll::Ready(Err(error.into()));
            }
            let common = self.socket.poll_recv_ready(cx);
            match common {
                Poll::Ready(Ok(())) => {
                    if std::mem::take(&mut self.was_idle)
                        && let Some(first) = self.take_first()
                    {
                        return Poll::Ready(Ok(first));
                    }
                    self.drain();
                }
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error.into())),
                Poll::Pending => {}
            }
            if !self.drain_loud(cx) && common.is_pending() {
                self.was_idle = true;
                return Poll::Pending;
            }
        }
    }

    fn reach(&self, to: Audience) -> u32 {
        self.peers.reach(to, self.timer.now())
    }

    fn outstanding(&self, now: Stamp<HostClock>) -> Outstanding {
        Outstanding {
            peers: self.peers.reach(Audience::All, now),
            frames: self.queue.len() as u64,
            bytes: self.queue.bytes() as u64,
            capacity_bytes_per_s: self.meter.bytes_per_s(now),
        }
    }
}

/// A datagram that the system refuses concerns one peer or one moment, never the link.
fn count_sent(result: &io::Result<usize>, counters: &mut PortCounters) {
    match result {
        Ok(count) => counters.bytes_out += *count as u64,
        Err(_) => counters.drops_out += 1,
    }
}

/// Errors that earlier datagrams to a peer that is gone have left on the socket.
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
