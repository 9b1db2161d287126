//! The updates since the last message, and the history for a new reader: both have this shape.

use std::borrow::Cow;

use posebridge_telemetry::{HostClock, Timestamp};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smallvec::SmallVec;

/// A word of the program itself. Points of a history borrow it: as strings of their own, thousands of small blocks would come and go
/// in every minute of a session, and the memory would go on growing by the gaps between them.
pub type Word = Cow<'static, str>;

/// What is new.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// The session's time, in seconds.
    pub now_s: f64,
    /// What is new of each robot.
    pub robots: Vec<RobotFrame>,
    /// Where simulated robots really were; absent without news.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub truth: Vec<TruthPoint>,
    /// How far odometry and estimate of the first simulated robot are from the truth; absent without truth or news.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub errors: Option<ErrorsRow>,
    /// All links, once a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub links: Option<Vec<LinkRow>>,
    /// The alignment of the robot's clock, once a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock: Option<ClockRow>,
    /// Lines for people.
    pub log: Vec<LogLine>,
    /// All tunables, when one has changed and once a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameters: Option<Vec<ParameterValue>>,
    /// The numbers of all sources that are left out of the first robot, when that has changed and once a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub switched_off: Option<Vec<u8>>,
    /// Whether filters run beside the one that sends, when that has changed and once a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub is_comparing: Option<bool>,
    /// How the simulated brick was set last, when that has changed and once a second; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<SimulatorNow>,
    /// The set-up checklist of each robot, when it has changed and once a second; absent in a recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setup: Option<Vec<SetupRow>>,
    /// The recording that is being written, `null` if none is; once a second, else absent.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    pub recording: Option<Option<RecordingNow>>,
    /// Number of messages that this reader has missed because it was slow.
    pub dropped: u64,
}

/// A key that is present, `null` or not.
fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    T::deserialize(deserializer).map(Some)
}

impl Frame {
    /// Created if missing.
    pub fn robot(&mut self, id: &str) -> &mut RobotFrame {
        let known = self.robots.iter().position(|robot| robot.id == id);
        let index = known.unwrap_or_else(|| {
            self.robots.push(RobotFrame::of(id));
            self.robots.len() - 1
        });
        &mut self.robots[index]
    }

    pub fn is_empty(&self) -> bool {
        self.robots.is_empty()
            && self.truth.is_empty()
            && self.log.is_empty()
            && self.links.is_none()
            && self.clock.is_none()
            && self.parameters.is_none()
            && self.switched_off.is_none()
            && self.is_comparing.is_none()
            && self.simulator.is_none()
            && self.setup.is_none()
            && self.recording.is_none()
    }
}

/// What is new of one robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RobotFrame {
    /// Link, system and component, e.g. `0/1/1`.
    pub id: String,
    /// Its configured name, when it changes and once a second; absent for a robot without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// When it was lost, in seconds of the session, at once and then once a second; absent while it is heard.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_t_s: Option<f64>,
    /// Estimates, oldest first.
    pub estimates: Vec<EstimatePoint>,
    /// Where its wheels alone say it is, for a robot that is not simulated; absent without news.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub odometry: Vec<OdometryPoint>,
    /// Camera fixes.
    pub fixes: Vec<FixPoint>,
    /// What became of each observation.
    pub fusion: Vec<FusionPoint>,
    /// Estimates against the truth of their instants, where a simulated robot sends it; absent without news.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scores: Vec<ScorePoint>,
    /// How far its odometry and its last estimate are from the truth; absent without truth or news.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub errors: Option<ErrorsRow>,
    /// Positions by the filters that run beside the one that sends, oldest first of each; absent without news.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub compared: Vec<ComparedPoint>,
    /// A distance or a temperature over time: that of a robot whose filter knows one quantity, and the thermometers; absent without news.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub quantities: Vec<QuantityPoint>,
    /// The filters side by side, the one that sends first, once a second; absent while none are compared.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub comparison: Vec<ComparisonRow>,
    /// How many observations came so far, once a second; of a recording one for each second.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tallies: Vec<TallyPoint>,
    /// What was learned about the robot, once a second and when it has changed; of a recording one for each second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Vec<CalibrationRow>>,
    /// The numbers of its sources that are left out, when that has changed and once a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub switched_off: Option<Vec<u8>>,
}

