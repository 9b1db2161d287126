//! The latest of everything, for programs that ask now and then.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ClockRow, ErrorsRow, EstimatePoint, LinkRow, Number, RecordingNow, TruthPoint};

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
