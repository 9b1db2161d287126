//! JSON records for data without a Foxglove message. Their schemas are derived from the structs.
//!
//! Non-finite numbers are omitted: JSON has none, and viewers treat `null` as a separate type.

use std::borrow::Cow;

use posebridge_telemetry::{
    Calibration, Command, Estimate, FusionRecord, LinkCounter, LinkHealth, LinkId, RobotId, SourceHealth, TimeDelta,
    UncertainValue,
};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};

use crate::container::{RecordingGap, TruthSample};

/// The filter's estimate after an observation.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct EstimateRecord {
    /// The instant for which it holds, ns of the brick's clock.
    pub(super) brick_nanos: i64,
    /// East, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) x_m: Option<f64>,
    /// North, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) y_m: Option<f64>,
    /// Counter-clockwise from east, in (-pi, pi], rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) heading_rad: Option<f64>,
    /// Forward speed, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) forward_m_per_s: Option<f64>,
    /// Turn rate, rad/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) turn_rad_per_s: Option<f64>,
    /// One standard deviation of x, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) x_sigma_m: Option<f64>,
    /// One standard deviation of y, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) y_sigma_m: Option<f64>,
    /// One standard deviation of the heading, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) heading_sigma_rad: Option<f64>,
    /// Whether the position was ever observed or given.
    pub(super) is_position_valid: bool,
    /// Whether the heading was ever observed or given.
    pub(super) is_heading_valid: bool,
    /// Whether nothing absolute was used for long.
    pub(super) is_dead_reckoning: bool,
    /// Time since the last fix that was used, s; left out before the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) fix_age_s: Option<f64>,
    /// Counts jumps that are no motion.
    pub(super) reset_counter: u8,
}

/// What became of one observation.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct FusedRecord {
    /// Number of the sensor.
    pub(super) sensor: u8,
    /// Kind of the observation.
    pub(super) kind: &'static str,
    /// The instant that it spoke of, ns of the brick's clock.
    pub(super) brick_nanos: i64,
    /// How far behind the filter's time it was, s.
    pub(super) lag_s: f64,
    /// Whether it was used, and why not.
    pub(super) verdict: &'static str,
    /// Observed minus predicted, SI units, as many components as were used.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Vec<f64>")]
    pub(super) innovation: Option<Vec<f64>>,
    /// Covariance S of the innovation, row by row.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Vec<f64>")]
    pub(super) innovation_covariance: Option<Vec<f64>>,
    /// Normalised innovation squared.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) nis: Option<f64>,
    /// Components used.
    pub(super) degrees_of_freedom: u8,
    /// Log-likelihood of the innovation.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) log_likelihood: Option<f64>,
}

/// What one sender has sent on a link.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct SourceRecord {
    /// MAVLink system id.
    pub(super) system: u8,
    /// MAVLink component id.
    pub(super) component: u8,
    /// Frames received whole.
    pub(super) frames: u64,
    /// Frames missing in its sequence numbers.
    pub(super) lost: u64,
}

/// The health of a link, in counts since the session began.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct HealthRecord {
    /// Number of the link.
    pub(super) link: u16,
    #[serde(flatten)]
    counters: LinkCounters,
    /// Round-trip time of the last answered time request, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) round_trip_s: Option<f64>,
    /// Half the width of the clock bounds, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) clock_uncertainty_s: Option<f64>,
    /// What each sender sent.
    pub(super) sources: Vec<SourceRecord>,
}

/// By their keys.
#[derive(Debug)]
struct LinkCounters(LinkHealth);

impl Serialize for LinkCounters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(LinkCounter::ALL.iter().map(|counter| (counter.key, (counter.read)(&self.0))))
    }
}

impl JsonSchema for LinkCounters {
    fn schema_name() -> Cow<'static, str> {
        "LinkCounters".into()
    }

    fn json_schema(_generator: &mut SchemaGenerator) -> Schema {
        let entry = |counter: &LinkCounter| {
            let schema = json!({ "description": counter.help, "format": "uint64", "minimum": 0, "type": "integer" });
            (counter.key.to_owned(), schema)
        };
        let properties: Map<String, Value> = LinkCounter::ALL.iter().map(entry).collect();
        let required: Vec<&str> = LinkCounter::ALL.iter().map(|counter| counter.key).collect();
        json_schema!({ "type": "object", "properties": properties, "required": required })
    }
}

