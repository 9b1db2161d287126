//! UDP: listens on a port and answers whom it hears, or sends to a host first.
//!
//! One socket, many peers. A peer that has been silent for ten seconds is forgotten, except the host that the link
//! names. The system's default receive buffer holds 256 small datagrams, five milliseconds of a large class, so it is
//! enlarged and what was really granted is told. Errors that one unreachable peer causes are not a loss of the link.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::net::{Ipv6Addr, SocketAddr};
use std::task::{Context, Poll, Waker, ready};

use posebridge_telemetry::{Audience, HostClock, PeerId, Span, Stamp};
use socket2::SockRef;
use tokio::net::UdpSocket;

use crate::connection::{Connection, Incoming, Outgoing, PortCounters};
use crate::error::{LinkLoss, OpenError};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::transports::{
    OpenFuture, OpenRequest, QUEUE_BYTES, Role, Transport, bind_error, resolve, with_deadline,
};
use crate::url::TargetKind;

/// Receive buffer that is asked for. Linux doubles it and charges 832 bytes for a small datagram (its default of 212 992
/// bytes was measured to hold 256), so this holds 10 000 of them: a fifth of a second of 1000 robots at 50 Hz.
pub const RECEIVE_BUFFER_BYTES: usize = 4 * 1024 * 1024;
/// Datagrams taken from the socket per wake-up, so that one flooded port cannot starve the others.
const DRAIN_LIMIT: usize = 64;
/// Silence after which a peer is forgotten.
const PEER_IDLE: Span = Span::from_millis(10_000);
/// Most peers at a time; the most silent go first. Guards against forged source addresses.
const MAX_PEERS: usize = 4096;
/// Largest UDP datagram.
const DATAGRAM_BYTES: usize = 65_535;

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
    fn is_datagram(&self) -> bool {
        true
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(async move { with_deadline(&request.url, open(&request)).await })
    }
}

async fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let (host, port) = request.url.host_and_port();
    let target = resolve(host, port).await?.into_iter().next();
    let target = target.unwrap_or_else(|| SocketAddr::from(([0, 0, 0, 0], port)));
    let is_listening = host.is_empty() || request.role == Role::Listen;
    let local = if is_listening {
        target
    } else if target.is_ipv6() {
        SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0))
    } else {
        SocketAddr::from(([0, 0, 0, 0], 0))
    };
    let socket = UdpSocket::bind(local)
        .await
        .map_err(|error| bind_error(local, error))?;
    // The reactor learns that the socket takes data; without it the very first frame would wait for another wake-up.
    socket.writable().await.map_err(|source| OpenError::Io {
        what: local.to_string(),
        source,
    })?;
    let granted_bytes = enlarge_receive_buffer(&socket);
    let local_address = socket.local_addr().unwrap_or(local);
    let mut detail = if is_listening {
        format!("listening on {local_address}")
    } else {
        format!("sending to {target} from {local_address}")
    };
    if let Some(warning) = buffer_warning(granted_bytes) {
        detail.push_str(&warning);
    }
    Ok(Box::new(UdpConnection {
        socket,
        local_address,
        detail,
        timer: request.timer,
        peers: Peers::new((!is_listening).then_some(target)),
        queue: SendQueue::new(QUEUE_BYTES),
        arrived: VecDeque::with_capacity(DRAIN_LIMIT),
        loss: None,
        buffer: vec![0; DATAGRAM_BYTES].into_boxed_slice(),
    }))
}

/// Asks for a large receive buffer and returns how many bytes were granted.
fn enlarge_receive_buffer(socket: &UdpSocket) -> usize {
    let socket = SockRef::from(socket);
    // A refusal shows in what is granted, which is what counts.
    let asked = socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES);
    let doubled = socket.recv_buffer_size().unwrap_or(0);
    tracing::debug!(?asked, doubled, "receive buffer");
    // Linux doubles the size for its own bookkeeping and reports the double: socket(7), SO_RCVBUF.
    doubled / 2
}

