//! The configuration of a station as plain values: the program parses and merges the files.

use std::collections::BTreeMap;

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::thermometer::ThermometerSettings;
use posebridge_protocol::bricks::{BrickProtocol, CodecSettings};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_protocol::routing::{ForwardPolicy, LinkRules, RouterConfig};
use posebridge_protocol::signing::SigningConfig;
use posebridge_telemetry::{
    Address, Body, ChannelName, ComponentId, GeodeticOrigin, LinkId, Point2, SystemId, TimeDelta, Wiring,
};

use crate::sender_pins::PinPolicy;

/// The configuration of a station. The same configuration and the same inputs give the same outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct StationConfig {
    /// On every link.
    pub own_address: Address,
    /// For every robot without a matching block in `robots`.
    pub robot: RobotConfig,
    /// Robots with a configuration of their own; the first block that matches is used.
    pub robots: Vec<RobotBlock>,
    /// Most robots of a session; further ones are not followed, which is reported.
    pub max_robots: usize,
    /// The only system that may be a robot; `None` accepts every sender of odometry.
    pub robot_system: Option<SystemId>,
    /// Where the arena lies on the Earth, if that is known.
    pub origin: Option<GeodeticOrigin>,
    /// Who decides which robots this station owns.
    pub ownership: OwnershipPolicy,
    pub fix_requests: FixRequestConfig,
    /// Interval of time requests to brick and camera, after the first replies.
    pub timesync_period: TimeDelta,
    /// What every other robot is asked to send.
    pub brick_message_intervals: Vec<(u32, TimeDelta)>,
    /// What every autopilot of a dialect of its own is asked to send.
    pub autopilot_message_intervals: Vec<(u32, TimeDelta)>,
    /// How long a frame is remembered to detect duplicates from other endpoints; zero turns this off.
    pub duplicate_window: TimeDelta,
    pub links: Vec<LinkConfig>,
}

/// Who decides which robots a station owns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OwnershipPolicy {
    /// Nobody: the station sends to every robot that it hears.
    #[default]
    Unmanaged,
    /// A fleet: a robot is sent nothing until [`Input::Ownership`](posebridge_telemetry::Input::Ownership) says that it is owned here.
    Fleet,
}

/// The configuration of one robot, or of all robots without a block of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotConfig {
    pub name: Option<String>,
    /// Name of a row of [`posebridge_estimator::FILTERS`].
    pub filter: String,
    /// Filters that run beside it; their estimates are not sent.
    pub compared_filters: Vec<String>,
    /// Geometry, noise, start and tunables of the filter.
    pub filter_config: FilterConfig,
    /// How its sensors are connected; what a message says is corrected by it.
    pub wiring: Wiring,
    pub rpm: RpmMeaning,
    /// Whether the robot's own description replaces the configured geometry.
    pub description: DescriptionPolicy,
    /// Position of the camera's tag on the robot, if fixes are of a tag and not of mid-axle.
    pub tag_in_body: Point2<Body>,
    /// The tag's number in fixes.
    pub tag: Option<u32>,
    /// The dynamics of its thermometers, by channel; others are learned. Bricks that are no robots have thermometers,
    /// too, with the configuration of the block that matches them.
    pub thermometers: Vec<ThermometerConfig>,
    /// Whether it drives to the goals of plans.
    pub goals: GoalPolicy,
}

/// What turns with the speeds of a robot's RPM message: engines and rotors as often as wheels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RpmMeaning {
    /// Not known: the message is not used.
    #[default]
    Unknown,
    /// The left and the right wheel, forward positive.
    Wheels,
}

/// The configuration of the robots that match.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotBlock {
    pub matches: RobotMatch,
    pub robot: RobotConfig,
}

/// The robots to which a block applies: all given conditions must hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotMatch {
    /// The robot's link, or one that is redundant to it.
    pub link: Option<LinkId>,
    pub system: Option<SystemId>,
    pub component: Option<ComponentId>,
}

impl RobotMatch {
    /// Whether the block applies to a robot on a link with an address, that of its own frames.
    pub(crate) fn is_for(self, link: LinkId, address: Address) -> bool {
        self.link.is_none_or(|required| required == link)
            && self.system.is_none_or(|required| required == address.system)
            && self.component.is_none_or(|required| required == address.component)
    }
}

