//! The messages for browsers and programs, as plain structs. Their schema is made from them.

mod frame;
mod hello;
mod number;
mod state;

pub use frame::{
    CalibrationRow, ClockRow, ErrorsRow, EstimatePoint, FixPoint, Frame, FusionPoint, LinkRow, LogLine, ParameterValue,
    RecordingNow, RobotFrame, ScorePoint, SimulatorNow, TallyPoint, TruthPoint,
};
pub use hello::{Hello, ParameterRow, RecordingRow, RobotRow, SimulatorFacts, SourceRow};
pub use number::Number;
pub(crate) use number::seconds_of;
pub use state::{Counters, LatencyRow, RobotState, State};

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
