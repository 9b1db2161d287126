//! Senders with clocks of their own that are no robots: cameras, and bricks with nothing but thermometers.
//!
//! An observer is identified by the first link of its group and its address, and by its peer: behind one port may be
//! many cameras without a configured address. When its address appears at another peer of its link, it has reconnected,
//! or it is another observer with the same ids. It is another one if the old peer continues; it is the same if the old
//! peer has been silent for a while ([`HANDOVER`]), unless that comes back later. Until this is decided, the new peer's
//! timestamps are not used.

use std::collections::BTreeMap;

use posebridge_protocol::message::WireStamp;
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Address, BrickClock, CameraClock, HostClock, LinkId, PeerId, TimeDelta, Timestamp};

use crate::clock::align::{ClockAligner, ExchangeOutcome};
use crate::clock::unwrap::UnwrapOutcome;
use crate::fix_requests::FixRequests;
use crate::receive::{ReceiveInfo, TimeExchange};
use crate::sender_identity::{HANDOVER, addresses_at, contender_entry};

/// Most remembered observers; beyond it those that have been silent longest are forgotten, a quarter at a time.
const MAX_OBSERVERS: usize = 1_024;

/// Stands for a link where an observer is on none; no station has so many.
const OUTSIDE: LinkId = LinkId(u16::MAX);

/// Identifies an observer. The number of a forgotten one is not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ObserverId(u64);

/// The ids of an observer: the first link of its group and its address. Several may have the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ObserverAddress {
    pub(crate) home: LinkId,
    pub(crate) address: Address,
}

#[derive(Debug, Default)]
pub(crate) struct Observers {
    known: BTreeMap<ObserverAddress, Vec<Observer>>,
    count: usize,
    next_id: u64,
    /// When an undecided sender was first received.
    contenders: BTreeMap<(Endpoint, Address), Timestamp<HostClock>>,
    /// Another observer with known ids was found.
    has_found_namesake: bool,
    pub(crate) fix_requests: FixRequests,
}

#[derive(Debug)]
struct Observer {
    id: ObserverId,
    clock: ClockAligner<CameraClock>,
    /// Its peer on each link of its group.
    contacts: BTreeMap<LinkId, Contact>,
}

/// The peer of an observer on one link.
#[derive(Clone, Copy, Debug)]
struct Contact {
    peer: PeerId,
    last_seen: Timestamp<HostClock>,
    /// The peer that this one has replaced.
    former: Option<PeerId>,
}

enum ObserverIdentity<'a> {
    Known(&'a mut Observer),
    /// This one, or another one with the same ids.
    Contested(ObserverId),
}

/// The result for an observer's timestamp.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObserverTime<T> {
    /// `None` while that clock is not aligned or its identity is undecided, or for a timestamp from before a restart.
    pub(crate) time: Option<T>,
    pub(crate) has_restarted: bool,
    pub(crate) observer: ObserverId,
}

impl Observers {
    /// Whether another observer with known ids was found since the last call: it has not had a time request yet.
    pub(crate) const fn take_namesake(&mut self) -> bool {
        std::mem::replace(&mut self.has_found_namesake, false)
    }

    pub(crate) fn at_endpoint(&self, endpoint: Endpoint, sender: ObserverAddress) -> Option<ObserverId> {
        let observers = self.known.get(&sender)?;
        observers.iter().find(|observer| observer.is_at(endpoint)).map(|observer| observer.id)
    }

    /// Removes the clock of a sender that proves to be a robot.
    pub(crate) fn remove_clock(
        &mut self,
        sender: ObserverAddress,
        endpoint: Endpoint,
    ) -> Option<ClockAligner<CameraClock>> {
        let observers = self.known.get_mut(&sender)?;
        let index = index_of(observers, endpoint)?;
        self.count -= 1;
        let clock = observers.swap_remove(index).clock;
        if observers.is_empty() {
            self.known.remove(&sender);
        }
        Some(clock)
    }

    /// A duplicate from another link of the group adds a bound of the clock from that endpoint.
    pub(crate) fn observe_copy(&mut self, sender: ObserverAddress, received: ReceiveInfo, stamp: WireStamp) {
        if let Some(observers) = self.known.get_mut(&sender)
            && let Some(index) = index_of(observers, received.endpoint)
        {
            observers[index].clock.observe_copy(received.endpoint, stamp, received.host_time);
        }
    }