impl StationConfig {
    /// The configuration of the robots of a block, by its index in `robots`; `None` is that of robots without a block.
    pub(crate) fn robot_config(&self, block: Option<usize>) -> &RobotConfig {
        block.map_or(&self.robot, |block| &self.robots[block].robot)
    }

    /// The part of the configuration for the router.
    pub(crate) fn router_config(&self) -> RouterConfig {
        let rules = self.links.iter().map(|link| {
            let mut rules = link.rules.clone();
            // A robot without MAVLink would take the others' frames for noise.
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
    #[error("link id {id} is used twice")]
    DuplicateLink { id: LinkId },
}

/// When to request a fix from cameras: if the estimate is less certain than this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixRequestConfig {
    /// Threshold of the position's standard deviation, the larger of both axes.
    pub above_m: Option<f64>,
    /// Threshold of the heading's standard deviation.
    pub above_rad: Option<f64>,
    /// Shortest time between two requests.
    pub interval: TimeDelta,
}

impl Default for FixRequestConfig {
    fn default() -> Self {
        Self { above_m: None, above_rad: None, interval: TimeDelta::from_millis(250) }
    }
}

/// The configuration of one thermometer.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerConfig {
    pub channel: ChannelName,
    pub settings: ThermometerSettings,
}

/// The blocks by the system that they match, so that in a class with one block per robot only a few are tested.
#[derive(Debug)]
pub(crate) struct RobotBlockIndex {
    /// Indices of blocks, in their order; the key `None` has those that match any system.
    by_system: BTreeMap<Option<SystemId>, Vec<usize>>,
}

impl RobotBlockIndex {
    pub(crate) fn new(blocks: &[RobotBlock]) -> Self {
        let mut by_system: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (index, block) in blocks.iter().enumerate() {
            by_system.entry(block.matches.system).or_default().push(index);
        }
        Self { by_system }
    }

    /// The first block for the robot on a link with an address, that of its own frames; `None` if there is none.
    /// `blocks` are those from which this index was made.
    pub(crate) fn find(&self, blocks: &[RobotBlock], link: LinkId, address: Address) -> Option<usize> {
        let first = |system| {
            let indices = self.by_system.get(&system)?;
            indices.iter().copied().find(|index| blocks[*index].matches.is_for(link, address))
        };
        [Some(address.system), None].into_iter().filter_map(first).min()
    }
}

/// Whether a robot's own description is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptionPolicy {
    /// The configured geometry is used.
    Ignore,
    /// The robot's description replaces it.
    Adopt,
}

/// Whether a robot drives to goals, which are sent as SET_POSITION_TARGET_LOCAL_NED. One without MAVLink never does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GoalPolicy {
    /// As [`LinkConfig::robots_take_goals`] says of its link.
    #[default]
    ByLink,
    Accept,
    Refuse,
}

/// One link and its outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkConfig {
    pub id: LinkId,
    /// The brick at its other end, if that does not use MAVLink. Then only `outputs` applies of the following fields,
    /// and nothing is forwarded from it to other links.
    pub brick: Option<BrickLink>,
    pub framing: TransportKind,
    pub accepted_versions: AcceptedVersions,
    /// The MAVLink version of the station's frames on it; messages with ids above 255, our own among them, do not exist
    /// in MAVLink 1.
    pub send_version: WireVersion,
    pub outputs: Vec<OutputStream>,
    /// The components as which the station sends on it.
    pub announced_as: AnnouncedAs,
    /// `None` accepts all senders and signs nothing.
    pub signing: Option<SigningConfig>,
    /// Who may speak for a robot; `None` goes by what senders do.
    pub pin: Option<PinPolicy>,
    /// Routing between it and the other links.
    pub rules: LinkRules,
    /// Robots that are heard on it drive to goals, unless their configuration says otherwise.
    pub robots_take_goals: bool,
}

impl LinkConfig {
    /// Whether a robot that is heard on it takes goals.
    pub(crate) fn takes_goals(&self, policy: GoalPolicy) -> bool {
        let is_chosen = match policy {
            GoalPolicy::ByLink => self.robots_take_goals,
            GoalPolicy::Accept => true,
            GoalPolicy::Refuse => false,
        };
        is_chosen && self.brick.is_none()
    }
}

/// A brick with a protocol other than MAVLink.
#[derive(Clone, Debug)]
pub struct BrickLink {
    /// A row of [`BRICK_PROTOCOLS`](posebridge_protocol::bricks::BRICK_PROTOCOLS).
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
    #[default]
    Station,
    /// Also as the robot: ground stations show a vehicle only if component 1 of its system sends. For links without the
    /// robot itself.
    StationAndVehicle,
}

