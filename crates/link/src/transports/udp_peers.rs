//! The peers of a UDP socket: numbered in the order of first contact, forgotten after silence.
//!
//! Each has a budget of its own. One that was never understood, a stranger, has a small one and is the first to be forgotten;
//! one that sends more than a robot does is loud, and shares what loud peers may cost. Time is an argument; no socket is used
//! here.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use posebridge_telemetry::{HostClock, PeerId, Recipients, TimeDelta, Timestamp};

use crate::transports::open_request::FirstContact;

/// Most peers at a time; strangers are dropped first, then those silent for longest. Guards against forged source addresses.
const MAX_PEERS: usize = 4096;
/// Most strangers that get what is sent to all: a program that only listens is one of them.
const MAX_SERVED_STRANGERS: usize = 64;
/// What a datagram costs its sender besides its bytes, for the work that is the same for all.
const DATAGRAM_COST: i64 = 200;
/// Four times a brick that sends every sensor at 100 Hz in a datagram of its own: 2000 of 50 bytes.
const CALM_BYTES_PER_S: i64 = 500_000;
/// All loud peers together: 16 000 datagrams of 50 bytes, a tenth of what one core handles. A relay of hundreds of robots alone has it
/// all.
const LOUD_BYTES_PER_S: i64 = 4_000_000;
/// 100 datagrams of 50 bytes.
const STRANGER_BYTES_PER_S: i64 = 25_000;
/// What a peer may send at once, as a part of a second: a robot's backlog after its Wi-Fi was away.
const BURST: TimeDelta = TimeDelta::from_millis(250);
const NANOS_PER_SEC: i64 = 1_000_000_000;

pub(super) struct UdpPeerTable {
    idle: TimeDelta,
    first_contact: FirstContact,
    by_address: BTreeMap<SocketAddr, UdpPeer>,
    by_id: BTreeMap<PeerId, SocketAddr>,
    next_id: u32,
    loud_count: i64,
    /// What strangers share beyond their own budgets.
    strangers: Budget,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PeerStanding {
    /// Nothing that it sent was understood.
    Stranger,
    Calm,
    /// It was understood, and its budget was used up.
    Loud,
}

struct UdpPeer {
    id: PeerId,
    standing: PeerStanding,
    own: Budget,
    /// Its part of what all loud peers share; used while it is loud.
    loud: Budget,
    /// `None` for the host that the link names, which is never forgotten.
    last_seen: Option<Timestamp<HostClock>>,
}

const CALM_BURST_BYTES: i64 = burst(CALM_BYTES_PER_S);
/// All strangers together, beyond their own: one may be a robot that was forgotten while its Wi-Fi was away, with its backlog.
const STRANGERS_BYTES_PER_S: i64 = 125_000;
const STRANGERS_BURST_BYTES: i64 = 125_000;

/// A token bucket.
struct Budget {
    left_bytes: i64,
    refilled: Timestamp<HostClock>,
}

impl Budget {
    const fn full(bytes: i64, now: Timestamp<HostClock>) -> Self {
        Self { left_bytes: bytes, refilled: now }
    }

    /// Adds what has flowed in, up to `most_bytes`.
    fn refill(&mut self, bytes_per_s: i64, most_bytes: i64, now: Timestamp<HostClock>) {
        let elapsed = (now - self.refilled).as_nanos().clamp(0, NANOS_PER_SEC);
        let flow = elapsed * bytes_per_s;
        self.left_bytes = (self.left_bytes + flow / NANOS_PER_SEC).min(most_bytes);
        // The rest of a byte counts the next time.
        self.refilled = now - TimeDelta::from_nanos(flow % NANOS_PER_SEC / bytes_per_s);
    }
}

const fn burst(bytes_per_s: i64) -> i64 {
    bytes_per_s * BURST.as_nanos() / NANOS_PER_SEC
}

impl UdpPeerTable {
    /// Only the host that the URL names; others are forgotten after `idle` of silence.
    pub(super) fn new(named: Option<SocketAddr>, idle: TimeDelta, first_contact: FirstContact) -> Self {
        let mut peers = Self {
            idle,
            first_contact,
            by_address: BTreeMap::new(),
            by_id: BTreeMap::new(),
            next_id: 0,
            loud_count: 0,
            strangers: Budget::full(STRANGERS_BURST_BYTES, Timestamp::ZERO),
        };
        if let Some(address) = named {
            peers.insert(address, PeerStanding::Calm, None);
        }
        peers
    }