impl RobotFrame {
    fn of(id: &str) -> Self {
        Self { id: id.to_owned(), ..Self::default() }
    }
}

/// An estimate.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct EstimatePoint {
    /// When it was made, in seconds of the session.
    pub t_s: f64,
    /// The estimated instant, in seconds of the robot's clock.
    pub robot_s: f64,
    /// East, in metres.
    pub x_m: Number,
    /// North, in metres.
    pub y_m: Number,
    /// Counter-clockwise from east, in (-pi, pi].
    pub heading_rad: Number,
    /// Half the longer axis of the ellipse that holds the position with 95 %.
    pub major_m: Number,
    /// Half its shorter axis.
    pub minor_m: Number,
    /// Direction of its longer axis.
    pub axis_rad: Number,
    /// One standard deviation of the heading.
    pub heading_sigma_rad: Number,
    /// Forward speed.
    pub forward_m_per_s: Number,
    /// Turn rate, bias removed.
    pub turn_rad_per_s: Number,
    /// Counts jumps that are not motion.
    pub reset_counter: u8,
    /// Nothing absolute has been used for longer than the limit.
    pub is_dead_reckoning: bool,
    /// Time since the last fix that was used; `null` before the first.
    pub fix_age_s: Number,
    /// The pose counts from where the robot's motion was first observed, and not in the arena.
    pub is_relative: bool,
    /// False while the heading may be any.
    pub is_heading_known: bool,
}

/// Dead reckoning by the wheels alone. It begins at the estimate, and again where the estimate is first one in the arena.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct OdometryPoint {
    /// When it was made, in seconds of the session.
    pub t_s: f64,
    /// East, in metres.
    pub x_m: Number,
    /// North, in metres.
    pub y_m: Number,
    /// Counter-clockwise from east, in (-pi, pi].
    pub heading_rad: Number,
    /// It counts from where the robot's motion was first observed, as the estimate does.
    pub is_relative: bool,
}

/// A quantity at an instant: what was read, and what a filter makes of it.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct QuantityPoint {
    /// When it came, in seconds of the session.
    pub t_s: f64,
    /// The name of the thermometer; empty for the quantity of the robot's own filter.
    pub name: String,
    /// The kind of its readings: `wall_range` or `temperature`.
    pub kind: Word,
    /// The unit of reading, estimate and bound; the rate is per second.
    pub unit: Word,
    /// The reading; `null` where the filter predicted without one.
    pub reading: Number,
    /// What became of the reading; empty without one.
    pub verdict: Word,
    /// The estimate, of a thermometer the value that it will show in the end; `null` while the readings do not tell it.
    pub estimate: Number,
    /// Half the width of the interval around the estimate that holds the quantity with 95 %.
    pub bound_95: Number,
    /// Rate of change of the estimate; `null` for a thermometer, whose final value is a constant.
    pub rate_per_s: Number,
    /// Number of the filter's steps so far.
    pub steps: u64,
    /// Number of them by prediction alone: without a reading, or with one that was refused.
    pub predicted: u64,
}

/// The position by a filter that runs beside the one that sends.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ComparedPoint {
    /// When it was made, in seconds of the session.
    pub t_s: f64,
    /// The filter's name.
    pub filter: String,
    /// East, in metres.
    pub x_m: Number,
    /// North, in metres.
    pub y_m: Number,
    /// As of an estimate.
    pub is_relative: bool,
}