    /// Records a time request and its reply; `None` while the replying observer is undecided.
    pub(crate) fn observe_exchange(
        &mut self,
        sender: ObserverAddress,
        exchange: &TimeExchange,
    ) -> Option<ExchangeOutcome<CameraClock>> {
        let ReceiveInfo { endpoint, host_time } = exchange.answer;
        match self.identify(sender, exchange.answer) {
            ObserverIdentity::Known(observer) => {
                Some(observer.clock.observe_exchange(endpoint, exchange.sent, host_time, exchange.peer_nanos))
            }
            ObserverIdentity::Contested(_) => None,
        }
    }

    /// The number of a source that is not on any link.
    pub(crate) fn outside(&mut self, source: Address, now: Timestamp<HostClock>) -> ObserverId {
        let endpoint = Endpoint { link: OUTSIDE, peer: PeerId::default() };
        let sender = ObserverAddress { home: OUTSIDE, address: source };
        self.identify(sender, ReceiveInfo { endpoint, host_time: now }).id()
    }

    /// Whether the sender of a message is undecided.
    pub(crate) fn is_contested(&mut self, sender: ObserverAddress, received: ReceiveInfo) -> bool {
        matches!(self.identify(sender, received), ObserverIdentity::Contested(_))
    }

    /// The host's instant of an observer's timestamp, and its uncertainty either way.
    pub(crate) fn host_time(
        &mut self,
        sender: ObserverAddress,
        received: ReceiveInfo,
        stamp: WireStamp,
    ) -> ObserverTime<(Timestamp<HostClock>, TimeDelta)> {
        if let WireStamp::HostInterval { sent, answered } = stamp {
            let half = TimeDelta::from_nanos((answered - sent).as_nanos() / 2);
            let observer = self.identify(sender, received).id();
            // The host's own instants need no clock of a sender.
            return ObserverTime { time: Some((sent + half, half)), has_restarted: false, observer };
        }
        self.observe_arrival(sender, received, stamp, ClockAligner::host_at)
    }

    /// The instant of a timestamp on the clock of a brick that is no robot, or not yet. Nothing is converted with this
    /// clock.
    pub(crate) fn own_time(
        &mut self,
        sender: ObserverAddress,
        received: ReceiveInfo,
        stamp: WireStamp,
    ) -> ObserverTime<Timestamp<BrickClock>> {
        if matches!(stamp, WireStamp::HostInterval { .. }) {
            let observer = self.identify(sender, received).id();
            // Without a clock of its own its replies have no instants; with one it is a robot.
            return ObserverTime { time: None, has_restarted: false, observer };
        }
        self.observe_arrival(sender, received, stamp, |_, time| Some(Timestamp::from_nanos(time.as_nanos())))
    }

    /// The result of `convert` for an observer's timestamp that arrived.
    fn observe_arrival<T>(
        &mut self,
        sender: ObserverAddress,
        received: ReceiveInfo,
        stamp: WireStamp,
        convert: impl Fn(&ClockAligner<CameraClock>, Timestamp<CameraClock>) -> Option<T>,
    ) -> ObserverTime<T> {
        let Observer { id, clock, .. } = match self.identify(sender, received) {
            ObserverIdentity::Known(observer) => observer,
            ObserverIdentity::Contested(observer) => {
                return ObserverTime { time: None, has_restarted: false, observer };
            }
        };
        let outcome = clock.observe_arrival(received.endpoint, stamp, received.host_time);
        // A contradicted clock has no conversion, so that the caller reports it anyway.
        clock.take_contradiction();
        let time = match outcome {
            UnwrapOutcome::Continued(time) | UnwrapOutcome::Restarted(time) => convert(clock, time),
            UnwrapOutcome::Stale => None,
        };
        ObserverTime { time, has_restarted: matches!(outcome, UnwrapOutcome::Restarted(_)), observer: *id }
    }

    /// Records that a peer is another one than `others` of its link: so are the observers at it that have the ids of
    /// those at `others`. Returns the addresses that are distinguished by it.
    pub(crate) fn distinguish(&mut self, received: ReceiveInfo, home: LinkId, others: &[PeerId]) -> Vec<Address> {
        let endpoint = received.endpoint;
        let contenders = self.contenders.range(addresses_at(endpoint)).map(|((_, address), _)| *address);
        let is_other = |observer: &Observer| {
            observer.contacts.get(&endpoint.link).is_some_and(|contact| others.contains(&contact.peer))
        };
        let is_distinct = |address: &Address| {
            let known = self.known.get(&ObserverAddress { home, address: *address });
            known.is_some_and(|observers| observers.iter().all(is_other))
        };
        let addresses: Vec<Address> = contenders.filter(is_distinct).collect();
        for address in &addresses {
            let sender = ObserverAddress { home, address: *address };
            self.contenders.remove(&(endpoint, *address));
            self.has_found_namesake = true;
            let index = self.add(sender, received.host_time);
            let contact = Contact { peer: endpoint.peer, last_seen: received.host_time, former: None };
            if let Some(observer) = self.known.get_mut(&sender).and_then(|observers| observers.get_mut(index)) {
                observer.contacts.insert(endpoint.link, contact);
            }
        }
        addresses
    }

