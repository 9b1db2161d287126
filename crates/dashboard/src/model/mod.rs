//! The messages for browsers and programs, as plain structs. The JSON schema derives from them.

mod fleet;
mod frame;

pub use fleet::{FleetEstimateRow, FleetOwnerRow, FleetRobotRow, FleetState, FleetStationRow};
pub(crate) use frame::seconds_of;
pub use frame::{
    CalibrationRow, ClockRow, ComparedPoint, ComparisonRow, ErrorsRow, EstimatePoint, FixPoint, Frame, FusionPoint,
    LinkRow, LogLine, Number, OdometryPoint, ParameterValue, QuantityPoint, RecordingNow, RobotFrame, ScorePoint,
    SetupRow, SimulatorNow, TallyPoint, TruthPoint, Word,
};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A message of the station on `/v1/stream`.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum Message {
    /// The first one.
    Hello(Box<Hello>),
    /// What is new.
    Frame(Box<Frame>),
    /// What was wrong with a command that came on this stream.
    Error(Refusal),
}

/// Why a request was refused.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Refusal {
    /// A line for people: what was wrong and what to do.
    pub error: String,
}

/// That a command was handed to the engine; what becomes of it stands in the log.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Accepted {
    /// Its name.
    pub accepted: String,
}

/// The first message.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Hello {
    /// The program's version.
    pub version: String,
    /// The session's time, in seconds.
    pub now_s: f64,
    /// Whether a token is needed to reach this station.
    pub needs_token: bool,
    /// Whether this reader may give commands.
    pub can_command: bool,
    /// The simulated brick, `null` if the station has none of its own.
    pub simulator: Option<SimulatorFacts>,
    /// The name of the station's fleet, `null` if it is in none.
    pub fleet: Option<String>,
    /// What stands in the arena by the configuration.
    pub arena: ArenaRow,
    /// Sensors that were heard.
    pub sources: Vec<SourceRow>,
    /// Every tunable.
    pub parameters: Vec<ParameterRow>,
    /// Robots that were heard.
    pub robots: Vec<RobotRow>,
    /// Recordings of this run.
    pub recordings: Vec<RecordingRow>,
    /// The last minute, thinned; of errors, observations and calibration also the run before it, thinned more.
    pub history: Frame,
}

/// What stands in the arena.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ArenaRow {
    /// Points that a camera can tell apart.
    pub landmarks: Vec<PlaceRow>,
    /// Radio beacons.
    pub beacons: Vec<PlaceRow>,
    /// Straight walls, each from x_m, y_m to x_m, y_m.
    pub walls: Vec<[[f64; 2]; 2]>,
}

/// A landmark or a beacon.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceRow {
    /// The number under which it is seen.
    pub id: u32,
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
}

/// What the simulated brick of this station does.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatorFacts {
    /// The scenario's name.
    pub scenario: String,
    /// The path that it is to drive: x_m, y_m.
    pub path: Vec<[f64; 2]>,
    /// Names for `link-profile`.
    pub link_profiles: Vec<String>,
    /// `odometry` or `estimate`.
    pub steering: String,
    /// The profile that its link is as bad as; `null` for a cable.
    pub link_profile: Option<String>,
}

/// A robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RobotRow {
    /// Link, system and component, e.g. `0/1/1`.
    pub id: String,
    /// Its configured name, `null` without one.
    pub name: Option<String>,
}

/// A sensor.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SourceRow {
    /// The number of `switch-source`.
    pub id: u8,
    /// Its name.
    pub name: String,
    /// The kind of its observations.
    pub kind: String,
    /// Whether the filter uses it; see `switch-source`.
    pub is_used: bool,
}

/// A tunable.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterRow {
    /// Its key in `[filter]`.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its value unless configured.
    pub default: f64,
    /// Lowest value that is taken.
    pub least: f64,
    /// Highest value that is taken.
    pub most: f64,
    /// Its unit, empty for a pure number.
    pub unit: String,
    /// What it does, in one line.
    pub help: String,
    /// Its name in MAVLink's parameter messages.
    pub mavlink_name: String,
}

