//! The peers of a UDP socket: numbered in the order of first contact, forgotten after silence.
//!
//! Also detects peers that send too much. Time is an argument; no socket is used here.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use posebridge_telemetry::{HostClock, PeerId, Recipients, TimeDelta, Timestamp};

/// Most peers at a time; those silent for longest are dropped first. Guards against forged source addresses.
const MAX_PEERS: usize = 4096;
/// Over this time the datagrams of a peer are counted.
const BUSY_WINDOW: TimeDelta = TimeDelta::from_millis(100);
/// More datagrams than this within the window count as flooding: 5000 per second, ten times a brick that sends every sensor
/// at 100 Hz in a datagram of its own.
const BUSY_DATAGRAMS: u32 = 500;

pub(super) struct UdpPeerTable {
    idle: TimeDelta,
    by_address: BTreeMap<SocketAddr, UdpPeer>,
    by_id: BTreeMap<PeerId, SocketAddr>,
    next_id: u32,
}

struct UdpPeer {
    id: PeerId,
    window_start: Timestamp<HostClock>,
    window_datagrams: u32,
    /// `None` for the host that the link names, which is never forgotten.
    last_seen: Option<Timestamp<HostClock>>,
}

impl UdpPeerTable {
    /// Only the host that the URL names; others are forgotten after `idle` of silence.
    pub(super) fn new(named: Option<SocketAddr>, idle: TimeDelta) -> Self {
        let mut peers = Self { idle, by_address: BTreeMap::new(), by_id: BTreeMap::new(), next_id: 0 };
        if let Some(address) = named {
            peers.insert(address, None);
        }
        peers
    }

    fn insert(&mut self, address: SocketAddr, last_seen: Option<Timestamp<HostClock>>) -> PeerId {
        let id = PeerId(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        let peer = UdpPeer {
            id,
            window_start: last_seen.unwrap_or(Timestamp::ZERO),
            window_datagrams: u32::from(last_seen.is_some()),
            last_seen,
        };
        self.by_address.insert(address, peer);
        self.by_id.insert(id, address);
        id
    }

    pub(super) fn record_activity(&mut self, address: SocketAddr, now: Timestamp<HostClock>) -> PeerId {
        if let Some(peer) = self.by_address.get_mut(&address) {
            peer.count_datagram(now);
            let is_away = |last_seen: &Timestamp<HostClock>| now - *last_seen > self.idle;
            if !peer.last_seen.as_ref().is_some_and(is_away) {
                peer.last_seen = peer.last_seen.map(|_| now);
                return peer.id;
            }
            // Away for so long that what it sent before has no bearing on what it sends now.
            self.remove(address);
        } else if self.by_address.len() >= MAX_PEERS {
            self.evict_most_idle();
        }
        self.insert(address, Some(now))
    }

    /// True if `address` sends so much that it should not share a buffer with the others.
    pub(super) fn is_busy(&self, address: SocketAddr) -> bool {
        self.by_address.get(&address).is_some_and(|peer| peer.window_datagrams > BUSY_DATAGRAMS)
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
        }
    }

    /// Makes room by a quarter at a time, so that a flood of forged addresses does not cost a search per datagram.
    fn evict_most_idle(&mut self) {
        let mut by_silence: Vec<_> = self
            .by_address
            .iter()
            .filter_map(|(address, peer)| peer.last_seen.map(|last_seen| (last_seen, *address)))
            .collect();
        by_silence.sort_unstable();
        for (_, address) in by_silence.into_iter().take(MAX_PEERS / 4) {
            self.remove(address);
        }
    }

    pub(super) fn evict_idle(&mut self, now: Timestamp<HostClock>) {
        let (by_id, idle) = (&mut self.by_id, self.idle);
        self.by_address.retain(|_, peer| {
            let is_live = peer.last_seen.is_none_or(|last_seen| now - last_seen <= idle);
            if !is_live {
                by_id.remove(&peer.id);
            }
            is_live
        });
    }

