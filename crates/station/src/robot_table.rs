//! All robots of a station, in the order of their first message.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_estimator::FilterCommand;
use posebridge_protocol::routing::{Endpoint, FrameRouter};
use posebridge_telemetry::{
    Address, FilterComparison, HostClock, LinkId, OnlineCalibration, PeerId, RobotId, SensorId, SensorSwitch,
    StartPose, SystemId, TimeDelta, Timestamp,
};

use crate::camera_table::CameraIdentity;
use crate::clock_alignment::ClockAlignment;
use crate::config::{BuildError, OutputKind, RobotBlockIndex, RobotConfig, StationConfig};
use crate::observers::{ObserverAddress, Observers};
use crate::ownership_status::OwnershipStatus;
use crate::robot::{Robot, RobotFilters};
use crate::sender_identity::{ContestedMessages, MessageOrigin, PEER_TIMEOUT, RobotIndex, SenderIdentities, only_one};
use crate::vehicle_proxy::VEHICLE_COMPONENT;

/// Systems up to this one are given to robots whose own is taken; those above are for ground stations.
const LAST_VEHICLE_SYSTEM: u8 = 250;

/// All robots. There is always a first one: before any is detected it takes the input of a replay or a person.
pub(crate) struct RobotTable {
    robots: Vec<Robot>,
    by_id: BTreeMap<RobotId, RobotIndex>,
    pub(crate) identities: SenderIdentities,
    /// Messages of senders that may be robots or cameras with the ids of others.
    pub(crate) contested: ContestedMessages,
    blocks: RobotBlockIndex,
    /// Systems that ground stations have seen, as vehicles or in ids.
    used_systems: BTreeSet<SystemId>,
    /// Robots that ground stations see under another system than that of their own frames, by the announced system.
    renamed: BTreeMap<SystemId, RobotIndex>,
    /// The robots of a link, by the first link of its group.
    by_link: BTreeMap<LinkId, Vec<RobotIndex>>,
    /// Robots that share their address with another of their link, and whether each was reported as lost: sessions know
    /// only addresses and do not detect the loss of one.
    robots_with_shared_address: BTreeMap<RobotIndex, bool>,
    /// Robots of which an owner is noted and that are not heard yet, each as it will be adopted.
    prepared: BTreeMap<RobotId, PreparedRobot>,
    /// Robots that other stations own, and whether it was said of each that frames for it are not passed on.
    standby: BTreeMap<RobotIndex, bool>,
    has_refused: bool,
    has_reported_refusal: bool,
    pub(crate) settings: CommonSettings,
    /// Robots with new data since their last estimate.
    pub(crate) changed: OrderedQueue,
    /// Robots whose estimate was not yet sent to the other links.
    pub(crate) pending: OrderedQueue,
    /// Intervals that peers requested, also for robots that appear later.
    intervals: Vec<(LinkId, u32, Option<TimeDelta>)>,
    /// Before this instant no robot can time out.
    presence_until: Option<Timestamp<HostClock>>,
}

/// A robot as it will be adopted.
pub(crate) struct PreparedRobot {
    pub(crate) robot: Robot,
    /// It continues from the state of another station.
    pub(crate) has_state: bool,
}

/// Settings for all robots, also for those that appear later.
#[derive(Debug, Default)]
pub(crate) struct CommonSettings {
    pub(crate) online_calibration: Option<OnlineCalibration>,
    pub(crate) sensors: BTreeMap<SensorId, SensorSwitch>,
    /// `None` as configured.
    pub(crate) comparison: Option<FilterComparison>,
    /// The start pose of the first robot before it is detected.
    first_pose: Option<StartPose>,
}

impl CommonSettings {
    fn apply(&mut self, robot: &mut Robot, config: &RobotConfig) {
        if let Some(comparison) = self.comparison {
            robot.compare_filters(comparison, config);
        }
        if let Some(online_calibration) = self.online_calibration {
            robot.apply(&FilterCommand::SetOnlineCalibration(online_calibration));
        }
        for (sensor, switch) in &self.sensors {
            robot.switch_sensor(*sensor, *switch);
        }
        if let Some(pose) = self.first_pose.take() {
            robot.set_pose(&pose);
        }
    }
}

