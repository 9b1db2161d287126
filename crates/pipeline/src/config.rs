//! What a pipeline is built from. Plain values: parsing and merging of files is the program's business.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::thermometer::ThermometerSettings;
use posebridge_protocol::bricks::{BrickProtocol, BrickSettings};
use posebridge_protocol::framing::{Framing, WireVersion};
use posebridge_protocol::routing::LinkRules;
use posebridge_protocol::signing::SigningConfig;
use posebridge_telemetry::{Address, Body, ChannelName, LinkId, Point2, Span, SystemId};

/// Everything that decides what a pipeline does with its inputs. Same configuration and same inputs: same outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineConfig {
    /// The station's own address on every link.
    pub own: Address,
    /// Name of a row of [`posebridge_estimator::FILTERS`].
    pub filter: String,
    /// Geometry, noise, start and tunables of the filter.
    pub filter_config: FilterConfig,
    /// Whether a robot's own description replaces the configured geometry.
    pub description: DescriptionPolicy,
    /// Which system is the robot; `None` takes the first that is heard.
    pub robot_system: Option<SystemId>,
    /// Where the camera's tag sits on the robot, if fixes are of a tag and not of mid-axle.
    pub tag_in_body: Point2<Body>,
    /// When cameras are asked for a fix.
    pub fix_requests: FixRequestConfig,
    /// How often to ask the brick and the camera for their time, once the first answers are in.
    pub timesync_period: Span,
    /// Messages that the brick is asked to send, with their interval.
    pub wanted: Vec<(u32, Span)>,
    /// How long a frame is remembered, to know it again when it comes by another way; zero turns this off.
    pub duplicate_window: Span,
    /// What is known of thermometers, by their channels; the others are learnt from what they show.
    pub thermometers: Vec<ThermometerConfig>,
    /// The links, by id.
    pub links: Vec<LinkConfig>,
}

/// When cameras that take requests are asked for a fix: as soon as the station is less sure than this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixRequestConfig {
    /// Above this standard deviation of the position, the larger of both axes, in metres.
    pub above_m: Option<f64>,
    /// Above this standard deviation of the heading, in radians.
    pub above_rad: Option<f64>,
    /// Not sooner after the last request.
    pub interval: Span,
}

impl Default for FixRequestConfig {
    /// Nobody is asked.
    fn default() -> Self {
        Self { above_m: None, above_rad: None, interval: Span::from_millis(250) }
    }
}

/// What is known of one thermometer, whichever brick it sits on.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerConfig {
    /// The channel that it is read by.
    pub channel: ChannelName,
    /// Its dynamics and noise.
    pub settings: ThermometerSettings,
}

/// Whether a robot's own description is believed.
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
    /// Its id.
    pub id: LinkId,
    /// What is at its other end, if it speaks no MAVLink. Then nothing below counts but `outputs`, and nothing of it is passed on to
    /// other links.
    pub brick: Option<BrickLink>,
    /// How it cuts its bytes.
    pub framing: Framing,
    /// MAVLink 1 is accepted only when asked for.
    pub version: AcceptedVersions,
    /// What the station speaks there; messages with ids above 255, our own among them, do not exist in MAVLink 1.
    pub speaks: WireVersion,
    /// What is sent there.
    pub outputs: Vec<OutputStream>,
    /// As whom the station speaks there.
    pub voices: Voices,
    /// How its frames are signed; `None` believes everybody and signs nothing.
    pub signing: Option<SigningConfig>,
    /// What passes between it and the other links.
    pub rules: LinkRules,
}

/// A brick with a protocol of its own.
#[derive(Clone, Debug)]
pub struct BrickLink {
    /// Its protocol, a row of [`BRICKS`](posebridge_protocol::bricks::BRICKS).
    pub protocol: &'static BrickProtocol,
    /// What its codec must be told.
    pub settings: BrickSettings,
}

impl PartialEq for BrickLink {
    fn eq(&self, other: &Self) -> bool {
        self.protocol.name == other.protocol.name && self.settings == other.settings
    }
}

/// As whom the station speaks on a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Voices {
    /// As itself.
    #[default]
    Own,
    /// As the robot, too: ground stations show a vehicle only if component 1 of its system speaks. For links on which the robot is not
    /// heard itself.
    OwnAndRobot,
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
    /// Which message.
    pub kind: OutputKind,
    /// At least this long between two of them; zero sends one with every estimate.
    pub interval: Span,
    /// For which instant.
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
