//! What a station is built from. Plain values: parsing and merging of files is the program's business.

use std::collections::BTreeMap;

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::thermometer::ThermometerSettings;
use posebridge_protocol::bricks::{BrickProtocol, CodecSettings};
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_protocol::routing::{ForwardPolicy, LinkRules, RouterConfig};
use posebridge_protocol::signing::SigningConfig;
use posebridge_telemetry::{Address, Body, ChannelName, ComponentId, LinkId, Point2, SystemId, TimeDelta};

/// Everything that decides what a station does with its inputs. Same configuration and same inputs: same outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct StationConfig {
    /// The station's own address on every link.
    pub own_address: Address,
    /// Every robot that no block of `robots` is for.
    pub robot: RobotConfig,
    /// Robots with a configuration of their own; the first block that matches counts.
    pub robots: Vec<RobotBlock>,
    /// Most robots of a session; those beyond are not followed, and that is reported.
    pub max_robots: usize,
    /// The only system that may be a robot; `None` takes every sender of odometry.
    pub robot_system: Option<SystemId>,
    /// When cameras are asked for a fix.
    pub fix_requests: FixRequestConfig,
    /// How often to ask the brick and the camera for their time, once the first answers are in.
    pub timesync_period: TimeDelta,
    /// Messages that the brick is asked to send, with their interval.
    pub brick_message_intervals: Vec<(u32, TimeDelta)>,
    /// How long a frame is remembered, to know it again when it comes by another way; zero turns this off.
    pub duplicate_window: TimeDelta,
    /// The links, by id.
    pub links: Vec<LinkConfig>,
}

/// What is known about one robot, or about all that have no block of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotConfig {
    /// What people call it.
    pub name: Option<String>,
    /// Name of a row of [`posebridge_estimator::FILTERS`].
    pub filter: String,
    /// Geometry, noise, start and tunables of the filter.
    pub filter_config: FilterConfig,
    /// Whether the robot's own description replaces the configured geometry.
    pub description: DescriptionPolicy,
    /// Where the camera's tag sits on the robot, if fixes are of a tag and not of mid-axle.
    pub tag_in_body: Point2<Body>,
    /// The tag's number, by which fixes name the robot.
    pub tag: Option<u32>,
    /// What is known of its thermometers, by their channels; the others are learnt from what they show. Bricks that are no robots have
    /// thermometers, too: those of the block that matches them.
    pub thermometers: Vec<ThermometerConfig>,
}

/// The configuration of the robots that match.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotBlock {
    pub matches: RobotMatch,
    /// What is known about them.
    pub robot: RobotConfig,
}

/// Which robots a block is for: all that is given must hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotMatch {
    /// The link that it is heard on, or one that is redundant to it.
    pub link: Option<LinkId>,
    pub system: Option<SystemId>,
    pub component: Option<ComponentId>,
}

impl RobotMatch {
    /// Whether it is for a robot that is heard on a link under an address, that of the robot's own frames.
    pub(crate) fn is_for(self, link: LinkId, address: Address) -> bool {
        self.link.is_none_or(|wanted| wanted == link)
            && self.system.is_none_or(|wanted| wanted == address.system)
            && self.component.is_none_or(|wanted| wanted == address.component)
    }
}

impl StationConfig {
    /// What is known about the robots of a block, given by its index in `robots`; `None` stands for robots without a block.
    pub(crate) fn robot_config(&self, block: Option<usize>) -> &RobotConfig {
        block.map_or(&self.robot, |block| &self.robots[block].robot)
    }

    /// What passes between the links.
    pub(crate) fn router_config(&self) -> RouterConfig {
        let rules = self.links.iter().map(|link| {
            let mut rules = link.rules.clone();
            // A robot that speaks no MAVLink would take the others' frames for noise.
            if link.brick.is_some() {
                rules.forward = ForwardPolicy::Disabled;
            }
            (link.id, rules)
        });
        RouterConfig { own: self.own_address, duplicate_window: self.duplicate_window, links: rules.collect() }
    }
}

/// Why a station could not be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    #[error("unknown filter `{name}`; there are: {known}")]
    UnknownFilter { name: String, known: String },
    /// Two links have one id.
    #[error("link id {id} is used twice")]
    DuplicateLink { id: LinkId },
}

/// When cameras that take requests are asked for a fix: as soon as the station is less sure than this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixRequestConfig {
    /// Above this standard deviation of the position, the larger of both axes, in metres.
    pub above_m: Option<f64>,
    /// Above this standard deviation of the heading, in radians.
    pub above_rad: Option<f64>,
    /// Not sooner after the last request.
    pub interval: TimeDelta,
}

impl Default for FixRequestConfig {
    /// No camera is asked.
    fn default() -> Self {
        Self { above_m: None, above_rad: None, interval: TimeDelta::from_millis(250) }
    }
}

/// What is known of one thermometer.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerConfig {
    pub channel: ChannelName,
    /// Its dynamics and noise.
    pub settings: ThermometerSettings,
}

/// The blocks of a configuration by the system that they ask for: in a large room each robot has one, and none is looked at in vain.
#[derive(Debug)]
pub(crate) struct RobotBlockIndex {
    /// Places of blocks, in their order; `None` has those that take any system.
    by_system: BTreeMap<Option<SystemId>, Vec<usize>>,
}

impl RobotBlockIndex {
    pub(crate) fn new(blocks: &[RobotBlock]) -> Self {
        let mut by_system: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (place, block) in blocks.iter().enumerate() {
            by_system.entry(block.matches.system).or_default().push(place);
        }
        Self { by_system }
    }