fn buffer_warning(granted_bytes: usize) -> Option<String> {
    (granted_bytes < RECEIVE_BUFFER_BYTES).then(|| {
        format!(
            ", receive buffer only {granted_bytes} of {RECEIVE_BUFFER_BYTES} bytes: \
             run `sudo sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` for many robots"
        )
    })
}

/// Who is at the other ends.
struct Peers {
    by_address: BTreeMap<SocketAddr, Peer>,
    by_id: BTreeMap<PeerId, SocketAddr>,
    next_id: u32,
}

struct Peer {
    id: PeerId,
    /// `None` for the host that the link names, which is never forgotten.
    last_heard: Option<Stamp<HostClock>>,
}

impl Peers {
    fn new(named: Option<SocketAddr>) -> Self {
        let mut peers = Self {
            by_address: BTreeMap::new(),
            by_id: BTreeMap::new(),
            next_id: 0,
        };
        if let Some(address) = named {
            peers.insert(address, None);
        }
        peers
    }

    fn insert(&mut self, address: SocketAddr, last_heard: Option<Stamp<HostClock>>) -> PeerId {
        let id = PeerId(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        self.by_address.insert(address, Peer { id, last_heard });
        self.by_id.insert(id, address);
        id
    }

    /// Notes that `address` was heard.
    fn heard(&mut self, address: SocketAddr, now: Stamp<HostClock>) -> PeerId {
        if let Some(peer) = self.by_address.get_mut(&address) {
            match &mut peer.last_heard {
                Some(last_heard) if now - *last_heard <= PEER_IDLE => *last_heard = now,
                None => {}
                Some(_) => {
                    // Away for so long that what it sent before has no bearing on what it sends now.
                    self.remove(address);
                    return self.insert(address, Some(now));
                }
            }
            return self
                .by_address
                .get(&address)
                .map_or(PeerId(0), |peer| peer.id);
        }
        if self.by_address.len() >= MAX_PEERS {
            self.forget_most_silent();
        }
        self.insert(address, Some(now))
    }

    fn remove(&mut self, address: SocketAddr) {
        if let Some(peer) = self.by_address.remove(&address) {
            self.by_id.remove(&peer.id);
        }
    }

    /// Makes room by a quarter at a time, so that a flood of forged addresses does not cost a search per datagram.
    fn forget_most_silent(&mut self) {
        let mut by_silence: Vec<_> = self
            .by_address
            .iter()
            .filter_map(|(address, peer)| peer.last_heard.map(|heard| (heard, *address)))
            .collect();
        by_silence.sort_unstable();
        for (_, address) in by_silence.into_iter().take(MAX_PEERS / 4) {
            self.remove(address);
        }
    }

    fn forget_idle(&mut self, now: Stamp<HostClock>) {
        let by_id = &mut self.by_id;
        self.by_address.retain(|_, peer| {
            let is_live = peer.last_heard.is_none_or(|heard| now - heard <= PEER_IDLE);
            if !is_live {
                by_id.remove(&peer.id);
            }
            is_live
        });
    }

    /// The addresses of those who are to hear a frame.
    fn audience(&mut self, audience: Audience, now: Stamp<HostClock>) -> Vec<SocketAddr> {
        if let Audience::Peer(id) = audience {
            return self.by_id.get(&id).copied().into_iter().collect();
        }
        self.forget_idle(now);
        self.by_address
            .iter()
            .filter(|(_, peer)| audience.includes(peer.id))
            .map(|(address, _)| *address)
            .collect()
    }
}

struct UdpConnection {
    socket: UdpSocket,
    local_address: SocketAddr,
    detail: String,
    timer: HostTimer,
    peers: Peers,
    queue: SendQueue<SocketAddr>,
    /// Drained from the socket, not yet delivered.
    arrived: VecDeque<Incoming>,
    /// Told when everything that arrived before has been delivered.
    loss: Option<io::Error>,
    buffer: Box<[u8]>,
}

impl UdpConnection {
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) {
        while let Some((to, frame)) = self.queue.head() {
            match self.socket.poll_send_to(cx, frame, *to) {
                Poll::Pending => return,
                Poll::Ready(result) => count_sent(&result, counters),
            }
            self.queue.drop_head();
        }
    }