/// Which MAVLink versions a link accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AcceptedVersions {
    V2,
    V1AndV2,
}

/// A kind of message that is sent on a link with new estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputStream {
    pub kind: OutputKind,
    /// Shortest time between two of them; zero sends one with every estimate.
    pub interval: TimeDelta,
    pub instant: OutputInstant,
}

/// The messages that can carry an estimate or a fusion record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum OutputKind {
    /// PB_PLANAR_POSE, compact.
    PlanarPose,
    Odometry,
    LocalPosition,
    Attitude,
    EstimatorStatus,
    /// PB_FUSION_HEALTH, one per observation that was compared with a prediction.
    FusionHealth,
    /// DISTANCE_SENSOR, the robot's range as observed.
    DistanceSensor,
    /// NAMED_VALUE_FLOAT, the NIS of each sensor.
    NamedValue,
    /// DEBUG_FLOAT_ARRAY, innovation, NIS and expected standard deviations of each sensor.
    FloatArray,
    /// GLOBAL_POSITION_INT, where the arena has a place on the Earth.
    GlobalPosition,
    /// VFR_HUD.
    HeadUpDisplay,
    AttitudeQuaternion,
}

/// One row of [`OUTPUTS`].
#[derive(Clone, Copy, Debug)]
pub struct OutputInfo {
    /// In the configuration.
    pub name: &'static str,
    pub kind: OutputKind,
    /// A peer may set the interval of this message with SET_MESSAGE_INTERVAL, for its own link.
    pub message_id: u32,
}

/// Every output.
pub const OUTPUTS: &[OutputInfo] = &[
    OutputInfo { name: "planar_pose", kind: OutputKind::PlanarPose, message_id: ids::PB_PLANAR_POSE },
    OutputInfo { name: "odometry", kind: OutputKind::Odometry, message_id: ids::ODOMETRY },
    OutputInfo { name: "local_position", kind: OutputKind::LocalPosition, message_id: ids::LOCAL_POSITION_NED },
    OutputInfo { name: "attitude", kind: OutputKind::Attitude, message_id: ids::ATTITUDE },
    OutputInfo { name: "estimator_status", kind: OutputKind::EstimatorStatus, message_id: ids::ESTIMATOR_STATUS },
    OutputInfo { name: "fusion_health", kind: OutputKind::FusionHealth, message_id: ids::PB_FUSION_HEALTH },
    OutputInfo { name: "distance_sensor", kind: OutputKind::DistanceSensor, message_id: ids::DISTANCE_SENSOR },
    OutputInfo { name: "named_value_float", kind: OutputKind::NamedValue, message_id: ids::NAMED_VALUE_FLOAT },
    OutputInfo { name: "debug_float_array", kind: OutputKind::FloatArray, message_id: ids::DEBUG_FLOAT_ARRAY },
    OutputInfo { name: "global_position", kind: OutputKind::GlobalPosition, message_id: ids::GLOBAL_POSITION_INT },
    OutputInfo { name: "vfr_hud", kind: OutputKind::HeadUpDisplay, message_id: ids::VFR_HUD },
    OutputInfo {
        name: "attitude_quaternion",
        kind: OutputKind::AttitudeQuaternion,
        message_id: ids::ATTITUDE_QUATERNION,
    },
];

impl OutputKind {
    /// `None` if no output has this message.
    pub(crate) fn of_message(message_id: u32) -> Option<Self> {
        OUTPUTS.iter().find(|output| output.message_id == message_id).map(|output| output.kind)
    }

    pub(crate) fn message_id(self) -> u32 {
        OUTPUTS.iter().find(|output| output.kind == self).map_or(0, |output| output.message_id)
    }
}

/// The instant for which an estimate is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputInstant {
    /// The last observation's.
    Observed,
    /// The predicted arrival's.
    Arrival,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::config;
    use posebridge_telemetry::ComponentId;

    #[test]
    fn every_output_has_a_message_of_its_own() {
        for output in OUTPUTS {
            assert_eq!(OutputKind::of_message(output.kind.message_id()), Some(output.kind), "{}", output.name);
        }
    }

    #[test]
    fn the_block_is_the_first_of_all_that_match() {
        let mut config = config();
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