impl RobotTable {
    /// Fails if a filter is unknown.
    pub(crate) fn new(config: &StationConfig) -> Result<Self, BuildError> {
        let mut first = Robot::new(&RobotFilters::find(&config.robot)?, &config.robot, &config.links, config.origin);
        first.ownership = config.ownership.into();
        Ok(Self {
            robots: vec![first],
            by_id: BTreeMap::new(),
            identities: SenderIdentities::default(),
            contested: ContestedMessages::default(),
            blocks: RobotBlockIndex::new(&config.robots),
            used_systems: BTreeSet::new(),
            renamed: BTreeMap::new(),
            by_link: BTreeMap::new(),
            robots_with_shared_address: BTreeMap::new(),
            prepared: BTreeMap::new(),
            standby: BTreeMap::new(),
            has_refused: false,
            has_reported_refusal: false,
            settings: CommonSettings::default(),
            changed: OrderedQueue::default(),
            pending: OrderedQueue::default(),
            intervals: Vec::new(),
            presence_until: None,
        })
    }

    /// Before any robot is detected, the configured one.
    pub(crate) fn first(&self) -> &Robot {
        &self.robots[0]
    }

    pub(crate) fn get(&self, index: RobotIndex) -> &Robot {
        &self.robots[index]
    }

    pub(crate) fn get_mut(&mut self, index: RobotIndex) -> &mut Robot {
        &mut self.robots[index]
    }

    pub(crate) fn all(&self) -> &[Robot] {
        &self.robots
    }

    pub(crate) fn detected(&self) -> &[Robot] {
        &self.robots[..self.len()]
    }

    pub(crate) fn all_mut(&mut self) -> &mut [Robot] {
        &mut self.robots
    }

    /// Robots that are not heard yet.
    pub(crate) fn prepared_mut(&mut self) -> impl Iterator<Item = &mut Robot> {
        self.prepared.values_mut().map(|prepared| &mut prepared.robot)
    }

    pub(crate) fn find(&self, id: RobotId) -> Option<RobotIndex> {
        self.by_id.get(&id).copied()
    }

    pub(crate) fn len(&self) -> usize {
        self.by_id.len()
    }

    /// The robot with an id; before any is detected, the configured one has the default id.
    pub(crate) fn find_or_first(&self, id: RobotId) -> Option<RobotIndex> {
        let is_configured = self.len() == 0 && id == self.first().id;
        self.find(id).or(is_configured.then_some(0))
    }

    /// A robot with this id as it would be adopted; `None` if that would be one too many.
    pub(crate) fn prepare(&mut self, id: RobotId, config: &StationConfig) -> Option<PreparedRobot> {
        if let Some(prepared) = self.prepared.remove(&id) {
            return Some(prepared);
        }
        if self.len() + self.prepared.len() >= config.max_robots.max(1) {
            return None;
        }
        let block = self.blocks.find(&config.robots, id.link, id.address);
        let mut robot = self.build(config, block)?;
        robot.id = id;
        robot.block = block;
        Some(PreparedRobot { robot, has_state: false })
    }

    pub(crate) fn keep_prepared(&mut self, id: RobotId, prepared: PreparedRobot) {
        self.prepared.insert(id, prepared);
    }

    pub(crate) fn find_prepared(&self, id: RobotId) -> Option<&Robot> {
        self.prepared.get(&id).map(|prepared| &prepared.robot)
    }

    /// A new robot with the settings of all.
    fn build(&mut self, config: &StationConfig, block: Option<usize>) -> Option<Robot> {
        let robot_config = config.robot_config(block);
        let filters = RobotFilters::find(robot_config).ok()?;
        let mut robot = Robot::new(&filters, robot_config, &config.links, config.origin);
        robot.ownership = config.ownership.into();
        robot.apply(&FilterCommand::SetParams(config.robot.filter_config.params));
        self.settings.apply(&mut robot, robot_config);
        for (link, message_id, interval) in &self.intervals {
            robot.publisher.set_interval(*link, *message_id, *interval);
        }
        Some(robot)
    }

    pub(crate) fn set_ownership(&mut self, index: RobotIndex, status: OwnershipStatus) {
        self.get_mut(index).ownership = status;
        if status.is_standby() {
            self.standby.insert(index, false);
        } else {
            self.standby.remove(&index);
        }
    }

    /// Whether any robot is owned by another station.
    pub(crate) fn has_standby(&self) -> bool {
        !self.standby.is_empty() || self.awaited_standby().next().is_some()
    }