    /// Identifies the sender of a message; an unknown one becomes an observer.
    fn identify(&mut self, sender: ObserverAddress, received: ReceiveInfo) -> ObserverIdentity<'_> {
        let ReceiveInfo { endpoint, host_time } = received;
        let contender = (endpoint, sender.address);
        let observers = self.known.get(&sender).map_or(&[][..], Vec::as_slice);
        let known = index_of(observers, endpoint).or_else(|| {
            // On a redundant link the first that was not received there yet.
            observers.iter().position(|observer| !observer.contacts.contains_key(&endpoint.link))
        });
        let index = match known {
            Some(index) => index,
            None if observers.is_empty() => self.add(sender, host_time),
            None => match classify_peer(observers, endpoint, host_time, self.contenders.get(&contender).copied()) {
                PeerClass::SameAs(index) => index,
                PeerClass::Another => {
                    self.has_found_namesake = true;
                    self.add(sender, host_time)
                }
                PeerClass::Contested(id) => {
                    contender_entry(&mut self.contenders, contender).or_insert(host_time);
                    return ObserverIdentity::Contested(id);
                }
            },
        };
        if known.is_none() {
            self.contenders.remove(&contender);
        }
        let observer = &mut self.known.entry(sender).or_default()[index];
        let contact = Contact { peer: endpoint.peer, last_seen: host_time, former: None };
        let contact = observer.contacts.entry(endpoint.link).or_insert(contact);
        if contact.peer != endpoint.peer {
            contact.former = Some(contact.peer);
            contact.peer = endpoint.peer;
        }
        contact.last_seen = contact.last_seen.max(host_time);
        ObserverIdentity::Known(observer)
    }

    /// Adds an observer; returns its index among those with the same ids.
    fn add(&mut self, sender: ObserverAddress, now: Timestamp<HostClock>) -> usize {
        if self.count >= MAX_OBSERVERS {
            self.forget_silent(now);
        }
        let id = ObserverId(self.next_id);
        self.next_id += 1;
        self.count += 1;
        let observers = self.known.entry(sender).or_default();
        observers.push(Observer { id, clock: ClockAligner::default(), contacts: BTreeMap::new() });
        observers.len() - 1
    }

    fn forget_silent(&mut self, now: Timestamp<HostClock>) {
        let mut last_seen: Vec<_> = self.known.values().flatten().map(|observer| observer.last_seen(now)).collect();
        last_seen.sort_unstable();
        let Some(limit) = last_seen.get(MAX_OBSERVERS / 4).copied() else {
            return;
        };
        self.known.retain(|_, observers| {
            observers.retain(|observer| observer.last_seen(now) > limit);
            !observers.is_empty()
        });
        self.count = self.known.values().map(Vec::len).sum();
    }
}

impl Observer {
    fn is_at(&self, endpoint: Endpoint) -> bool {
        self.contacts.get(&endpoint.link).is_some_and(|contact| contact.peer == endpoint.peer)
    }

    fn last_seen(&self, now: Timestamp<HostClock>) -> Timestamp<HostClock> {
        self.contacts.values().map(|contact| contact.last_seen).max().unwrap_or(now)
    }
}

impl ObserverIdentity<'_> {
    const fn id(&self) -> ObserverId {
        match self {
            Self::Known(observer) => observer.id,
            Self::Contested(id) => *id,
        }
    }
}

/// The relation of a peer to the observers with its ids at another peer of its link.
enum PeerClass {
    /// This observer, which has reconnected.
    SameAs(usize),
    Another,
    /// Undecided; perhaps this observer.
    Contested(ObserverId),
}

