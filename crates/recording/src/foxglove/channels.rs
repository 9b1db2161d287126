//! The output channels of a recording, each with its schema.

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;

use super::records;
use super::robot_truth::RobotTruthRecord;
use crate::container::TRUTH_TOPIC;

/// A channel beside the inputs.
#[derive(Clone, Copy, Debug)]
pub struct Channel {
    /// Its topic.
    pub topic: &'static str,
    /// Name of its schema; Foxglove and its like know a `foxglove.*` message by it.
    pub schema: &'static str,
    /// How its messages are encoded.
    pub(crate) encoding: Encoding,
}

/// How the messages of a channel are encoded, with the text or bytes of their schema.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Encoding {
    /// Protocol buffers: a serialised `FileDescriptorSet`.
    Protobuf(&'static [u8]),
    /// JSON: makes a JSON schema.
    Json(fn() -> String),
}

impl Encoding {
    /// The message encoding, and the encoding and the data of the schema, as the MCAP registry names them.
    pub(crate) fn parts(self) -> (&'static str, &'static str, Vec<u8>) {
        match self {
            Self::Protobuf(descriptors) => ("protobuf", "protobuf", descriptors.to_vec()),
            Self::Json(schema) => ("json", "jsonschema", schema().into_bytes()),
        }
    }
}

macro_rules! foxglove {
    ($topic:literal, $message:literal) => {
        Channel {
            topic: $topic,
            schema: concat!("foxglove.", $message),
            encoding: Encoding::Protobuf(include_bytes!(concat!("descriptors/", $message, ".bin"))),
        }
    };
}

const fn json(topic: &'static str, schema: &'static str, text: fn() -> String) -> Channel {
    let encoding = Encoding::Json(text);
    Channel { topic, schema, encoding }
}

pub(super) const ODOMETRY: Channel = foxglove!("/posebridge/odometry", "Odometry");
pub(super) const POSE: Channel = foxglove!("/posebridge/pose", "PoseInFrame");
pub(super) const PATH: Channel = foxglove!("/posebridge/path", "PosesInFrame");
pub(super) const ELLIPSE: Channel = foxglove!("/posebridge/ellipse", "SceneUpdate");
pub(super) const TRANSFORM: Channel = foxglove!("/tf", "FrameTransform");
pub(super) const FIX: Channel = foxglove!("/camera/fix", "PoseInFrame");
pub(super) const LOG: Channel = foxglove!("/log", "Log");
pub(super) const TRUE_POSE: Channel = foxglove!("/truth/pose", "PoseInFrame");

pub(super) const ESTIMATE: Channel =
    json("posebridge/estimate", "posebridge.Estimate", schema_of::<records::EstimateRecord>);
pub(super) const FUSION: Channel = json("posebridge/fusion", "posebridge.Fusion", schema_of::<records::FusedRecord>);
pub(super) const LINK_HEALTH: Channel =
    json("posebridge/link_health", "posebridge.LinkHealth", schema_of::<records::HealthRecord>);
pub(super) const CLOCK: Channel = json("posebridge/clock", "posebridge.Clock", schema_of::<records::ClockRecord>);
pub(super) const CALIBRATION: Channel =
    json("posebridge/calibration", "posebridge.Calibration", schema_of::<records::CalibrationRecord>);
pub(super) const TEMPERATURE: Channel =
    json("posebridge/temperature", "posebridge.Temperature", schema_of::<records::TemperatureRecord>);
pub(super) const COMMAND: Channel =
    json("posebridge/command", "posebridge.Command", schema_of::<records::CommandRecord>);
pub(super) const GAP: Channel = json("posebridge/gap", "posebridge.Gap", schema_of::<records::GapRecord>);
pub(super) const TRUTH: Channel = json(TRUTH_TOPIC, "posebridge.Truth", schema_of::<records::TruthRecord>);
/// [`TRUTH`] where the samples say which robot they are of; without, a recording of one robot has the bytes that it always had.
pub(super) const ROBOT_TRUTH: Channel = json(TRUTH_TOPIC, "posebridge.Truth", schema_of::<RobotTruthRecord>);

/// Every channel beside the inputs.
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

/// The JSON schema of a record, without references: not every viewer follows them.
fn schema_of<T: JsonSchema>() -> String {
    let settings = SchemaSettings::draft07().for_serialize().with(|settings| settings.inline_subschemas = true);
    let schema = settings.into_generator().into_root_schema_for::<T>();
    schema.to_value().to_string()
}
