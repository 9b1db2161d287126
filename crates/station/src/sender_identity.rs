//! Which robot a sender is, also when several robots have the same ids.
//!
//! A robot is known by link and address, and by the peer that it was heard from. When its address is heard from another peer of its
//! link, or on another link, there are three explanations, which are told apart by what follows:
//!
//! - it reconnected: the old peer is silent from then on ([`HANDOVER`]), and the new one takes its place;
//! - its frames came round a loop: the same telemetry was received by both ways, which the router notices;
//! - it is another robot with the same ids: both go on, with telemetry of their own.
//!
//! Until that is known, the telemetry of the newcomer is not used.

use std::collections::BTreeMap;

use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, TimeDelta, Timestamp};

use crate::robot_table::RobotIndex;

/// Silence after which another peer with the same address takes a robot's place.
pub(crate) const HANDOVER: TimeDelta = TimeDelta::from_millis(300);
/// Telemetry that came round a loop shows for so long that the address is heard by several ways.
const LOOP_MEMORY: TimeDelta = TimeDelta::from_millis(15_000);
/// Most senders whose identity is open.
pub(crate) const MAX_CONTENDERS: usize = 256;

/// Who sent a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SenderIdentity {
    /// A robot that is known.
    Robot(RobotIndex),
    /// No robot, or not yet: it may become one.
    Unknown,
    /// It has the ids of a robot, and whether it is that one is open.
    Contested,
}

/// A message, as far as identity is concerned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SenderSign {
    pub(crate) endpoint: Endpoint,
    /// The first link of the endpoint's group.
    pub(crate) home: LinkId,
    pub(crate) address: Address,
    /// The message has not come before by another way.
    pub(crate) is_new: bool,
    /// The message has telemetry of a robot, which no two robots send alike.
    pub(crate) is_telemetry: bool,
}

/// All senders that are robots, and those that may be.
#[derive(Debug, Default)]
pub(crate) struct SenderIdentities {
    known: BTreeMap<Address, Vec<KnownSender>>,
    /// The robots that are heard by each endpoint.
    by_endpoint: BTreeMap<Endpoint, Vec<RobotIndex>>,
    /// When a sender whose identity is open was heard first.
    contenders: BTreeMap<(LinkId, PeerId, Address), Timestamp<HostClock>>,
    /// Until when an address counts as heard by several ways.
    looped_until: BTreeMap<Address, Timestamp<HostClock>>,
}

#[derive(Debug)]
struct KnownSender {
    robot: RobotIndex,
    home: LinkId,
    /// The peer on each link of the group, and when it was heard last.
    peers: BTreeMap<LinkId, (PeerId, Timestamp<HostClock>)>,
    last_telemetry: Timestamp<HostClock>,
}

impl SenderIdentities {
    /// A sender is a robot from now on.
    pub(crate) fn add(&mut self, now: Timestamp<HostClock>, sign: SenderSign, robot: RobotIndex) {
        let SenderSign { endpoint, home, address, .. } = sign;
        self.contenders.remove(&(endpoint.link, endpoint.peer, address));
        let peers = BTreeMap::from([(endpoint.link, (endpoint.peer, now))]);
        self.known.entry(address).or_default().push(KnownSender { robot, home, peers, last_telemetry: now });
        self.by_endpoint.entry(endpoint).or_default().push(robot);
    }

    /// The robots that are heard by an endpoint.
    pub(crate) fn at_endpoint(&self, endpoint: Endpoint) -> &[RobotIndex] {
        self.by_endpoint.get(&endpoint).map_or(&[], Vec::as_slice)
    }

    /// A robot is heard by another peer of a link than before, or on a further link.
    fn move_robot(&mut self, robot: RobotIndex, from: Option<Endpoint>, to: Endpoint) {
        if let Some(from) = from
            && let Some(robots) = self.by_endpoint.get_mut(&from)
        {
            robots.retain(|other| *other != robot);
            if robots.is_empty() {
                self.by_endpoint.remove(&from);
            }
        }
        self.by_endpoint.entry(to).or_default().push(robot);
    }

    /// The robot of an endpoint and an address, without any effect.
    pub(crate) fn find(&self, endpoint: Endpoint, home: LinkId, address: Address) -> Option<RobotIndex> {
        let known = self.known.get(&address)?;
        let mut at_home = known.iter().filter(|sender| sender.home == home);
        let is_it = |sender: &&KnownSender| sender.peers.get(&endpoint.link).is_some_and(|at| at.0 == endpoint.peer);
        let same_peer = at_home.clone().find(is_it);
        same_peer
            .or_else(|| at_home.find(|sender| !sender.peers.contains_key(&endpoint.link)))
            .map(|sender| sender.robot)
    }

    /// Whether a robot with this address is known, on whichever link.
    pub(crate) fn is_known(&self, address: Address) -> bool {
        self.known.contains_key(&address)
    }

    /// Whether a robot with this address is known on a link.
    pub(crate) fn is_taken(&self, home: LinkId, address: Address) -> bool {
        self.known.get(&address).is_some_and(|known| known.iter().any(|sender| sender.home == home))
    }