    /// Whether a robot of this home link that is owned by another station is not heard yet, so that any peer may be it.
    pub(crate) fn awaits_standby(&self, home: LinkId) -> bool {
        self.awaited_standby().any(|robot| robot.id.link == home)
    }

    fn awaited_standby(&self) -> impl Iterator<Item = &Robot> {
        self.prepared.values().map(|prepared| &prepared.robot).filter(|robot| robot.ownership.is_standby())
    }

    /// The robot of another station at a peer, the first time that a frame for it is not passed on.
    pub(crate) fn take_first_withheld(&mut self, link: LinkId, peer: PeerId) -> Option<RobotIndex> {
        let index = self.standby_at(link, peer)?;
        let was_said = std::mem::replace(self.standby.get_mut(&index)?, true);
        (!was_said).then_some(index)
    }

    /// The robot of another station at a peer, unless one of this station is there as well.
    pub(crate) fn standby_at(&self, link: LinkId, peer: PeerId) -> Option<RobotIndex> {
        let is_there = |index: &RobotIndex| self.identities.peer_on(*index, link) == Some(peer);
        let standby = self.standby.keys().copied().find(is_there)?;
        let is_shared = (0..self.len()).any(|index| !self.standby.contains_key(&index) && is_there(&index));
        (!is_shared).then_some(standby)
    }

    /// The wire addresses of the robots of a home link that other stations own.
    pub(crate) fn standby_addresses(&self, home: LinkId) -> impl Iterator<Item = Address> {
        let adopted = self.standby.keys().map(|index| self.get(*index));
        let adopted = adopted.filter(move |robot| robot.id.link == home).map(|robot| robot.wire_address);
        let awaited = self.awaited_standby().filter(move |robot| robot.id.link == home);
        adopted.chain(awaited.map(|robot| robot.id.address))
    }

    /// The peers of a link with robots that this station owns.
    pub(crate) fn owned_peers(&self, link: LinkId) -> impl Iterator<Item = PeerId> {
        let owned = (0..self.len()).filter(|index| !self.standby.contains_key(index));
        owned.filter_map(move |index| self.identities.peer_on(index, link))
    }

    /// The robot for which a condition holds; `None` if there is none or more than one.
    fn only(&self, is_it: impl Fn(&Robot) -> bool) -> Option<RobotIndex> {
        only_one((0..self.len()).filter(|index| is_it(self.get(*index))))
    }

    /// The only robot that a camera corrects at present.
    pub(crate) fn only_seen_by(&self, now: Timestamp<HostClock>, camera: CameraIdentity) -> Option<RobotIndex> {
        self.only(|robot| robot.cameras.is_seen_by(now, camera))
    }

    /// The robot of a camera's fix; `None` if that is ambiguous, or if the robot is not known yet.
    ///
    /// A fix of a tag that the configuration assigns to a robot is for that robot. Any other is for the only robot on
    /// its sender's endpoint, else for the only robot at all, else for the only one in its sender's system, else for the one
    /// that the sender has `watched` so far (a second robot, which anybody can invent, takes no camera from the first), unless
    /// that one has another tag.
    pub(crate) fn of_fix(
        &self,
        config: &StationConfig,
        endpoint: Endpoint,
        sender: Address,
        tag: Option<u32>,
        watched: Option<RobotIndex>,
    ) -> Option<RobotIndex> {
        let in_system = |robot: &Robot| robot.wire_address.system == sender.system;
        let nearest = || {
            let only = self.identities.only_at(endpoint).or_else(|| self.only(|_| true));
            only.or_else(|| self.only(in_system)).or(watched)
        };
        let Some(tag) = tag else {
            return nearest();
        };
        let mut configured = config.robots.iter().map(|block| &block.robot).chain([&config.robot]);
        if configured.any(|robot| robot.tag == Some(tag)) {
            return self.only(|robot| robot.tag == Some(tag));
        }
        nearest().filter(|index| self.get(*index).tag.is_none())
    }

    /// The address under which ground stations see the sender at an endpoint; `None` if that is its own.
    pub(crate) fn announced_address(&self, endpoint: Endpoint, home: LinkId, sender: Address) -> Option<Address> {
        if !self.has_renamed() {
            return None;
        }
        // The other components of a robot's system go with it.
        let index = self.identities.find(endpoint, home, sender).or_else(|| self.identities.only_at(endpoint))?;
        let robot = self.get(index);
        let is_renamed = robot.is_renamed() && robot.wire_address.system == sender.system;
        is_renamed.then_some(Address { system: robot.vehicle_address.system, ..sender })
    }