    /// The number of current peers among the recipients.
    pub(super) fn count_recipients(&self, audience: Recipients, now: Timestamp<HostClock>) -> u32 {
        if let Recipients::Peer(id) = audience {
            return u32::from(self.by_id.contains_key(&id));
        }
        let is_live = |peer: &&UdpPeer| peer.last_seen.is_none_or(|last_seen| now - last_seen <= self.idle);
        let live = self.by_address.values().filter(is_live);
        live.filter(|peer| audience.includes(peer.id)).count() as u32
    }

    pub(super) fn recipient_addresses(&mut self, audience: Recipients, now: Timestamp<HostClock>) -> Vec<SocketAddr> {
        if let Recipients::Peer(id) = audience {
            return self.by_id.get(&id).copied().into_iter().collect();
        }
        self.evict_idle(now);
        self.by_address.iter().filter(|(_, peer)| audience.includes(peer.id)).map(|(address, _)| *address).collect()
    }
}

impl UdpPeer {
    fn count_datagram(&mut self, now: Timestamp<HostClock>) {
        if now - self.window_start >= BUSY_WINDOW {
            self.window_start = now;
            self.window_datagrams = 0;
        }
        self.window_datagrams = self.window_datagrams.saturating_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: TimeDelta = TimeDelta::from_millis(10_000);

    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([10, 0, 0, 1], port))
    }

    #[test]
    fn a_silent_peer_is_forgotten_and_comes_back_as_a_new_one() {
        let mut peers = UdpPeerTable::new(None, IDLE);
        let first = peers.record_activity(address(1), Timestamp::from_millis(0));
        let second = peers.record_activity(address(2), Timestamp::from_millis(6_000));
        assert_ne!(first, second);
        let now = Timestamp::from_millis(10_001);
        assert_eq!(peers.recipient_addresses(Recipients::All, now), [address(2)]);
        assert!(peers.recipient_addresses(Recipients::Peer(first), now).is_empty());
        assert_ne!(peers.record_activity(address(1), now), first);
        assert_eq!(peers.record_activity(address(2), now), second);
    }

    #[test]
    fn a_peer_that_was_away_for_long_is_new_even_without_eviction() {
        let mut peers = UdpPeerTable::new(None, IDLE);
        let first = peers.record_activity(address(1), Timestamp::ZERO);
        let still = peers.record_activity(address(1), Timestamp::from_millis(10_000));
        assert_eq!(first, still);
        let back = peers.record_activity(address(1), Timestamp::from_millis(20_001));
        assert_ne!(first, back);
    }

    #[test]
    fn the_named_host_is_never_forgotten() {
        let mut peers = UdpPeerTable::new(Some(address(1)), IDLE);
        let now = Timestamp::from_millis(3_600_000);
        assert_eq!(peers.recipient_addresses(Recipients::All, now), [address(1)]);
        assert_eq!(peers.record_activity(address(1), now), PeerId(0));
    }

    #[test]
    fn forged_addresses_do_not_grow_the_list_without_end() {
        let mut peers = UdpPeerTable::new(Some(address(0)), IDLE);
        for port in 1..=u16::MAX {
            peers.record_activity(address(port), Timestamp::from_millis(i64::from(port) / 10));
        }
        assert!((MAX_PEERS / 2..=MAX_PEERS).contains(&peers.by_address.len()));
        assert_eq!(peers.by_id.len(), peers.by_address.len());
        assert!(peers.by_address.contains_key(&address(0)));
        assert!(peers.by_address.contains_key(&address(u16::MAX)));
    }

    #[test]
    fn a_peer_is_loud_when_it_sends_more_than_a_brick_ever_does() {
        let mut peers = UdpPeerTable::new(None, IDLE);
        // 100 Hz and 5000 Hz are calm, 10 kHz is loud.
        for (port, period_micros, expected) in [(1, 10_000, false), (2, 200, false), (3, 100, true)] {
            let mut was_loud = false;
            for number in 0..5_000 {
                peers.record_activity(address(port), Timestamp::from_micros(number * period_micros));
                was_loud |= peers.is_busy(address(port));
            }
            assert_eq!(was_loud, expected, "every {period_micros} us");
        }
        assert!(!peers.is_busy(address(4)));
    }
}