    fn insert(&mut self, address: SocketAddr, standing: PeerStanding, last_seen: Option<Timestamp<HostClock>>) {
        let id = PeerId(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        let now = last_seen.unwrap_or(Timestamp::ZERO);
        let own = Budget::full(burst(own_bytes_per_s(standing)), now);
        self.by_address.insert(address, UdpPeer { id, standing, own, loud: Budget::full(0, now), last_seen });
        self.by_id.insert(id, address);
    }

    /// Charges a peer for a datagram, and makes an unknown one known; `None` if its budget is used up.
    pub(super) fn receive(
        &mut self,
        address: SocketAddr,
        length: usize,
        now: Timestamp<HostClock>,
    ) -> Option<(PeerId, PeerStanding)> {
        match self.by_address.get_mut(&address) {
            Some(peer) if peer.last_seen.is_none_or(|last_seen| now - last_seen <= self.idle) => {
                peer.last_seen = peer.last_seen.map(|_| now);
            }
            known => {
                // One that was away for so long that what it sent before has no bearing on what it sends now is new.
                if known.is_some() {
                    self.remove(address);
                } else if self.by_address.len() >= MAX_PEERS {
                    self.evict();
                }
                let standing = match self.first_contact {
                    FirstContact::Stranger => PeerStanding::Stranger,
                    FirstContact::Admitted => PeerStanding::Calm,
                };
                self.insert(address, standing, Some(now));
            }
        }
        if !self.has_budget(address, now) {
            return None;
        }
        let peer = self.by_address.get_mut(&address)?;
        let cost = length as i64 + DATAGRAM_COST;
        if peer.standing == PeerStanding::Stranger && peer.own.left_bytes <= 0 {
            self.strangers.left_bytes -= cost;
            return Some((peer.id, peer.standing));
        }
        peer.own.left_bytes = (peer.own.left_bytes - cost).max(-CALM_BURST_BYTES);
        peer.loud.left_bytes -= cost;
        Some((peer.id, peer.standing))
    }

    /// Whether a peer may send now. One that has used up its own budget is loud until it has sent less for a while.
    pub(super) fn has_budget(&mut self, address: SocketAddr, now: Timestamp<HostClock>) -> bool {
        let Some(peer) = self.by_address.get_mut(&address) else {
            return true;
        };
        let own_bytes_per_s = own_bytes_per_s(peer.standing);
        peer.own.refill(own_bytes_per_s, burst(own_bytes_per_s), now);
        match peer.standing {
            PeerStanding::Stranger => {
                self.strangers.refill(STRANGERS_BYTES_PER_S, STRANGERS_BURST_BYTES, now);
                peer.own.left_bytes > 0 || self.strangers.left_bytes > 0
            }
            PeerStanding::Calm => {
                if peer.own.left_bytes <= 0 {
                    peer.standing = PeerStanding::Loud;
                    self.loud_count += 1;
                    peer.loud = Budget::full(burst(LOUD_BYTES_PER_S / self.loud_count), now);
                }
                true
            }
            PeerStanding::Loud if peer.own.left_bytes >= CALM_BURST_BYTES => {
                peer.standing = PeerStanding::Calm;
                self.loud_count -= 1;
                true
            }
            PeerStanding::Loud => {
                let share = LOUD_BYTES_PER_S / self.loud_count.max(1);
                peer.loud.refill(share, burst(share), now);
                let is_left = peer.loud.left_bytes > 0;
                if !is_left {
                    // What is cut counts, too: else it would seem calm.
                    peer.own.left_bytes = -CALM_BURST_BYTES;
                }
                is_left
            }
        }
    }

    /// Something that a peer sent was understood.
    pub(super) fn admit(&mut self, id: PeerId) {
        if let Some(peer) = self.by_id.get(&id).and_then(|address| self.by_address.get_mut(address))
            && peer.standing == PeerStanding::Stranger
        {
            peer.standing = PeerStanding::Calm;
            peer.own.left_bytes = CALM_BURST_BYTES;
        }
    }

    pub(super) fn address_of(&self, peer: PeerId) -> Option<SocketAddr> {
        self.by_id.get(&peer).copied()
    }

    /// True if `address` has not been forgotten.
    pub(super) fn contains(&self, address: SocketAddr) -> bool {
        self.by_address.contains_key(&address)
    }

    fn remove(&mut self, address: SocketAddr) {
        if let Some(peer) = self.by_address.remove(&address) {
            self.by_id.remove(&peer.id);
            self.loud_count -= i64::from(peer.standing == PeerStanding::Loud);
        }
    }

    /// Makes room for some at a time, so that a flood of forged addresses does not cost a search per datagram.
    fn evict(&mut self) {
        let is_admitted = |peer: &UdpPeer| peer.standing != PeerStanding::Stranger;
        let mut by_silence: Vec<_> = self
            .by_address
            .iter()
            .filter_map(|(address, peer)| Some((is_admitted(peer), peer.last_seen?, *address)))
            .collect();
        by_silence.sort_unstable();
        // No admitted one goes while there are more than a few strangers.
        let strangers = by_silence.partition_point(|(is_admitted, ..)| !is_admitted);
        let count = strangers.clamp(MAX_PEERS / 64, MAX_PEERS / 4);
        for (.., address) in by_silence.into_iter().take(count) {
            self.remove(address);
        }
    }

    pub(super) fn evict_idle(&mut self, now: Timestamp<HostClock>) {
        let idle = self.idle;
        let is_gone = |peer: &UdpPeer| peer.last_seen.is_some_and(|last_seen| now - last_seen > idle);
        let gone: Vec<_> =
            self.by_address.iter().filter(|(_, peer)| is_gone(peer)).map(|(address, _)| *address).collect();
        for address in gone {
            self.remove(address);
        }
    }

    /// The number of current peers among the recipients.
    pub(super) fn count_recipients(&self, audience: Recipients, now: Timestamp<HostClock>) -> u32 {
        if let Recipients::Peer(id) = audience {
            return u32::from(self.by_id.contains_key(&id));
        }
        self.recipients(audience, now).count() as u32
    }

    pub(super) fn recipient_addresses(&mut self, audience: Recipients, now: Timestamp<HostClock>) -> Vec<SocketAddr> {
        if let Recipients::Peer(id) = audience {
            return self.by_id.get(&id).copied().into_iter().collect();
        }
        self.evict_idle(now);
        self.recipients(audience, now).collect()
    }

    /// All that are admitted, and some strangers.
    fn recipients(&self, audience: Recipients, now: Timestamp<HostClock>) -> impl Iterator<Item = SocketAddr> {
        let is_live = move |peer: &UdpPeer| peer.last_seen.is_none_or(|last_seen| now - last_seen <= self.idle);
        let mut strangers = 0;
        let live = self.by_address.iter().filter(move |(_, peer)| is_live(peer) && audience.includes(peer.id));
        let served = live.filter(move |(_, peer)| {
            strangers += usize::from(peer.standing == PeerStanding::Stranger);
            peer.standing != PeerStanding::Stranger || strangers <= MAX_SERVED_STRANGERS
        });
        served.map(|(address, _)| *address)
    }
}

const fn own_bytes_per_s(standing: PeerStanding) -> i64 {
    match standing {
        PeerStanding::Stranger => STRANGER_BYTES_PER_S,
        PeerStanding::Calm | PeerStanding::Loud => CALM_BYTES_PER_S,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: TimeDelta = TimeDelta::from_millis(10_000);

    fn table() -> UdpPeerTable {
        UdpPeerTable::new(None, IDLE, FirstContact::Stranger)
    }

    fn receive(peers: &mut UdpPeerTable, address: SocketAddr, now: Timestamp<HostClock>) -> PeerId {
        peers.receive(address, 1, now).expect("within its budget").0
    }

    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([10, 0, 0, 1], port))
    }

