//! The output channels of a recording with their schemas, and their messages.

use std::borrow::Cow;
use std::sync::Arc;

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
    /// The last part of the topic, for messages of a filter that runs beside the robot's own.
    pub(crate) filter: Option<&'static str>,
    pub(crate) data: Vec<u8>,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ChannelKey {
    topic: &'static str,
    robot: Option<Arc<str>>,
    filter: Option<&'static str>,
}

impl EncodedMessage {
    pub(crate) fn key(&self) -> ChannelKey {
        let robot = self.channel.robot_topic.and_then(|_| self.robot.clone());
        ChannelKey { topic: self.channel.topic, robot, filter: self.filter }
    }

    pub(crate) fn topic(&self) -> Cow<'static, str> {
        let topic = match (&self.robot, self.channel.robot_topic) {
            (Some(robot), Some(topic)) => Cow::Owned(format!("/robots/{robot}/{topic}")),
            (None, _) | (_, None) => Cow::Borrowed(self.channel.topic),
        };
        match self.filter {
            Some(filter) => Cow::Owned(format!("{topic}/{filter}")),
            None => topic,
        }
    }
}

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

const fn json(
    topic: &'static str,
    robot_topic: Option<&'static str>,
    schema: &'static str,
    text: fn() -> String,
) -> Channel {
    Channel { topic, robot_topic, schema, encoding: Encoding::Json(text) }
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
    json("posebridge/estimate", Some("estimate"), "posebridge.Estimate", || records::ESTIMATE.schema());
pub(super) const FUSION: Channel =
    json("posebridge/fusion", Some("fusion"), "posebridge.Fusion", || records::FUSION.schema());
pub(super) const QUANTITY: Channel =
    json("posebridge/quantity", Some("quantity"), "posebridge.Quantity", || records::QUANTITY.schema());
/// The name of the filter is the last part of the topic.
pub(super) const COMPARED_ESTIMATE: Channel =
    json("posebridge/compared_estimate", Some("compared_estimate"), "posebridge.Estimate", || {
        records::ESTIMATE.schema()
    });
pub(super) const COMPARED_FUSION: Channel =
    json("posebridge/compared_fusion", Some("compared_fusion"), "posebridge.Fusion", || records::FUSION.schema());
pub(super) const LINK_HEALTH: Channel =
    json("posebridge/link_health", None, "posebridge.LinkHealth", || records::LINK_HEALTH.schema());
pub(super) const CLOCK: Channel =
    json("posebridge/clock", Some("clock"), "posebridge.Clock", || records::CLOCK.schema());
pub(super) const CALIBRATION: Channel =
    json("posebridge/calibration", Some("calibration"), "posebridge.Calibration", || records::CALIBRATION.schema());
pub(super) const TEMPERATURE: Channel =
    json("posebridge/temperature", Some("temperature"), "posebridge.Temperature", || records::TEMPERATURE.schema());
pub(super) const COMMAND: Channel =
    json("posebridge/command", None, "posebridge.Command", || records::COMMAND.schema());
pub(super) const GAP: Channel = json("posebridge/gap", None, "posebridge.Gap", || records::GAP.schema());
pub(super) const TRUTH: Channel = json(TRUTH_TOPIC, None, "posebridge.Truth", || records::TRUTH.schema());
/// [`TRUTH`] with the robot's id, for samples that have one. Samples without keep the older format.
pub(super) const ROBOT_TRUTH: Channel = json(TRUTH_TOPIC, None, "posebridge.Truth", || records::ROBOT_TRUTH.schema());

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
    QUANTITY,
    COMPARED_ESTIMATE,
    COMPARED_FUSION,
    LINK_HEALTH,
    CLOCK,
    CALIBRATION,
    TEMPERATURE,
    COMMAND,
    GAP,
    TRUTH,
];
