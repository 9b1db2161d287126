//! Identifies the robot that sent a message, also when several robots have the same ids.
//!
//! A robot is identified by link and address, and by its peer. When its address appears at another peer of its link, or
//! on another link, there are three explanations, which later messages distinguish:
//!
//! - it reconnected: the old peer of that link is silent for longer than it usually is, and telemetry comes from the new one, which
//!   takes its place;
//! - its frames came round a loop: the same telemetry was received from both endpoints, which the router notices;
//! - it is another robot with the same ids: both go on, with telemetry of their own; or, on another link, the robot there is off.
//!
//! Until that is decided, the telemetry of the new peer is not used.

use std::collections::BTreeMap;

use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, TimeDelta, Timestamp};

/// Index in the [`RobotTable`](crate::robot_table::RobotTable).
pub(crate) type RobotIndex = usize;

/// Silence after which a robot, or any other peer, counts as lost. Five missed heartbeats: the usual limit of ground stations.
pub(crate) const PEER_TIMEOUT: TimeDelta = TimeDelta::from_millis(5_000);
/// Shortest silence after which another peer with the same address replaces the first.
pub(crate) const HANDOVER: TimeDelta = TimeDelta::from_millis(300);
/// A robot that sends rarely has longer silences: another peer replaces it after this many of its usual intervals.
const HANDOVER_INTERVALS: i64 = 2;
/// Longest such silence: a pause is no usual interval.
const LATEST_HANDOVER: TimeDelta = TimeDelta::from_millis(2_500);
/// How long telemetry from a loop shows that an address is received from several endpoints.
const LOOP_MEMORY: TimeDelta = TimeDelta::from_millis(15_000);
/// Most undecided senders.
pub(crate) const MAX_CONTENDERS: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SenderIdentity {
    Robot(RobotIndex),
    /// Not a robot, or not yet: it may become one.
    Unknown,
    /// It has the ids of a robot, and it is undecided whether it is that robot.
    Contested,
}

/// The properties of a message that identify its sender.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MessageOrigin {
    pub(crate) endpoint: Endpoint,
    /// The first link of the endpoint's group.
    pub(crate) home: LinkId,
    pub(crate) address: Address,
    /// The message is not a duplicate.
    pub(crate) is_new: bool,
    /// The message has telemetry of a robot, which no two robots send identically.
    pub(crate) is_telemetry: bool,
}

#[derive(Debug, Default)]
pub(crate) struct SenderIdentities {
    /// By index in the robot table.
    senders: Vec<KnownSender>,
    by_address: BTreeMap<Address, Vec<RobotIndex>>,
    by_endpoint: BTreeMap<(Endpoint, Address), RobotIndex>,
    /// When an undecided sender was first received.
    contenders: BTreeMap<(LinkId, PeerId, Address), Timestamp<HostClock>>,
    /// Until when an address counts as received from several endpoints.
    looped_until: BTreeMap<Address, Timestamp<HostClock>>,
}

#[derive(Debug)]
struct KnownSender {
    home: LinkId,
    /// The peer on each link of the group, and the instant of its last message.
    peers: BTreeMap<LinkId, (PeerId, Timestamp<HostClock>)>,
    last_telemetry: Timestamp<HostClock>,
    /// The last intervals between messages with telemetry.
    intervals: [TimeDelta; 4],
}

impl KnownSender {
    fn new(endpoint: Endpoint, home: LinkId, now: Timestamp<HostClock>) -> Self {
        let peers = BTreeMap::from([(endpoint.link, (endpoint.peer, now))]);
        Self { home, peers, last_telemetry: now, intervals: [TimeDelta::ZERO; 4] }
    }

    fn record_telemetry(&mut self, now: Timestamp<HostClock>) {
        let [first, second, third, _] = self.intervals;
        self.intervals = [now - self.last_telemetry, first, second, third];
        self.last_telemetry = now;
    }

    /// The silence after which another peer of a link replaces the robot's.
    fn handover(&self) -> TimeDelta {
        let longest = self.intervals.into_iter().max().unwrap_or(TimeDelta::ZERO);
        TimeDelta::from_nanos(longest.as_nanos().saturating_mul(HANDOVER_INTERVALS)).max(HANDOVER).min(LATEST_HANDOVER)
    }
}

impl SenderIdentities {
    /// Adds a sender as the next robot of the table.
    pub(crate) fn add(&mut self, now: Timestamp<HostClock>, origin: MessageOrigin) {
        let MessageOrigin { endpoint, home, address, .. } = origin;
        let robot = self.senders.len();
        self.contenders.remove(&(endpoint.link, endpoint.peer, address));
        self.senders.push(KnownSender::new(endpoint, home, now));
        self.by_address.entry(address).or_default().push(robot);
        self.by_endpoint.insert((endpoint, address), robot);
    }

