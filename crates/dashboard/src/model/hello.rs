//! The first message of a stream: what does not change, and the last minute.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Frame;

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
    /// The simulated brick, `null` if the station has none of its own.
    pub simulator: Option<SimulatorFacts>,
    /// Sensors that were heard.
    pub sources: Vec<SourceRow>,
    /// Every tunable.
    pub parameters: Vec<ParameterRow>,
    /// Robots that were heard.
    pub robots: Vec<RobotRow>,
    /// Recordings of this run.
    pub recordings: Vec<RecordingRow>,
    /// The last minute, thinned.
    pub history: Frame,
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