    /// Takes what the socket holds, up to the limit.
    fn drain(&mut self) {
        for _ in 0..DRAIN_LIMIT {
            match self.socket.try_recv_from(&mut self.buffer) {
                Ok((length, from)) => self.deliver(length, from),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
                Err(error) if is_about_one_peer(&error) => {}
                Err(error) => {
                    self.loss = Some(error);
                    return;
                }
            }
        }
    }

    fn deliver(&mut self, length: usize, from: SocketAddr) {
        let arrival = self.timer.now();
        let peer = self.peers.heard(from, arrival);
        let bytes = self.buffer.get(..length).unwrap_or_default().to_vec();
        // An empty datagram makes a peer known and says nothing else.
        if !bytes.is_empty() {
            self.arrived.push_back(Incoming::Bytes {
                peer,
                arrival,
                bytes,
            });
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

    fn send(&mut self, out: &Outgoing<'_>, counters: &mut PortCounters) {
        let frame = out.frame;
        let mut cx = Context::from_waker(Waker::noop());
        for to in self.peers.audience(out.to, self.timer.now()) {
            if !self.queue.is_empty() {
                counters.drops_out += self.queue.push(to, frame);
                continue;
            }
            match self.socket.poll_send_to(&mut cx, frame, to) {
                Poll::Ready(result) => count_sent(&result, counters),
                Poll::Pending => counters.drops_out += self.queue.push(to, frame),
            }
        }
    }

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut PortCounters,
    ) -> Poll<Result<Incoming, LinkLoss>> {
        self.flush(cx, counters);
        loop {
            if let Some(incoming) = self.arrived.pop_front() {
                return Poll::Ready(Ok(incoming));
            }
            if let Some(error) = self.loss.take() {
                return Poll::Ready(Err(error.into()));
            }
            match ready!(self.socket.poll_recv_ready(cx)) {
                Ok(()) => self.drain(),
                Err(error) => return Poll::Ready(Err(error.into())),
            }
        }
    }

    fn unsent_frames(&self) -> u64 {
        self.queue.len() as u64
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

#[cfg(test)]
mod tests {
    use super::*;

    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([10, 0, 0, 1], port))
    }

    #[test]
    fn a_silent_peer_is_forgotten_and_comes_back_as_a_new_one() {
        let mut peers = Peers::new(None);
        let first = peers.heard(address(1), Stamp::from_millis(0));
        let second = peers.heard(address(2), Stamp::from_millis(6_000));
        assert_ne!(first, second);
        let now = Stamp::from_millis(10_001);
        assert_eq!(peers.audience(Audience::All, now), [address(2)]);
        assert!(peers.audience(Audience::Peer(first), now).is_empty());
        assert_ne!(peers.heard(address(1), now), first);
        assert_eq!(peers.heard(address(2), now), second);
    }

    #[test]
    fn the_named_host_is_never_forgotten() {
        let mut peers = Peers::new(Some(address(1)));
        let now = Stamp::from_millis(3_600_000);
        assert_eq!(peers.audience(Audience::All, now), [address(1)]);
        assert_eq!(peers.heard(address(1), now), PeerId(0));
    }

    #[test]
    fn forged_addresses_do_not_grow_the_list_without_end() {
        let mut peers = Peers::new(Some(address(0)));
        for port in 1..=u16::MAX {
            peers.heard(address(port), Stamp::from_millis(i64::from(port) / 10));
        }
        assert!((MAX_PEERS / 2..=MAX_PEERS).contains(&peers.by_address.len()));
        assert_eq!(peers.by_id.len(), peers.by_address.len());
        assert!(peers.by_address.contains_key(&address(0)));
        assert!(peers.by_address.contains_key(&address(u16::MAX)));
    }

    #[test]
    fn a_small_receive_buffer_is_told_with_its_cure() {
        assert_eq!(buffer_warning(RECEIVE_BUFFER_BYTES), None);
        let warning = buffer_warning(212_992).expect("it is too small");
        assert!(warning.contains("212992 of 4194304 bytes"), "{warning}");
        assert!(warning.contains("net.core.rmem_max=4194304"), "{warning}");
    }
}