/// Two clocks were aligned anew.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct ClockRecord {
    /// Whose clock: brick or camera.
    pub(super) clock: &'static str,
    /// MAVLink system id of its owner.
    pub(super) system: u8,
    /// MAVLink component id of its owner.
    pub(super) component: u8,
    /// When, ns of the host's clock.
    pub(super) host_nanos: i64,
    /// The same instant, ns of the other clock.
    pub(super) other_nanos: i64,
    /// The other clock minus the host's, s.
    pub(super) offset_s: f64,
    /// Rate of the other clock against the host's, minus one, in parts per million; left out where it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) skew_ppm: Option<f64>,
    /// Half the distance between the bounds, s.
    pub(super) uncertainty_s: f64,
    /// Round-trip time of the exchange that led to it, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) round_trip_s: Option<f64>,
}

/// What the filter has learned about the robot; a sigma of 0: taken as given.
#[derive(Debug)]
pub(super) struct CalibrationRecord(pub(super) Calibration);

/// A constant of a robot: key, description, accessor. The key of its standard deviation ends in `_sigma`.
type CalibrationTerm = (&'static str, &'static str, fn(&Calibration) -> UncertainValue);

#[rustfmt::skip]
const CALIBRATION_TERMS: [CalibrationTerm; 11] = [
    ("radius_scale", "Relative error of the mean wheel radius.", |of| of.radius_scale),
    ("radius_difference", "Relative difference of the wheels' radii, right minus left.", |of| of.radius_difference),
    ("track_scale", "Relative error of the track width.", |of| of.track_scale),
    ("gyro_bias_rad_per_s", "Gyro bias, rad/s.", |of| of.gyro_bias_rad_per_s),
    ("fix_delay_s", "How much earlier than its stamp a fix was true, s.", |of| of.fix_delay_s),
    ("tag_forward_m", "Where the tag is, forward of where the fix says, m.", |of| of.tag_forward_m),
    ("tag_left_m", "Where the tag is, to the left of where the fix says, m.", |of| of.tag_left_m),
    ("beacon_offset_m", "Offset of a beacon's ranges, m.", |of| of.beacon_offset_m),
    ("beacon_scale", "Relative error of a beacon's ranges.", |of| of.beacon_scale),
    ("landmark_offset_m", "Offset of the ranges to landmarks, m.", |of| of.landmark_offset_m),
    ("landmark_scale", "Relative error of the ranges to landmarks.", |of| of.landmark_scale),
];

impl Serialize for CalibrationRecord {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let numbers = CALIBRATION_TERMS.iter().flat_map(|(key, _, read)| {
            let UncertainValue { value, sigma } = read(&self.0);
            [((*key).to_owned(), value), (format!("{key}_sigma"), sigma)]
        });
        serializer.collect_map(numbers.filter(|(_, number)| number.is_finite()))
    }
}

impl JsonSchema for CalibrationRecord {
    fn schema_name() -> Cow<'static, str> {
        "CalibrationRecord".into()
    }

    fn json_schema(_generator: &mut SchemaGenerator) -> Schema {
        let number = |help: &str| json!({ "description": help, "format": "double", "type": "number" });
        let entries = CALIBRATION_TERMS.iter().flat_map(|(key, help, _)| {
            let sigma = number("One standard deviation of it, in its unit.");
            [((*key).to_owned(), number(help)), (format!("{key}_sigma"), sigma)]
        });
        json_schema!({
            "description": "What the filter has learned about the robot; a sigma of 0: taken as given.",
            "type": "object",
            "properties": Value::from(entries.collect::<Map<_, _>>()),
        })
    }
}

/// A thermometer was read.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct TemperatureRecord {
    /// MAVLink system id of the brick.
    pub(super) system: u8,
    /// MAVLink component id of the brick.
    pub(super) component: u8,
    /// Which of its thermometers.
    pub(super) channel: String,
    /// When it was read, ns of that brick's clock.
    pub(super) brick_nanos: i64,
    /// What it shows, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) shown_c: Option<f64>,
    /// What became of it.
    pub(super) verdict: &'static str,
    /// What it will show once it has settled, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) settled_c: Option<f64>,
    /// One standard deviation of that, K.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) settled_sigma_c: Option<f64>,
}

/// A request of a person or a program.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct CommandRecord {
    /// Which.
    pub(super) command: &'static str,
    /// The whole of it, for people.
    pub(super) text: String,
}

/// Inputs that are missing in this recording because the disk was too slow: its replay is not that of the session.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct GapRecord {
    /// How many.
    pub(super) inputs: u64,
    /// When the last input before them was given, ns of the host's clock.
    pub(super) from_host_nanos: i64,
    /// When the next input behind them was given, ns of the host's clock.
    pub(super) to_host_nanos: i64,
}

/// Where the robot really was, as its simulation says.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct TruthRecord {
    /// When, ns of the brick's clock.
    pub(super) brick_nanos: i64,
    /// East, m.
    pub(super) x_m: f64,
    /// North, m.
    pub(super) y_m: f64,
    /// Counter-clockwise from east, in (-pi, pi], rad.
    pub(super) heading_rad: f64,
    /// East by the brick's own dead reckoning, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) odometry_x_m: Option<f64>,
    /// North by the brick's own dead reckoning, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) odometry_y_m: Option<f64>,
    /// Heading by the brick's own dead reckoning, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "f64")]
    pub(super) odometry_heading_rad: Option<f64>,
}