    /// Who sent a message that came in now.
    pub(crate) fn identify(&mut self, now: Timestamp<HostClock>, sign: SenderSign) -> SenderIdentity {
        let SenderSign { endpoint, home, address, is_new, is_telemetry } = sign;
        let found = self.find(endpoint, home, address);
        let Some(known) = self.known.get_mut(&address) else {
            return SenderIdentity::Unknown;
        };
        if is_telemetry && !is_new {
            self.looped_until.insert(address, now + LOOP_MEMORY);
        }
        if let Some(robot) = found {
            if let Some(sender) = known.iter_mut().find(|sender| sender.robot == robot) {
                let before = sender.peers.insert(endpoint.link, (endpoint.peer, now));
                if is_telemetry && is_new {
                    sender.last_telemetry = now;
                }
                if before.is_none() {
                    self.move_robot(robot, None, endpoint);
                }
            }
            return SenderIdentity::Robot(robot);
        }
        let at_home = known.iter_mut().filter(|sender| sender.home == home);
        let oldest = at_home.min_by_key(|sender| sender.peers.get(&endpoint.link).map(|(_, last)| *last));
        if let Some(sender) = oldest {
            let last = sender.peers.get(&endpoint.link).map_or(now, |(_, last)| *last);
            if !is_new || now - last >= HANDOVER {
                let robot = sender.robot;
                if is_new {
                    let before = sender.peers.insert(endpoint.link, (endpoint.peer, now));
                    sender.last_telemetry = now;
                    self.contenders.remove(&(endpoint.link, endpoint.peer, address));
                    let from = before.map(|(peer, _)| Endpoint { link: endpoint.link, peer });
                    self.move_robot(robot, from, endpoint);
                }
                return SenderIdentity::Robot(robot);
            }
        }
        if !is_telemetry {
            // A thermometer or a camera may have the ids of a robot.
            return SenderIdentity::Unknown;
        }
        if !is_new {
            return SenderIdentity::Contested;
        }
        let is_looped = self.looped_until.get(&address).is_some_and(|until| now < *until);
        let key = (endpoint.link, endpoint.peer, address);
        if self.contenders.len() >= MAX_CONTENDERS && !self.contenders.contains_key(&key) {
            self.contenders.clear();
        }
        let first = *self.contenders.entry(key).or_insert(now);
        let known = self.known.get(&address).map_or(&[][..], Vec::as_slice);
        // All who have the address have gone on since, each with telemetry of its own.
        let is_distinct = known.iter().all(|sender| sender.last_telemetry > first);
        if is_distinct && !is_looped { SenderIdentity::Unknown } else { SenderIdentity::Contested }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADDRESS: Address = Address::new(1, 1);

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    fn telemetry(link: u16, peer: u32) -> SenderSign {
        let endpoint = Endpoint { link: LinkId(link), peer: PeerId(peer) };
        SenderSign { endpoint, home: LinkId(link), address: ADDRESS, is_new: true, is_telemetry: true }
    }

    fn with_one_robot() -> SenderIdentities {
        let mut identities = SenderIdentities::default();
        assert_eq!(identities.identify(at(0), telemetry(0, 0)), SenderIdentity::Unknown);
        identities.add(at(0), telemetry(0, 0), 0);
        identities
    }

    #[test]
    fn a_robot_that_comes_back_as_another_peer_goes_on_after_the_old_one_fell_silent() {
        let mut identities = with_one_robot();
        assert_eq!(identities.identify(at(100), telemetry(0, 1)), SenderIdentity::Contested);
        assert_eq!(identities.identify(at(290), telemetry(0, 1)), SenderIdentity::Contested);
        assert_eq!(identities.identify(at(300), telemetry(0, 1)), SenderIdentity::Robot(0));
        assert_eq!(identities.identify(at(310), telemetry(0, 1)), SenderIdentity::Robot(0));
    }

    #[test]
    fn a_thermometer_with_the_ids_of_a_robot_on_another_link_is_heard() {
        let mut identities = with_one_robot();
        let thermometer = SenderSign { is_telemetry: false, ..telemetry(2, 0) };
        assert_eq!(identities.identify(at(10), thermometer), SenderIdentity::Unknown);
    }

    #[test]
    fn two_peers_that_both_go_on_are_two_robots() {
        for link in [0, 1] {
            let mut identities = with_one_robot();
            let other = telemetry(link, 7);
            assert_eq!(identities.identify(at(10), other), SenderIdentity::Contested, "link {link}");
            assert_eq!(identities.identify(at(50), telemetry(0, 0)), SenderIdentity::Robot(0));
            assert_eq!(identities.identify(at(60), other), SenderIdentity::Unknown, "link {link}");
            identities.add(at(60), other, 1);
            assert_eq!(identities.identify(at(100), telemetry(0, 0)), SenderIdentity::Robot(0));
            assert_eq!(identities.identify(at(110), other), SenderIdentity::Robot(1));
        }
    }

    #[test]
    fn a_robot_that_is_heard_by_two_ways_stays_one() {
        let mut identities = with_one_robot();
        for millis in (50..20_000).step_by(50) {
            // Now the one way is quicker, now the other.
            let is_direct_first = millis % 100 == 0;
            let direct = SenderSign { is_new: is_direct_first, ..telemetry(0, 0) };
            let detour = SenderSign { is_new: !is_direct_first, ..telemetry(1, 0) };
            let (first, second) = if is_direct_first { (direct, detour) } else { (detour, direct) };
            for sign in [first, second] {
                assert_ne!(identities.identify(at(millis), sign), SenderIdentity::Unknown, "{millis} ms");
            }
        }
    }
}
