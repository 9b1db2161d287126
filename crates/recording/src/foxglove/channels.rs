//! The output channels of a recording with their schemas, and their messages.

use std::borrow::Cow;
use std::sync::Arc;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;

use super::records;
use crate::container::TRUTH_TOPIC;

/// An output channel.
#[derive(Clone, Copy, Debug)]
pub struct Channel {
    /// The topic of the first robot, where each robot has a channel.
    pub topic: &'static str,
    /// Topic suffix of another robot, after `/robots/` and its name; `None` where one channel is for all robots.
    pub robot_topic: Option<&'static str>,
    /// Viewers such as Foxglove recognise a `foxglove.*` message by it.
    pub schema: &'static str,
    pub(crate) encoding: Encoding,
}

#[derive(Debug)]
pub(crate) struct EncodedMessage {
    pub(crate) channel: Channel,
    /// The robot's name in the topic; `None` for the first.
    pub(crate) robot: Option<Arc<str>>,
    pub(crate) data: Vec<u8>,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ChannelKey {
    topic: &'static str,
    robot: Option<Arc<str>>,
}

impl EncodedMessage {
    pub(crate) fn key(&self) -> ChannelKey {
        let robot = self.channel.robot_topic.and_then(|_| self.robot.clone());
        ChannelKey { topic: self.channel.topic, robot }
    }

    pub(crate) fn topic(&self) -> Cow<'static, str> {
        match (&self.robot, self.channel.robot_topic) {
            (Some(robot), Some(topic)) => Cow::Owned(format!("/robots/{robot}/{topic}")),
            (None, _) | (_, None) => Cow::Borrowed(self.channel.topic),
        }
    }
}

/// Message encoding, with the schema.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Encoding {
    /// Protocol buffers: a serialised `FileDescriptorSet`.
    Protobuf(&'static [u8]),
    /// JSON: a function that builds the JSON schema.
    Json(fn() -> String),
}

impl Encoding {
    /// Message encoding, schema encoding and schema data, named as in the MCAP registry.
    pub(crate) fn parts(self) -> (&'static str, &'static str, Vec<u8>) {
        match self {
            Self::Protobuf(descriptors) => ("protobuf", "protobuf", descriptors.to_vec()),
            Self::Json(schema) => ("json", "jsonschema", schema().into_bytes()),
        }
    }
}

macro_rules! foxglove {
    ($topic:literal, $message:literal, $robot_topic:expr) => {
        Channel {
            topic: $topic,
            robot_topic: $robot_topic,
            schema: concat!("foxglove.", $message),
            encoding: Encoding::Protobuf(include_bytes!(concat!("descriptors/", $message, ".bin"))),
        }
    };
}

const fn json(topic: &'static str, schema: &'static str, text: fn() -> String) -> Channel {
    Channel { topic, robot_topic: None, schema, encoding: Encoding::Json(text) }
}

const fn json_of_robot(
    topic: &'static str,
    robot_topic: &'static str,
    schema: &'static str,
    text: fn() -> String,
) -> Channel {
    Channel { robot_topic: Some(robot_topic), ..json(topic, schema, text) }
}

pub(super) const ODOMETRY: Channel = foxglove!("/posebridge/odometry", "Odometry", Some("odometry"));
pub(super) const POSE: Channel = foxglove!("/posebridge/pose", "PoseInFrame", Some("pose"));
pub(super) const PATH: Channel = foxglove!("/posebridge/path", "PosesInFrame", Some("path"));
pub(super) const ELLIPSE: Channel = foxglove!("/posebridge/ellipse", "SceneUpdate", Some("ellipse"));
pub(super) const TRANSFORM: Channel = foxglove!("/tf", "FrameTransform", None);
pub(super) const FIX: Channel = foxglove!("/camera/fix", "PoseInFrame", Some("camera/fix"));
pub(super) const LOG: Channel = foxglove!("/log", "Log", None);
pub(super) const TRUE_POSE: Channel = foxglove!("/truth/pose", "PoseInFrame", Some("truth/pose"));

pub(super) const ESTIMATE: Channel =
    json_of_robot("posebridge/estimate", "estimate", "posebridge.Estimate", schema_of::<records::EstimateRecord>);
pub(super) const FUSION: Channel =
    json_of_robot("posebridge/fusion", "fusion", "posebridge.Fusion", schema_of::<records::FusedRecord>);
pub(super) const LINK_HEALTH: Channel =
    json("posebridge/link_health", "posebridge.LinkHealth", schema_of::<records::HealthRecord>);
pub(super) const CLOCK: Channel =
    json_of_robot("posebridge/clock", "clock", "posebridge.Clock", schema_of::<records::ClockRecord>);
pub(super) const CALIBRATION: Channel = json_of_robot(
    "posebridge/calibration",
    "calibration",
    "posebridge.Calibration",
    schema_of::<records::CalibrationRecord>,
);
pub(super) const TEMPERATURE: Channel = json_of_robot(
    "posebridge/temperature",
    "temperature",
    "posebridge.Temperature",
    schema_of::<records::TemperatureRecord>,
);
pub(super) const COMMAND: Channel =
    json("posebridge/command", "posebridge.Command", schema_of::<records::CommandRecord>);
pub(super) const GAP: Channel = json("posebridge/gap", "posebridge.Gap", schema_of::<records::GapRecord>);
pub(super) const TRUTH: Channel = json(TRUTH_TOPIC, "posebridge.Truth", schema_of::<records::TruthRecord>);
/// [`TRUTH`] with the robot's id, for samples that have one. Samples without keep the older format.
pub(super) const ROBOT_TRUTH: Channel = json(TRUTH_TOPIC, "posebridge.Truth", schema_of::<records::RobotTruthRecord>);

pub const CHANNELS: &[Channel] = &[
    ODOMETRY,
    POSE,
    PATH,
    ELLIPSE,
    TRANSFORM,
    FIX,
    LOG,
    TRUE_POSE,
    ESTIMATE,
    FUSION,
    LINK_HEALTH,
    CLOCK,
    CALIBRATION,
    TEMPERATURE,
    COMMAND,
    GAP,
    TRUTH,
];

/// Without references, because not every viewer resolves them.
fn schema_of<T: JsonSchema>() -> String {
    let settings = SchemaSettings::draft07().for_serialize().with(|settings| settings.inline_subschemas = true);
    let schema = settings.into_generator().into_root_schema_for::<T>();
    schema.to_value().to_string()
}