/// Where one of several simulated robots really was.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct RobotTruthRecord {
    /// Number of the robot's link.
    pub(super) link: u16,
    /// MAVLink system id of the robot.
    pub(super) system: u8,
    /// MAVLink component id of the robot.
    pub(super) component: u8,
    #[serde(flatten)]
    pub(super) truth: TruthRecord,
}

impl RobotTruthRecord {
    pub(super) fn new(robot: RobotId, sample: &TruthSample) -> Self {
        Self {
            link: robot.link.0,
            system: robot.address.system.0,
            component: robot.address.component.0,
            truth: TruthRecord::from(sample),
        }
    }
}

impl From<&Estimate> for EstimateRecord {
    fn from(estimate: &Estimate) -> Self {
        Self {
            brick_nanos: estimate.stamp.as_nanos(),
            x_m: finite(estimate.pose.x.0),
            y_m: finite(estimate.pose.y.0),
            heading_rad: finite(estimate.pose.heading.rad()),
            forward_m_per_s: finite(estimate.forward_speed.0),
            turn_rad_per_s: finite(estimate.turn_rate.0),
            x_sigma_m: finite(estimate.x_sigma_m()),
            y_sigma_m: finite(estimate.y_sigma_m()),
            heading_sigma_rad: finite(estimate.heading_sigma_rad()),
            is_position_valid: estimate.validity.position,
            is_heading_valid: estimate.validity.heading,
            is_dead_reckoning: estimate.is_dead_reckoning,
            fix_age_s: estimate.fix_age.map(TimeDelta::as_secs_f64),
            reset_counter: estimate.reset_counter,
        }
    }
}

impl From<&FusionRecord> for FusedRecord {
    fn from(record: &FusionRecord) -> Self {
        let used = usize::from(record.degrees_of_freedom).min(record.innovation.len());
        let rows = record.innovation_covariance.iter().take(used);
        Self {
            sensor: record.sensor.0,
            kind: record.kind,
            brick_nanos: record.stamp.as_nanos(),
            lag_s: record.lag.as_secs_f64(),
            verdict: record.outcome.reason(),
            innovation: all_finite(record.innovation.iter().take(used)),
            innovation_covariance: all_finite(rows.flat_map(|row| row.iter().take(used))),
            nis: finite(record.nis),
            degrees_of_freedom: record.degrees_of_freedom,
            log_likelihood: finite(record.log_likelihood),
        }
    }
}

impl HealthRecord {
    pub(super) fn new(link: LinkId, health: &LinkHealth, sources: &[SourceHealth]) -> Self {
        let source = |one: &SourceHealth| SourceRecord {
            system: one.source.system.0,
            component: one.source.component.0,
            frames: one.frames,
            lost: one.lost,
        };
        Self {
            link: link.0,
            counters: LinkCounters(*health),
            round_trip_s: health.round_trip.map(TimeDelta::as_secs_f64),
            clock_uncertainty_s: health.clock_uncertainty.map(TimeDelta::as_secs_f64),
            sources: sources.iter().map(source).collect(),
        }
    }
}

impl CommandRecord {
    pub(super) fn new(command: &Command, robot: Option<RobotId>) -> Self {
        let text = robot.map_or_else(|| command.to_string(), |robot| format!("robot {robot}: {command}"));
        Self { command: command.name(), text }
    }
}

impl From<&RecordingGap> for GapRecord {
    fn from(gap: &RecordingGap) -> Self {
        Self { inputs: gap.inputs, from_host_nanos: gap.from.as_nanos(), to_host_nanos: gap.to.as_nanos() }
    }
}

impl From<&TruthSample> for TruthRecord {
    fn from(sample: &TruthSample) -> Self {
        let odometry = sample.odometry;
        Self {
            brick_nanos: sample.time.as_nanos(),
            x_m: sample.pose.x.0,
            y_m: sample.pose.y.0,
            heading_rad: sample.pose.heading.rad(),
            odometry_x_m: odometry.map(|pose| pose.x.0),
            odometry_y_m: odometry.map(|pose| pose.y.0),
            odometry_heading_rad: odometry.map(|pose| pose.heading.rad()),
        }
    }
}

/// `None` if it is not finite.
pub(super) fn finite(number: f64) -> Option<f64> {
    number.is_finite().then_some(number)
}

/// `None` if one is not finite.
fn all_finite<'a>(numbers: impl Iterator<Item = &'a f64>) -> Option<Vec<f64>> {
    numbers.map(|number| finite(*number)).collect()
}