    /// Whether ground stations see any robot as a system that is not its own.
    pub(crate) fn has_renamed(&self) -> bool {
        !self.renamed.is_empty()
    }

    /// The robot that ground stations see as this system, which is not its own.
    pub(crate) fn renamed(&self, system: SystemId) -> Option<&Robot> {
        self.renamed.get(&system).map(|index| self.get(*index))
    }

    /// Whether frames for a system must not be sent to an endpoint, because only a robot with another announced system
    /// is there.
    pub(crate) fn is_announced_otherwise(&self, endpoint: Endpoint, system: SystemId) -> bool {
        let robot = self.identities.only_at(endpoint).filter(|_| self.has_renamed()).map(|index| self.get(index));
        robot.is_some_and(|robot| robot.is_renamed() && robot.wire_address.system == system)
    }

    /// The configuration of the robot on a link with an address; `config` is the one from which the table was made.
    pub(crate) fn config_for<'a>(&self, config: &'a StationConfig, home: LinkId, address: Address) -> &'a RobotConfig {
        config.robot_config(self.blocks.find(&config.robots, home, address))
    }

    /// Makes an unknown sender of odometry a robot, within the limit and if the configuration allows it.
    pub(crate) fn adopt(
        &mut self,
        now: Timestamp<HostClock>,
        origin: MessageOrigin,
        config: &StationConfig,
        observers: &mut Observers,
    ) -> Option<RobotIndex> {
        let address = origin.address;
        if config.robot_system.is_some_and(|required: SystemId| required != address.system) {
            return None;
        }
        // Only telemetry distinguishes two robots with the same ids.
        if !origin.is_telemetry && self.identities.is_known(address) {
            return None;
        }
        let vehicle_address = self.free_vehicle_address(address.system, config.own_address);
        let id = self.free_id(RobotId { link: origin.home, address }, vehicle_address.system);
        let Some(id) = id.filter(|_| self.len() < config.max_robots.max(1)) else {
            self.has_refused = true;
            return None;
        };
        let index = self.len();
        let block = self.blocks.find(&config.robots, origin.home, address);
        let robot_config = config.robot_config(block);
        // The first robot replaces the configured one, with what that was given before the detection.
        let prepared = self.prepared.remove(&id);
        let has_state = prepared.as_ref().is_some_and(|prepared| prepared.has_state);
        if let Some(PreparedRobot { robot, .. }) = prepared {
            self.robots.truncate(index);
            self.robots.push(robot);
        } else if index == self.robots.len() || *robot_config != config.robot {
            let robot = self.build(config, block)?;
            self.robots.truncate(index);
            self.robots.push(robot);
        }
        self.set_ownership(index, self.robots[index].ownership);
        let namesakes: Vec<RobotIndex> = self.identities.at_home(origin.home, address).collect();
        if !namesakes.is_empty() {
            for robot in namesakes.into_iter().chain([index]) {
                self.robots_with_shared_address.entry(robot).or_insert(false);
            }
        }
        self.identities.add(now, origin);
        self.by_id.insert(id, index);
        self.by_link.entry(id.link).or_default().push(index);
        self.used_systems.extend([id.address.system, vehicle_address.system]);
        let link = config.links.iter().find(|link| link.id == origin.endpoint.link);
        let robot = &mut self.robots[index];
        robot.accepts_goals = link.is_some_and(|link| link.takes_goals(robot_config.goals));
        robot.id = id;
        robot.block = block;
        robot.wire_address = address;
        robot.vehicle_address = vehicle_address;
        if robot.is_renamed() {
            self.renamed.entry(vehicle_address.system).or_insert(index);
        }
        // Its answers to time requests may have come before its telemetry.
        let clock = observers.remove_clock(ObserverAddress { home: origin.home, address }, origin.endpoint);
        if let Some(clock) = clock.filter(|_| !has_state) {
            robot.clocks = ClockAlignment::from_observer(clock);
        }
        self.presence_until = None;
        Some(index)
    }

    /// An id that no robot has yet: that of its own frames, else the same with the first free system, `preferred`
    /// before all others; `None` if there is none. It distinguishes two robots with the same ids on one link.
    fn free_id(&self, own: RobotId, preferred: SystemId) -> Option<RobotId> {
        let systems = [own.address.system, preferred].into_iter().chain((1..=u8::MAX).map(SystemId));
        let mut ids = systems.map(|system| RobotId { address: Address { system, ..own.address }, ..own });
        ids.find(|id| !self.by_id.contains_key(id))
    }

    /// A text about a robot; with several robots it begins with the robot's name, or `link/system/component`.
    pub(crate) fn labelled(&self, index: RobotIndex, text: &str) -> String {
        let robot = self.get(index);
        match robot.name() {
            _ if self.len() < 2 => text.to_owned(),
            Some(name) => format!("{name}: {text}"),
            None => format!("{}/{}: {text}", robot.id.link, robot.id.address),
        }
    }

    /// Whether a robot beyond the limit was rejected for the first time.
    pub(crate) const fn take_first_refusal(&mut self) -> bool {
        let is_first = self.has_refused && !self.has_reported_refusal;
        self.has_reported_refusal |= self.has_refused;
        is_first
    }

    /// The address under which ground stations see a robot: in its own system, unless another robot has it.
    fn free_vehicle_address(&self, preferred: SystemId, own: Address) -> Address {
        let is_taken = |system: SystemId| self.used_systems.contains(&system);
        let system = if is_taken(preferred) {
            let mut systems = (1..=LAST_VEHICLE_SYSTEM).map(SystemId);
            systems.find(|system| *system != own.system && !is_taken(*system)).unwrap_or(preferred)
        } else {
            preferred
        };
        Address { system, component: VEHICLE_COMPONENT }
    }

    pub(crate) fn record_contact(&mut self, index: RobotIndex, endpoint: Endpoint, now: Timestamp<HostClock>) {
        let robot = &mut self.robots[index];
        if !robot.is_alive(now) {
            self.presence_until = None;
        }
        robot.last_seen = Some((endpoint, now));
    }

    pub(crate) fn is_any_alive(&self, now: Timestamp<HostClock>) -> bool {
        self.robots.iter().any(|robot| robot.is_alive(now))
    }

    /// The peers of a link with other robots that have the same ids.
    pub(crate) fn namesake_peers(&self, index: RobotIndex, link: LinkId) -> Vec<PeerId> {
        let robot = self.get(index);
        let namesakes = self.identities.at_home(robot.id.link, robot.wire_address);
        namesakes.filter(|other| *other != index).filter_map(|other| self.identities.peer_on(other, link)).collect()
    }

    /// Whether several robots of a link have this address.
    pub(crate) fn is_shared(&self, home: LinkId, address: Address) -> bool {
        !self.robots_with_shared_address.is_empty() && self.identities.at_home(home, address).nth(1).is_some()
    }

    /// Robots with a shared address that were lost, with their silence, or have returned.
    pub(crate) fn take_namesake_changes(&mut self, now: Timestamp<HostClock>) -> Vec<(RobotId, Option<TimeDelta>)> {
        let mut changes = Vec::new();
        for (index, is_lost) in &mut self.robots_with_shared_address {
            let robot = &self.robots[*index];
            if robot.is_alive(now) == *is_lost
                && let Some((_, last_seen)) = robot.last_seen
            {
                *is_lost = !*is_lost;
                changes.push((robot.id, is_lost.then(|| now - last_seen)));
            }
        }
        changes
    }

    /// Whether a robot may have appeared, been lost or returned since the last call.
    pub(crate) fn take_presence_change(&mut self, now: Timestamp<HostClock>) -> bool {
        if self.presence_until.is_some_and(|until| now < until) {
            return false;
        }
        let alive = self.robots.iter().filter(|robot| robot.is_alive(now));
        let ends = alive.filter_map(|robot| robot.last_seen.map(|(_, last)| last + PEER_TIMEOUT));
        self.presence_until = Some(ends.min().unwrap_or(Timestamp::from_nanos(i64::MAX)));
        true
    }

    /// The robots of a link, or of one that is redundant to it.
    pub(crate) fn at_home(&self, link: LinkId, router: &FrameRouter) -> &[RobotIndex] {
        self.by_link.get(&router.first_of_group(link)).map_or(&[], Vec::as_slice)
    }

    /// Sets the interval that a peer requests for a message of one robot, or of all robots.
    pub(crate) fn set_interval(
        &mut self,
        robot: Option<RobotIndex>,
        link: LinkId,
        message_id: u32,
        interval: Option<TimeDelta>,
    ) {
        if let Some(index) = robot {
            self.robots[index].publisher.set_interval(link, message_id, interval);
            return;
        }
        if OutputKind::of_message(message_id).is_none() {
            return;
        }
        self.intervals.retain(|(of_link, of_message, _)| (*of_link, *of_message) != (link, message_id));
        self.intervals.push((link, message_id, interval));
        for robot in &mut self.robots {
            robot.publisher.set_interval(link, message_id, interval);
        }
    }

    /// Sets or forgets the pose of the first robot; before one is detected that applies to the first one that will be.
    pub(crate) fn keep_first_pose(&mut self, pose: Option<StartPose>) {
        if self.len() == 0 {
            self.settings.first_pose = pose;
        }
    }
}