/// How a filter does.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ComparisonRow {
    /// The filter's name; empty for the one that sends.
    pub filter: String,
    /// Distance of its last position from the truth of that instant; `null` where no truth is known.
    pub error_m: Number,
    /// Root mean square of these distances since the comparison began.
    pub error_rms_m: Number,
    /// Distance of its last position from that of the filter that sends.
    pub apart_m: Number,
    /// Half the longer axis of the ellipse that holds its position with 95 %.
    pub major_m: Number,
    /// Sum of the normalised innovation squared over the sum of degrees of freedom, since the comparison began.
    pub nis: Number,
    /// Number of observations that it used, and that it gated.
    pub used: u64,
    /// Number of observations that it gated.
    pub gated: u64,
}

/// A fix of a camera.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FixPoint {
    /// When it was used, in seconds of the session.
    pub t_s: f64,
    /// East, in metres.
    pub x_m: Number,
    /// North, in metres.
    pub y_m: Number,
    /// Heading, if the camera measures it.
    pub heading_rad: Number,
    /// The camera's name.
    pub sensor: Word,
    /// What became of it: accepted, gated, too old, malformed, reset to, unused.
    pub verdict: Word,
    /// How far behind the filter's time it was.
    pub lag_s: Number,
}

/// What became of one observation.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FusionPoint {
    /// When it was used, in seconds of the session.
    pub t_s: f64,
    /// The sensor's name.
    pub sensor: Word,
    /// The kind of observation.
    pub kind: Word,
    /// What became of it.
    pub verdict: Word,
    /// How far behind the filter's time it was.
    pub lag_s: Number,
    /// Normalised innovation squared; `null` where nothing was predicted.
    pub nis: Number,
    /// Its degrees of freedom.
    pub dof: u8,
    /// Observed minus predicted, SI units, one number per degree of freedom.
    pub innovation: SmallVec<[Number; 3]>,
    /// One standard deviation of each.
    pub sigma: SmallVec<[Number; 3]>,
}

/// An estimate against the truth of its own instant, by the robot's clock.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ScorePoint {
    /// When the estimate was made, in seconds of the session.
    pub t_s: f64,
    /// Distance of the brick's own dead reckoning from the truth.
    pub odometry_m: Number,
    /// Distance of the estimate from the truth; `null` for as long as no estimate comes.
    pub estimate_m: Number,
    /// Half the longer axis of the ellipse that was to hold the truth with 95 %.
    pub claim_m: Number,
}

/// Number of observations of one kind from a sensor, from the beginning until an instant.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TallyPoint {
    /// That instant, in seconds of the session.
    pub t_s: f64,
    /// The sensor's name.
    pub sensor: Word,
    /// The kind of observation.
    pub kind: Word,
    /// Number that came.
    pub seen: u64,
    /// Number of them that were gated.
    pub gated: u64,
    /// Number of them that came 0.15 s or more behind the filter's time.
    pub late: u64,
    /// Mean normalised innovation squared per degree of freedom of the last 200 used ones; `null` where nothing was predicted.
    pub nis: Number,
    /// What these say of the filter: `too little data`, `consistent`, `over-confident` or `under-confident`.
    pub consistency: Word,
}

/// A step of setting up a robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SetupRow {
    /// The robot's id; empty before any robot is heard.
    pub robot: String,
    /// Its name, such as `link open`.
    pub step: String,
    /// `ok`, `optional`, `waiting` or `problem`; the first two are complete.
    pub state: String,
    /// What was measured.
    pub figure: String,
    /// What to do; empty if nothing.
    pub advice: String,
}

/// Something that was learned about a robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationRow {
    /// When it stood so, in seconds of the session.
    pub t_s: f64,
    /// Its key in `[robot.calibration]`.
    pub name: Word,
    /// The number.
    pub value: f64,
    /// One standard deviation.
    pub sigma: f64,
    /// Its unit, empty for a ratio.
    pub unit: Word,
}

/// Where a simulated robot really was.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TruthPoint {
    /// Its id, link/system/component; absent where the station has one simulated brick: then it is the first robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// In seconds of the session.
    pub t_s: f64,
    /// The same instant in seconds of the robot's clock, as in estimates.
    pub robot_s: f64,
    /// East, in metres.
    pub x_m: Number,
    /// North, in metres.
    pub y_m: Number,
    /// Heading.
    pub heading_rad: Number,
    /// The pose by the brick's own dead reckoning: x_m, y_m, heading_rad.
    pub odometry: Option<[Number; 3]>,
}