/// A recording of this run.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingRow {
    /// The name of its file.
    pub name: String,
    /// So large it is.
    pub bytes: u64,
    /// When it was begun, in seconds since 1970 UTC; `null` if the file system does not report it.
    pub begun: Option<u64>,
    /// Whether it is being written.
    pub is_current: bool,
}

/// A camera whose pictures the station searches for tags: one of `GET /v1/cameras`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRow {
    /// Its link, by which `GET /v1/cameras/{link}/picture` shows its last picture.
    pub link: u16,
    /// Its name.
    pub name: String,
    /// Whether it is known where it stands: its tags become fixes.
    pub is_calibrated: bool,
    /// The first and the last tag of the floor sheet.
    pub floor_tags: [u16; 2],
    /// `null` before the first one.
    pub picture: Option<CameraPictureRow>,
}

/// The last searched picture of a camera.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraPictureRow {
    /// So many pictures were searched since the camera was opened.
    pub number: u64,
    /// So many were replaced by newer ones before they were searched.
    pub dropped: u64,
    /// So many could not be decoded.
    pub damaged: u64,
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// Since its search ended.
    pub age_s: f64,
    /// From its reception, or its exposure where that is known, to the end of its search.
    pub latency_s: f64,
    /// The tags in it.
    pub tags: Vec<SeenTagRow>,
}

/// A tag in a picture.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SeenTagRow {
    /// Its number in tag36h11.
    pub id: u16,
    /// The tag's upper left corner first, clockwise, in pixels.
    pub corners: [[f64; 2]; 4],
    /// Mean distance of its bits from the level between black and white, in grey levels; below 10 the light is poor.
    pub margin: f64,
}

/// `GET /v1/state`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// The session's time, in seconds.
    pub now_s: f64,
    /// Each robot.
    pub robots: Vec<RobotState>,
    /// Where the first simulated robot really is.
    pub truth: Option<TruthPoint>,
    /// How far its odometry and its estimate are from that.
    pub errors: Option<ErrorsRow>,
    /// All links.
    pub links: Vec<LinkRow>,
    /// The alignment of the robot's clock.
    pub clock: Option<ClockRow>,
    /// The recording that is being written.
    pub recording: Option<RecordingNow>,
    /// Time from an observation's arrival to its estimate's departure.
    pub latency: LatencyRow,
    /// What was counted.
    pub counters: Counters,
}

/// A robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RobotState {
    /// Link, system and component, e.g. `0/1/1`.
    pub id: String,
    /// Its configured name, `null` without one.
    pub name: Option<String>,
    /// When it was lost, in seconds of the session; `null` while it is heard.
    pub lost_t_s: Option<f64>,
    /// Its last estimate.
    pub estimate: Option<EstimatePoint>,
    /// The last of each quantity; absent without any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub quantities: Vec<QuantityPoint>,
    /// Where it really is, if it is simulated.
    pub truth: Option<TruthPoint>,
    /// How far its odometry and its estimate are from that.
    pub errors: Option<ErrorsRow>,
}

/// Percentiles of the last estimates' latency.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LatencyRow {
    /// Number of estimates behind it.
    pub estimates: u64,
    /// Median, in milliseconds.
    pub p50_ms: Number,
    /// 99th percentile.
    pub p99_ms: Number,
}

/// What was counted since the session began.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Counters {
    /// Estimates.
    pub estimates: u64,
    /// Events that the dashboard did not receive because it was behind.
    pub events_dropped: u64,
    /// Readers of `/v1/stream` at the moment.
    pub clients: u64,
    /// Messages that readers have missed because they were slow.
    pub frames_missed: u64,
    /// Connections and requests that were refused.
    pub refused: u64,
    /// Commands that were handed to the engine.
    pub commands: u64,
}