/// Robots in the order of their table, each once. Usually holds one, for the duration of an input; it keeps its memory.
#[derive(Debug, Default)]
pub(crate) struct OrderedQueue(VecDeque<RobotIndex>);

impl OrderedQueue {
    pub(crate) fn insert(&mut self, index: RobotIndex) {
        if let Err(position) = self.0.binary_search(&index) {
            self.0.insert(position, index);
        }
    }

    pub(crate) fn pop_first(&mut self) -> Option<RobotIndex> {
        self.0.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{RobotBlock, RobotMatch};
    use crate::test_config::config;
    use posebridge_telemetry::PeerId;

    const HOME: LinkId = LinkId(0);

    /// A table whose robots have sent in this order, each from a peer of its own.
    fn table_of(config: &StationConfig, addresses: &[Address]) -> RobotTable {
        let mut table = RobotTable::new(config).unwrap();
        for (peer, address) in (0..).zip(addresses) {
            let endpoint = Endpoint { link: HOME, peer: PeerId(peer) };
            let origin = MessageOrigin { endpoint, home: HOME, address: *address, is_new: true, is_telemetry: true };
            table.adopt(Timestamp::ZERO, origin, config, &mut Observers::default()).unwrap();
        }
        table
    }

    #[test]
    fn each_robot_is_announced_under_a_system_of_its_own() {
        let config = StationConfig { own_address: Address::new(3, 190), ..config() };
        let addresses =
            [(1, 1), (1, 2), (2, 1), (1, 1), (4, 7)].map(|(system, component)| Address::new(system, component));
        let table = table_of(&config, &addresses);
        let announced: Vec<u8> = table.detected().iter().map(|robot| robot.vehicle_address.system.0).collect();
        // 3 is the station's own.
        assert_eq!(announced, [1, 2, 4, 5, 6]);
        let ids: Vec<Address> = table.detected().iter().map(|robot| robot.id.address).collect();
        assert_eq!(ids, [(1, 1), (1, 2), (2, 1), (5, 1), (4, 7)].map(|(system, id)| Address::new(system, id)));
        let elsewhere = Endpoint { link: LinkId(9), peer: PeerId(0) };
        let in_system = |system| table.of_fix(&config, elsewhere, Address::new(system, 100), None, None);
        assert_eq!([1, 2].map(in_system), [None, Some(2)], "there are two in the first");
    }

    #[test]
    fn a_fix_of_a_tag_is_for_the_robot_that_has_it_alone() {
        let mut config = config();
        for (system, tag) in [(1, 7), (2, 8), (3, 7)] {
            let matches = RobotMatch { system: Some(SystemId(system)), ..RobotMatch::default() };
            let robot = RobotConfig { tag: Some(tag), ..config.robot.clone() };
            config.robots.push(RobotBlock { matches, robot });
        }
        let robots = [1, 2, 3].map(|system| Address::new(system, 1));
        // No robot has tag 9. Beside one robot a fix without a tag is for that robot.
        for (received, of_none, expected) in [
            (1, Some(0), [Some(0), None, None]),
            (2, Some(0), [Some(0), Some(1), None]),
            (3, Some(0), [None, Some(1), None]),
        ] {
            let table = table_of(&config, &robots[..received]);
            let of_fix =
                |tag| table.of_fix(&config, Endpoint { link: HOME, peer: PeerId(0) }, Address::new(9, 100), tag, None);
            assert_eq!(of_fix(None), of_none, "{received}");
            assert_eq!([7, 8, 9].map(|tag| of_fix(Some(tag))), expected, "{received}");
        }
    }
}