/// Classifies a peer of a link where all observers with its ids are at other peers; `first` is when it was first received.
fn classify_peer(
    observers: &[Observer],
    endpoint: Endpoint,
    now: Timestamp<HostClock>,
    first: Option<Timestamp<HostClock>>,
) -> PeerClass {
    let contacts = observers.iter().enumerate();
    let contacts =
        contacts.filter_map(|(index, observer)| Some((index, observer.id, *observer.contacts.get(&endpoint.link)?)));
    let is_back = contacts.clone().any(|(_, _, contact)| contact.former == Some(endpoint.peer));
    // All observers with the ids have sent since it was first received.
    let is_distinct = first.is_some_and(|first| contacts.clone().all(|(_, _, contact)| contact.last_seen > first));
    let Some((index, id, contact)) = contacts.min_by_key(|(_, _, contact)| contact.last_seen) else {
        return PeerClass::Another;
    };
    if is_back || is_distinct {
        PeerClass::Another
    } else if now - contact.last_seen >= HANDOVER {
        PeerClass::SameAs(index)
    } else {
        PeerClass::Contested(id)
    }
}

/// The observer at an endpoint: at that peer, or, if there is only one, not yet on that link.
fn index_of(observers: &[Observer], endpoint: Endpoint) -> Option<usize> {
    observers.iter().position(|observer| observer.is_at(endpoint)).or_else(|| match observers {
        [only] if !only.contacts.contains_key(&endpoint.link) => Some(0),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: ObserverAddress = ObserverAddress { home: LinkId(0), address: Address::new(1, 100) };

    /// An observer's message at `millis`, by a peer, when its clock is so far ahead; which observer it was, if its clock was used.
    fn receive(observers: &mut Observers, millis: i64, endpoint: Endpoint, ahead_ms: i64) -> Option<ObserverId> {
        let received = ReceiveInfo { endpoint, host_time: Timestamp::from_millis(millis) };
        let stamp = WireStamp::Micros64(((millis + ahead_ms) * 1_000) as u64);
        let time = observers.host_time(CAMERA, received, stamp);
        assert!(!time.has_restarted, "{millis} ms");
        // A new clock is not aligned at its first timestamp.
        observers.known[&CAMERA].iter().any(|observer| is_received_now(observer, received)).then_some(time.observer)
    }

    fn is_received_now(observer: &Observer, received: ReceiveInfo) -> bool {
        let contact = observer.contacts.get(&received.endpoint.link);
        contact.is_some_and(|contact| (contact.peer, contact.last_seen) == (received.endpoint.peer, received.host_time))
    }

    fn by(link: u16, peer: u32) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(peer) }
    }

    #[test]
    fn cameras_with_the_same_ids_behind_one_port_have_clocks_of_their_own() {
        for period_ms in [50, 1_000] {
            let mut observers = Observers::default();
            for k in 0..10 {
                for peer in 0..3 {
                    receive(&mut observers, 5_000 + period_ms * k + 13 * peer, by(0, peer as u32), 100_000 * peer);
                }
            }
            let ids = [0, 1, 2].map(|peer| {
                receive(&mut observers, 30_000 + peer, by(0, peer as u32), 100_000 * peer).expect("it is known").0
            });
            assert!(ids[0] != ids[1] && ids[1] != ids[2] && ids[0] != ids[2], "{ids:?} each {period_ms} ms");
        }
    }

    #[test]
    fn a_camera_that_reconnects_or_uses_a_redundant_link_keeps_its_clock() {
        let mut observers = Observers::default();
        let first = receive(&mut observers, 0, by(0, 4), 70).expect("it is the first");
        assert_eq!(receive(&mut observers, 10, by(1, 0), 70), Some(first), "a redundant link");
        assert_eq!(receive(&mut observers, 100, by(0, 5), 70), None, "the old peer may go on");
        assert_eq!(receive(&mut observers, 300, by(0, 5), 70), Some(first), "it has not");
        assert_eq!(receive(&mut observers, 320, by(0, 5), 70), Some(first));
        assert_eq!(observers.count, 1);
    }

    #[test]
    fn invented_observers_are_bounded_and_the_latest_stay() {
        let mut observers = Observers::default();
        for number in 0..10_000_u32 {
            let address = Address::new((number / 250) as u8, (number % 250) as u8);
            let sender = ObserverAddress { home: LinkId(0), address };
            let received = ReceiveInfo { endpoint: by(0, number), host_time: Timestamp::from_millis(number.into()) };
            observers.host_time(sender, received, WireStamp::Millis32(number));
            assert!(observers.count <= MAX_OBSERVERS && observers.known.contains_key(&sender));
        }
    }
}