    #[test]
    fn a_silent_peer_is_forgotten_and_comes_back_as_a_new_one() {
        let mut peers = table();
        let first = receive(&mut peers, address(1), Timestamp::from_millis(0));
        let second = receive(&mut peers, address(2), Timestamp::from_millis(6_000));
        assert_ne!(first, second);
        let now = Timestamp::from_millis(10_001);
        assert_eq!(peers.recipient_addresses(Recipients::All, now), [address(2)]);
        assert!(peers.recipient_addresses(Recipients::Peer(first), now).is_empty());
        assert_ne!(receive(&mut peers, address(1), now), first);
        assert_eq!(receive(&mut peers, address(2), now), second);
    }

    #[test]
    fn a_peer_that_was_away_for_long_is_new_even_without_eviction() {
        let mut peers = table();
        let first = receive(&mut peers, address(1), Timestamp::ZERO);
        let still = receive(&mut peers, address(1), Timestamp::from_millis(10_000));
        assert_eq!(first, still);
        let back = receive(&mut peers, address(1), Timestamp::from_millis(20_001));
        assert_ne!(first, back);
    }

    #[test]
    fn the_named_host_is_never_forgotten() {
        let mut peers = UdpPeerTable::new(Some(address(1)), IDLE, FirstContact::Stranger);
        let now = Timestamp::from_millis(3_600_000);
        assert_eq!(peers.recipient_addresses(Recipients::All, now), [address(1)]);
        assert_eq!(receive(&mut peers, address(1), now), PeerId(0));
    }