    /// The first block for the robot that is heard on a link under an address, that of its own frames; `None` if there is none. `blocks`
    /// are those that this was made from.
    pub(crate) fn find(&self, blocks: &[RobotBlock], link: LinkId, address: Address) -> Option<usize> {
        let first = |system| {
            let places = self.by_system.get(&system)?;
            places.iter().copied().find(|place| blocks[*place].matches.is_for(link, address))
        };
        [Some(address.system), None].into_iter().filter_map(first).min()
    }
}

/// Whether a robot's own description is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptionPolicy {
    /// The configured geometry stands.
    Ignore,
    /// The robot's own words replace it.
    Adopt,
}

/// One link and what goes out on it.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkConfig {
    pub id: LinkId,
    /// What is at its other end, if it speaks no MAVLink. Then nothing below counts but `outputs`, and nothing of it is passed on to
    /// other links.
    pub brick: Option<BrickLink>,
    /// How it cuts its bytes.
    pub framing: TransportKind,
    /// MAVLink 1 is accepted only when asked for.
    pub accepted_versions: AcceptedVersions,
    /// The MAVLink version that the station sends there; messages with ids above 255, our own among them, do not exist in MAVLink 1.
    pub send_version: WireVersion,
    pub outputs: Vec<OutputStream>,
    /// The components as which the station sends there.
    pub announced_as: AnnouncedAs,
    /// How its frames are signed; `None` accepts all senders and signs nothing.
    pub signing: Option<SigningConfig>,
    /// What passes between it and the other links.
    pub rules: LinkRules,
}

/// A brick with a protocol of its own.
#[derive(Clone, Debug)]
pub struct BrickLink {
    /// Its protocol, a row of [`BRICK_PROTOCOLS`](posebridge_protocol::bricks::BRICK_PROTOCOLS).
    pub protocol: &'static BrickProtocol,
    pub settings: CodecSettings,
}

impl PartialEq for BrickLink {
    fn eq(&self, other: &Self) -> bool {
        self.protocol.name == other.protocol.name && self.settings == other.settings
    }
}

/// The components as which the station sends on a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AnnouncedAs {
    /// As itself.
    #[default]
    Station,
    /// As the robot, too: ground stations show a vehicle only if component 1 of its system sends. For links on which the robot is not
    /// heard itself.
    StationAndVehicle,
}

/// Which MAVLink versions a link accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AcceptedVersions {
    /// Only MAVLink 2.
    V2,
    /// MAVLink 1 too.
    V1AndV2,
}

/// One kind of message that is sent on a link as estimates come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputStream {
    pub kind: OutputKind,
    /// At least this long between two of them; zero sends one with every estimate.
    pub interval: TimeDelta,
    pub instant: OutputInstant,
}

/// The messages in which an estimate can leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum OutputKind {
    /// PB_PLANAR_POSE, compact.
    PlanarPose,
    /// ODOMETRY.
    Odometry,
    /// LOCAL_POSITION_NED.
    LocalPosition,
    /// ATTITUDE.
    Attitude,
    /// ESTIMATOR_STATUS.
    EstimatorStatus,
    /// PB_FUSION_HEALTH, one per observation that could be held against a prediction.
    FusionHealth,
    /// DISTANCE_SENSOR, the robot's range as it was observed.
    DistanceSensor,
    /// NAMED_VALUE_FLOAT, the NIS of each sensor.
    NamedValue,
    /// DEBUG_FLOAT_ARRAY, innovation, NIS and what was expected of them, of each sensor.
    FloatArray,
}

/// Every output, with the name that the configuration uses.
pub const OUTPUTS: &[(&str, OutputKind)] = &[
    ("planar_pose", OutputKind::PlanarPose),
    ("odometry", OutputKind::Odometry),
    ("local_position", OutputKind::LocalPosition),
    ("attitude", OutputKind::Attitude),
    ("estimator_status", OutputKind::EstimatorStatus),
    ("fusion_health", OutputKind::FusionHealth),
    ("distance_sensor", OutputKind::DistanceSensor),
    ("named_value_float", OutputKind::NamedValue),
    ("debug_float_array", OutputKind::FloatArray),
];

/// For which instant an estimate is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputInstant {
    /// That of the last observation.
    Observed,
    /// That at which it will arrive, by prediction.
    Arrival,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::station_config;
    use posebridge_telemetry::ComponentId;

    #[test]
    fn the_block_is_the_first_of_all_that_match() {
        let mut config = station_config();
        let links = [None, Some(LinkId(1)), Some(LinkId(2))];
        let systems = [Some(SystemId(3)), None, Some(SystemId(1))];
        let components = [Some(ComponentId(1)), Some(ComponentId(2)), None];
        for (tag, number) in (0_u32..).zip((0..27).map(|k: usize| k * 10 % 27)) {
            let matches = RobotMatch {
                link: links[number % 3],
                system: systems[number / 3 % 3],
                component: components[number / 9],
            };
            config.robots.push(RobotBlock { matches, robot: RobotConfig { tag: Some(tag), ..config.robot.clone() } });
        }
        for blocks in (0..=27).rev() {
            config.robots.truncate(blocks);
            let index = RobotBlockIndex::new(&config.robots);
            for (link, system, component) in (0..64).map(|k| (LinkId(k % 4), (k / 4 % 4) as u8, (k / 16) as u8)) {
                let address = Address::new(system, component);
                let first = config.robots.iter().position(|block| block.matches.is_for(link, address));
                assert_eq!(index.find(&config.robots, link, address), first);
            }
        }
    }
}