    /// The only robot at an endpoint, with any address.
    pub(crate) fn only_at(&self, endpoint: Endpoint) -> Option<RobotIndex> {
        let first = (endpoint, Address::new(0, 0));
        let last = (endpoint, Address::new(u8::MAX, u8::MAX));
        let mut robots = self.by_endpoint.range(first..=last).map(|(_, robot)| *robot);
        let only = robots.next();
        only.filter(|_| robots.next().is_none())
    }

    pub(crate) fn at_endpoint(&self, endpoint: Endpoint, address: Address) -> Option<RobotIndex> {
        self.by_endpoint.get(&(endpoint, address)).copied()
    }

    pub(crate) fn peer_on(&self, robot: RobotIndex, link: LinkId) -> Option<PeerId> {
        self.senders.get(robot)?.peers.get(&link).map(|(peer, _)| *peer)
    }

    /// The robot of an endpoint and an address; changes no state.
    pub(crate) fn find(&self, endpoint: Endpoint, home: LinkId, address: Address) -> Option<RobotIndex> {
        self.at_endpoint(endpoint, address).or_else(|| {
            let is_elsewhere = |robot: &RobotIndex| !self.senders[*robot].peers.contains_key(&endpoint.link);
            self.at_home(home, address).find(is_elsewhere)
        })
    }

    /// Whether a robot with this address is known, on any link.
    pub(crate) fn is_known(&self, address: Address) -> bool {
        self.by_address.contains_key(&address)
    }

    pub(crate) fn at_home(&self, home: LinkId, address: Address) -> impl Iterator<Item = RobotIndex> {
        let robots = self.by_address.get(&address).map_or(&[][..], Vec::as_slice);
        robots.iter().copied().filter(move |robot| self.senders[*robot].home == home)
    }