    #[test]
    fn forged_addresses_do_not_grow_the_list_without_end() {
        let mut peers = UdpPeerTable::new(Some(address(0)), IDLE, FirstContact::Stranger);
        for port in 1..=u16::MAX {
            receive(&mut peers, address(port), Timestamp::from_millis(i64::from(port) / 10));
        }
        assert!((MAX_PEERS / 2..=MAX_PEERS).contains(&peers.by_address.len()));
        assert_eq!(peers.by_id.len(), peers.by_address.len());
        assert!(peers.by_address.contains_key(&address(0)));
        assert!(peers.by_address.contains_key(&address(u16::MAX)));
    }

    #[test]
    fn strangers_make_room_and_get_little_of_what_is_sent_to_all() {
        let mut peers = table();
        let robot = receive(&mut peers, address(1), Timestamp::ZERO);
        peers.admit(robot);
        // Each of the others was heard later than the robot.
        for port in 2..=u16::MAX {
            receive(&mut peers, address(port), Timestamp::from_millis(1));
        }
        assert_eq!(peers.address_of(robot), Some(address(1)));
        let recipients = peers.recipient_addresses(Recipients::All, Timestamp::from_millis(1));
        assert_eq!(recipients.len(), 1 + MAX_SERVED_STRANGERS);
        assert!(recipients.contains(&address(1)));
        assert_eq!(peers.count_recipients(Recipients::All, Timestamp::from_millis(1)), 65);
    }

    #[test]
    fn a_table_of_robots_makes_room_for_the_next() {
        let mut peers = table();
        for port in 0..=MAX_PEERS as u16 {
            let robot = receive(&mut peers, address(port), Timestamp::from_micros(port.into()));
            peers.admit(robot);
        }
        assert_eq!(peers.by_address.len(), MAX_PEERS - MAX_PEERS / 64 + 1);
        assert!(!peers.contains(address(0)) && peers.contains(address(MAX_PEERS as u16)));
    }

    /// How many datagrams of 50 bytes each of some peers gets through in ten seconds, and its standing in the end.
    fn delivered(peers: &mut UdpPeerTable, ports: &[u16], per_second: i64) -> Vec<(usize, Option<PeerStanding>)> {
        let mut counts = vec![(0, None); ports.len()];
        for number in 0..10 * per_second {
            let now = Timestamp::from_nanos(number * NANOS_PER_SEC / per_second);
            for (port, (count, standing)) in ports.iter().zip(&mut counts) {
                if let Some((_, now)) = peers.receive(address(*port), 50, now) {
                    *count += 1;
                    *standing = Some(now);
                }
            }
        }
        counts
    }

    #[test]
    fn each_peer_has_its_budget_and_the_loud_ones_share_theirs() {
        let robots = || UdpPeerTable::new(None, IDLE, FirstContact::Admitted);
        // What no brick sends, and a relay of many robots alone.
        assert_eq!(delivered(&mut robots(), &[1], 1_900), [(19_000, Some(PeerStanding::Calm))]);
        assert_eq!(delivered(&mut robots(), &[1], 15_000), [(150_000, Some(PeerStanding::Loud))]);
        // Four loud ones get a quarter of 16 000 a second each, besides what each may send at once.
        for (count, standing) in delivered(&mut robots(), &[1, 2, 3, 4], 10_000) {
            assert!((40_000..46_000).contains(&count), "{count}");
            assert_eq!(standing, Some(PeerStanding::Loud));
        }
        // Strangers get a hundred a second each, and together five hundred more at once and a second.
        let strangers = delivered(&mut table(), &[1, 2], 10_000);
        let total: usize = strangers.iter().map(|(count, _)| count).sum();
        assert!((7_500..7_600).contains(&total), "{total}");
        assert!(strangers.iter().all(|(count, standing)| *count > 1_000 && *standing == Some(PeerStanding::Stranger)));
    }

    #[test]
    fn a_loud_peer_that_sends_less_for_a_while_is_calm_again() {
        let mut peers = UdpPeerTable::new(None, IDLE, FirstContact::Admitted);
        delivered(&mut peers, &[1, 2], 20_000);
        assert_eq!(peers.loud_count, 2);
        for millis in 0..1_000 {
            receive(&mut peers, address(1), Timestamp::from_millis(11_000 + millis));
        }
        assert_eq!(peers.loud_count, 1);
        peers.evict_idle(Timestamp::from_millis(100_000));
        assert_eq!(peers.loud_count, 0);
    }
}