/// How far off the truth.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorsRow {
    /// Distance of the brick's own dead reckoning from the truth.
    pub odometry_m: Number,
    /// Distance of the last estimate from the truth at its own instant; `null` when none was compared for a second.
    pub estimate_m: Number,
}

/// How well a link does.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LinkRow {
    /// Its place in the configuration, from 0.
    pub id: u16,
    /// Its URL.
    pub name: String,
    /// `up` or `down`.
    pub state: String,
    /// Received in the last second.
    pub bytes_in_per_s: Number,
    /// Received whole in the last second.
    pub frames_in_per_s: Number,
    /// Frames missing in the sequence numbers since the beginning.
    pub lost: u64,
    /// Received datagrams that the system dropped, because they were not read in time.
    pub kernel_drops: u64,
    /// Received datagrams above the budget of their peer.
    pub flood_drops: u64,
    /// Requests that were not answered, because their peer asks too often.
    pub excess_requests: u64,
    /// Candidates whose checksum did not match.
    pub checksum_errors: u64,
    /// Bytes outside every frame.
    pub garbage_bytes: u64,
    /// Candidates given up because their bytes stopped coming.
    pub stalls: u64,
    /// Frames that wait to be sent.
    pub queued_frames: u32,
    /// Outgoing messages dropped because the link was slow or down, or nobody was connected to it.
    pub drops_out: u64,
    /// Round-trip time of the last answered question for the time.
    pub round_trip_ms: Number,
    /// How far a converted stamp may be off.
    pub clock_uncertainty_ms: Number,
}

/// The alignment of the robot's clock.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ClockRow {
    /// Brick time minus host time.
    pub offset_s: f64,
    /// Rate of the brick's clock against the host's, minus one.
    pub skew_ppm: Number,
    /// Half the distance between the bounds.
    pub uncertainty_ms: Number,
    /// `two-way` where the brick answers questions for its time, else `one-way`.
    pub method: String,
}

/// A line for people.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LogLine {
    /// In seconds of the session.
    pub t_s: f64,
    /// MAVLink severity, 0 emergency to 7 debug.
    pub severity: u8,
    /// The line, without control characters.
    pub text: String,
}

/// A tunable as it stands.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterValue {
    /// Its key in `[filter]`.
    pub name: String,
    /// Its value, in its own unit.
    pub value: f64,
}

/// How the simulated brick was set last.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatorNow {
    /// `odometry` or `estimate`.
    pub steering: String,
    /// The profile that its link is as bad as; `null` for a cable.
    pub link_profile: Option<String>,
}

/// The recording that is being written.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingNow {
    /// The name of its file.
    pub name: String,
    /// So large it is.
    pub bytes: u64,
}

/// A measured quantity with about seven digits, far below the resolution of any sensor; `null` if it is not finite.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Number(Option<f32>);

impl Number {
    /// `None` if it is not finite.
    pub fn get(self) -> Option<f64> {
        self.0.map(f64::from)
    }
}

impl From<f64> for Number {
    fn from(value: f64) -> Self {
        let short = value as f32;
        Self(short.is_finite().then_some(short))
    }
}

/// Rounded to the microsecond, so that the decimals stay short.
pub(crate) fn seconds_of(at: Timestamp<HostClock>) -> f64 {
    at.as_micros() as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_what_is_none_is_null() {
        let json = |value: f64| serde_json::to_string(&Number::from(value)).unwrap();
        assert_eq!(json(0.1), "0.1");
        assert_eq!(json(-1.0 / 3.0), "-0.33333334");
        assert_eq!(json(f64::NAN), "null");
        assert_eq!(json(f64::INFINITY), "null");
        assert_eq!(json(1e300), "null");
        assert_eq!(seconds_of(Timestamp::from_nanos(265_885_334)), 0.265_885);
    }
}
