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
//! Until that is decided, the messages of the new peer are kept and not used. Otherwise a robot with the ids of another would lose its
//! first messages, and one that reconnected those until the old peer counts as silent.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, VecDeque};
use std::ops::RangeInclusive;

use posebridge_protocol::message::Message;
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, TimeDelta, Timestamp};

use crate::observation_extractor::UnalignedObservation;
use crate::receive::{ReceiveInfo, TimeExchange};

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
const MAX_CONTENDERS: usize = 256;
/// Most messages kept of one of them: half a second of one that sends 100 messages a second and replies to time requests. The
/// oldest are dropped first.
const MAX_PER_SENDER: usize = 64;

/// A message of an undecided sender, kept until it is known: see also [`crate::observers`].
#[derive(Debug)]
pub(crate) enum ContestedMessage {
    /// May be from a robot.
    Message(ReceiveInfo, Message),
    Fix(ReceiveInfo, UnalignedObservation),
    TimeExchange(TimeExchange),
}

/// Messages of all such senders, in order of arrival for each.
#[derive(Debug, Default)]
pub(crate) struct ContestedMessages(BTreeMap<(Endpoint, Address), VecDeque<ContestedMessage>>);

impl ContestedMessages {
    pub(crate) fn push(&mut self, endpoint: Endpoint, address: Address, message: ContestedMessage) {
        let messages = contender_entry(&mut self.0, (endpoint, address)).or_default();
        if messages.len() >= MAX_PER_SENDER {
            messages.pop_front();
        }
        messages.push_back(message);
    }

    /// The messages of a sender that is now known, oldest first.
    pub(crate) fn take(&mut self, endpoint: Endpoint, address: Address) -> VecDeque<ContestedMessage> {
        if self.0.is_empty() {
            return VecDeque::new();
        }
        self.0.remove(&(endpoint, address)).unwrap_or_default()
    }
}

/// The entry of an undecided sender. A new one beyond the limit clears all others, which may be invented.
pub(crate) fn contender_entry<K: Ord, V>(contenders: &mut BTreeMap<K, V>, sender: K) -> Entry<'_, K, V> {
    if contenders.len() >= MAX_CONTENDERS && !contenders.contains_key(&sender) {
        contenders.clear();
    }
    contenders.entry(sender)
}

/// `None` if there are several.
pub(crate) fn only_one(mut robots: impl Iterator<Item = RobotIndex>) -> Option<RobotIndex> {
    let only = robots.next();
    only.filter(|_| robots.next().is_none())
}

/// All addresses at an endpoint.
pub(crate) fn addresses_at(endpoint: Endpoint) -> RangeInclusive<(Endpoint, Address)> {
    (endpoint, Address::new(0, 0))..=(endpoint, Address::new(u8::MAX, u8::MAX))
}

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
    contenders: BTreeMap<(Endpoint, Address), Timestamp<HostClock>>,
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
        self.contenders.remove(&(endpoint, address));
        self.senders.push(KnownSender::new(endpoint, home, now));
        self.by_address.entry(address).or_default().push(robot);
        self.by_endpoint.insert((endpoint, address), robot);
    }

    /// The only robot at an endpoint, with any address.
    pub(crate) fn only_at(&self, endpoint: Endpoint) -> Option<RobotIndex> {
        only_one(self.by_endpoint.range(addresses_at(endpoint)).map(|(_, robot)| *robot))
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
                self.contenders.remove(&(endpoint, address));
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
        let first = *contender_entry(&mut self.contenders, (endpoint, address)).or_insert(now);
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
    use crate::test_config::at;

    const ADDRESS: Address = Address::new(1, 1);

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
    fn a_new_sender_beyond_the_limit_clears_all_and_a_known_one_drops_its_oldest() {
        let endpoint = Endpoint::default();
        let message = |nanos| {
            let answer = ReceiveInfo { endpoint, host_time: Timestamp::ZERO };
            ContestedMessage::TimeExchange(TimeExchange { sent: Timestamp::ZERO, answer, peer_nanos: nanos })
        };
        let address = |index: usize| Address::new((index >> 8) as u8, index as u8);
        let mut messages = ContestedMessages::default();
        for index in 0..MAX_CONTENDERS {
            messages.push(endpoint, address(index), message(0));
        }
        for nanos in 1..=MAX_PER_SENDER as i64 {
            messages.push(endpoint, address(0), message(nanos));
        }
        assert_eq!(messages.0.len(), MAX_CONTENDERS);
        let kept = messages.take(endpoint, address(0));
        assert!(matches!(kept.front(), Some(ContestedMessage::TimeExchange(TimeExchange { peer_nanos: 1, .. }))));
        assert_eq!(kept.len(), MAX_PER_SENDER);
        messages.push(endpoint, address(0), message(0));
        messages.push(endpoint, address(MAX_CONTENDERS), message(0));
        assert_eq!(messages.0.len(), 1);
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
        for (millis, link, peer) in [(10, 2, 0), (400, 0, 1)] {
            let camera = MessageOrigin { is_telemetry: false, ..telemetry(link, peer) };
            assert_eq!(identify(&mut identities, at(millis), camera), SenderIdentity::Unknown, "link {link}");
        }
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