    /// Identifies the sender of a message that arrives now; `known` is the result of [`Self::find`].
    pub(crate) fn identify(
        &mut self,
        now: Timestamp<HostClock>,
        origin: MessageOrigin,
        known: Option<RobotIndex>,
    ) -> SenderIdentity {
        let MessageOrigin { endpoint, home, address, is_new, is_telemetry } = origin;
        if known.is_none() && !self.is_known(address) {
            return SenderIdentity::Unknown;
        }
        if is_telemetry && !is_new {
            self.looped_until.insert(address, now + LOOP_MEMORY);
        }
        if let Some(robot) = known {
            self.move_to(robot, now, origin);
            if is_telemetry && is_new {
                self.senders[robot].record_telemetry(now);
            }
            return SenderIdentity::Robot(robot);
        }
        let last_seen = |robot: &RobotIndex| self.senders[*robot].peers.get(&endpoint.link).map(|(_, last)| *last);
        if let Some(robot) = self.at_home(home, address).min_by_key(last_seen) {
            if !is_new {
                return SenderIdentity::Robot(robot);
            }
            let last = last_seen(&robot).unwrap_or(now);
            // A camera or a thermometer may have the ids of a robot: only telemetry takes its place.
            if is_telemetry && now - last >= self.senders[robot].handover() {
                self.move_to(robot, now, origin);
                self.senders[robot].record_telemetry(now);
                self.contenders.remove(&(endpoint.link, endpoint.peer, address));
                return SenderIdentity::Robot(robot);
            }
        }
        if !is_telemetry {
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
        let mut known = self.by_address.get(&address).into_iter().flatten();
        // Every robot with the address has gone on since, with telemetry of its own, or is off.
        let is_distinct = known.all(|robot| {
            let last = self.senders[*robot].last_telemetry;
            last > first || now - last >= PEER_TIMEOUT
        });
        if is_distinct && !is_looped { SenderIdentity::Unknown } else { SenderIdentity::Contested }
    }

    /// Moves a robot to an endpoint, replacing its other peer on that link.
    fn move_to(&mut self, robot: RobotIndex, now: Timestamp<HostClock>, origin: MessageOrigin) {
        let MessageOrigin { endpoint, address, .. } = origin;
        let before = self.senders[robot].peers.insert(endpoint.link, (endpoint.peer, now));
        if before.is_some_and(|(peer, _)| peer == endpoint.peer) {
            return;
        }
        if let Some((peer, _)) = before {
            self.by_endpoint.remove(&(Endpoint { peer, ..endpoint }, address));
        }
        self.by_endpoint.insert((endpoint, address), robot);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADDRESS: Address = Address::new(1, 1);

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    fn telemetry(link: u16, peer: u32) -> MessageOrigin {
        let endpoint = Endpoint { link: LinkId(link), peer: PeerId(peer) };
        MessageOrigin { endpoint, home: LinkId(link), address: ADDRESS, is_new: true, is_telemetry: true }
    }

    fn identify(identities: &mut SenderIdentities, now: Timestamp<HostClock>, origin: MessageOrigin) -> SenderIdentity {
        let known = identities.find(origin.endpoint, origin.home, origin.address);
        identities.identify(now, origin, known)
    }

    fn with_one_robot() -> SenderIdentities {
        let mut identities = SenderIdentities::default();
        assert_eq!(identify(&mut identities, at(0), telemetry(0, 0)), SenderIdentity::Unknown);
        identities.add(at(0), telemetry(0, 0));
        identities
    }

    #[test]
    fn a_robot_that_comes_back_as_another_peer_goes_on_after_the_old_one_fell_silent() {
        let mut identities = with_one_robot();
        assert_eq!(identify(&mut identities, at(100), telemetry(0, 1)), SenderIdentity::Contested);
        assert_eq!(identify(&mut identities, at(290), telemetry(0, 1)), SenderIdentity::Contested);
        assert_eq!(identify(&mut identities, at(300), telemetry(0, 1)), SenderIdentity::Robot(0));
        assert_eq!(identify(&mut identities, at(310), telemetry(0, 1)), SenderIdentity::Robot(0));
    }

    #[test]
    fn a_robot_that_sends_rarely_is_not_taken_for_one_that_reconnected() {
        let mut identities = with_one_robot();
        for millis in (500..=2_500).step_by(500) {
            assert_eq!(identify(&mut identities, at(millis), telemetry(0, 0)), SenderIdentity::Robot(0));
        }
        assert_eq!(identify(&mut identities, at(2_950), telemetry(0, 1)), SenderIdentity::Contested);
        assert_eq!(identify(&mut identities, at(3_000), telemetry(0, 0)), SenderIdentity::Robot(0));
        assert_eq!(identify(&mut identities, at(3_450), telemetry(0, 1)), SenderIdentity::Unknown, "both go on");
    }

    #[test]
    fn a_robot_that_reconnects_soon_after_a_long_pause_stays_the_same_robot() {
        let mut identities = with_one_robot();
        assert_eq!(identify(&mut identities, at(60_000), telemetry(0, 0)), SenderIdentity::Robot(0));
        assert_eq!(identify(&mut identities, at(60_100), telemetry(0, 1)), SenderIdentity::Contested);
        assert_eq!(identify(&mut identities, at(62_500), telemetry(0, 1)), SenderIdentity::Robot(0));
    }

    #[test]
    fn only_telemetry_replaces_a_silent_robot() {
        let mut identities = with_one_robot();
        let camera = MessageOrigin { is_telemetry: false, ..telemetry(0, 1) };
        assert_eq!(identify(&mut identities, at(400), camera), SenderIdentity::Unknown);
        assert_eq!(identify(&mut identities, at(500), telemetry(0, 0)), SenderIdentity::Robot(0));
    }

    #[test]
    fn the_ids_of_a_robot_that_is_off_are_another_robot_on_another_link() {
        let mut identities = with_one_robot();
        assert_eq!(identify(&mut identities, at(1_000), telemetry(1, 0)), SenderIdentity::Contested);
        assert_eq!(identify(&mut identities, at(4_999), telemetry(1, 0)), SenderIdentity::Contested);
        assert_eq!(identify(&mut identities, at(5_000), telemetry(1, 0)), SenderIdentity::Unknown);
    }

    #[test]
    fn a_thermometer_with_the_ids_of_a_robot_on_another_link_is_used() {
        let mut identities = with_one_robot();
        let thermometer = MessageOrigin { is_telemetry: false, ..telemetry(2, 0) };
        assert_eq!(identify(&mut identities, at(10), thermometer), SenderIdentity::Unknown);
    }

    #[test]
    fn two_peers_that_both_go_on_are_two_robots() {
        for link in [0, 1] {
            let mut identities = with_one_robot();
            let other = telemetry(link, 7);
            assert_eq!(identify(&mut identities, at(10), other), SenderIdentity::Contested, "link {link}");
            assert_eq!(identify(&mut identities, at(50), telemetry(0, 0)), SenderIdentity::Robot(0));
            assert_eq!(identify(&mut identities, at(60), other), SenderIdentity::Unknown, "link {link}");
            identities.add(at(60), other);
            assert_eq!(identify(&mut identities, at(100), telemetry(0, 0)), SenderIdentity::Robot(0));
            assert_eq!(identify(&mut identities, at(110), other), SenderIdentity::Robot(1));
        }
    }

    #[test]
    fn a_robot_received_from_two_endpoints_stays_one() {
        let mut identities = with_one_robot();
        for millis in (50..20_000).step_by(50) {
            // Now the one way is quicker, now the other.
            let is_direct_first = millis % 100 == 0;
            let direct = MessageOrigin { is_new: is_direct_first, ..telemetry(0, 0) };
            let detour = MessageOrigin { is_new: !is_direct_first, ..telemetry(1, 0) };
            let (first, second) = if is_direct_first { (direct, detour) } else { (detour, direct) };
            for origin in [first, second] {
                assert_ne!(identify(&mut identities, at(millis), origin), SenderIdentity::Unknown, "{millis} ms");
            }
        }
    }
}
