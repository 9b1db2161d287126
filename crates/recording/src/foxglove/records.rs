//! JSON records for data without a Foxglove message: one table of fields gives a message and its schema.
//!
//! Non-finite numbers are omitted: JSON has none, and viewers treat `null` as a separate type.

use posebridge_telemetry::{
    Address, BrickClock, Calibration, Celsius, ChannelName, Command, Estimate, FusionOutcome, FusionRecord,
    LinkCounter, LinkHealth, LinkId, MountedSensor, RobotId, ScalarEstimate, SourceHealth, TimeDelta, Timestamp,
    UncertainValue,
};
use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use crate::container::{RecordingGap, TruthSample};

/// A kind of record: fields of a `T`, in groups, which kinds may share.
pub(super) struct Record<T: 'static> {
    title: &'static str,
    help: &'static str,
    fields: &'static [&'static [Field<T>]],
}

struct Field<T> {
    key: &'static str,
    help: &'static str,
    read: Read<T>,
}

/// The type of a field, and how it is read.
enum Read<T> {
    Flag(fn(&T) -> bool),
    U8(fn(&T) -> u8),
    U16(fn(&T) -> u16),
    U64(fn(&T) -> u64),
    I64(fn(&T) -> i64),
    Text(fn(&T) -> String),
    /// Always finite.
    Finite(fn(&T) -> f64),
    /// Omitted if missing or not finite.
    Number(fn(&T) -> Option<f64>),
    /// Omitted if one is not finite.
    Numbers(fn(&T) -> Vec<f64>),
    /// Two fields; the key of the standard deviation ends in `_sigma`.
    Uncertain(fn(&T) -> UncertainValue),
    /// A field for each of [`LinkCounter::ALL`], by its own key.
    Counters(fn(&T) -> &LinkHealth),
    Sources(fn(&T) -> &[SourceHealth]),
}

/// A field in the schema.
struct Property {
    key: String,
    schema: Value,
    is_required: bool,
}

impl<T> Record<T> {
    /// Compact JSON, in the order of the table.
    pub(super) fn message(&self, of: &T) -> Vec<u8> {
        // Numbers, texts and lists always serialise.
        serde_json::to_vec(&self.entries(of)).unwrap_or_default()
    }

    /// Without references, because not every viewer resolves them.
    pub(super) fn schema(&self) -> String {
        let mut schema = self.object_schema();
        schema["$schema"] = json!("http://json-schema.org/draft-07/schema#");
        schema["title"] = json!(self.title);
        schema.to_string()
    }

    fn entries(&self, of: &T) -> Entries {
        Entries(self.fields.iter().copied().flatten().flat_map(|field| field.entries(of)).collect())
    }

    fn object_schema(&self) -> Value {
        let properties: Vec<Property> = self.fields.iter().copied().flatten().flat_map(Field::properties).collect();
        let required: Vec<&String> = properties.iter().filter(|one| one.is_required).map(|one| &one.key).collect();
        let mut schema = json!({ "description": self.help, "type": "object" });
        if !required.is_empty() {
            schema["required"] = json!(required);
        }
        schema["properties"] = properties.into_iter().map(|one| (one.key, one.schema)).collect();
        schema
    }
}

impl<T> Field<T> {
    fn entries(&self, of: &T) -> Vec<(String, Written)> {
        let value = match &self.read {
            Read::Flag(read) => json!(read(of)),
            Read::U8(read) => json!(read(of)),
            Read::U16(read) => json!(read(of)),
            Read::U64(read) => json!(read(of)),
            Read::I64(read) => json!(read(of)),
            Read::Text(read) => json!(read(of)),
            Read::Finite(read) => json!(read(of)),
            Read::Number(read) => return finite_entry(self.key.to_owned(), read(of)).into_iter().collect(),
            Read::Numbers(read) => match read(of) {
                numbers if numbers.iter().all(|number| number.is_finite()) => json!(numbers),
                _ => return Vec::new(),
            },
            Read::Uncertain(read) => {
                let UncertainValue { value, sigma } = read(of);
                let pair = [(self.key.to_owned(), value), (self.sigma_key(), sigma)];
                return pair.into_iter().filter_map(|(key, number)| finite_entry(key, Some(number))).collect();
            }
            Read::Counters(read) => {
                let count = |counter: &LinkCounter| Written::Value(json!((counter.read)(read(of))));
                return LinkCounter::ALL.iter().map(|counter| (counter.key.to_owned(), count(counter))).collect();
            }
            Read::Sources(read) => {
                let sources = read(of).iter().map(|source| SOURCE.entries(source)).collect();
                return vec![(self.key.to_owned(), Written::Objects(sources))];
            }
        };
        vec![(self.key.to_owned(), Written::Value(value))]
    }

    fn properties(&self) -> Vec<Property> {
        let number = || json!({ "format": "double", "type": "number" });
        let unsigned = |bits: u32, maximum: u64| json!({ "format": format!("uint{bits}"), "maximum": maximum, "minimum": 0, "type": "integer" });
        let count = || json!({ "format": "uint64", "minimum": 0, "type": "integer" });
        let schema = match &self.read {
            Read::Flag(_) => json!({ "type": "boolean" }),
            Read::U8(_) => unsigned(8, u8::MAX.into()),
            Read::U16(_) => unsigned(16, u16::MAX.into()),
            Read::U64(_) => count(),
            Read::I64(_) => json!({ "format": "int64", "type": "integer" }),
            Read::Text(_) => json!({ "type": "string" }),
            Read::Finite(_) | Read::Number(_) => number(),
            Read::Numbers(_) => json!({ "items": number(), "type": "array" }),
            Read::Uncertain(_) => {
                let sigma = Property::new(self.sigma_key(), "One standard deviation of it, in its unit.", number());
                let value = Property::new(self.key.to_owned(), self.help, number());
                return [value, sigma].map(|property| Property { is_required: false, ..property }).into();
            }
            Read::Counters(_) => {
                let counter = |one: &LinkCounter| Property::new(one.key.to_owned(), one.help, count());
                return LinkCounter::ALL.iter().map(counter).collect();
            }
            Read::Sources(_) => json!({ "items": SOURCE.object_schema(), "type": "array" }),
        };
        let is_required = !matches!(self.read, Read::Number(_) | Read::Numbers(_));
        vec![Property { is_required, ..Property::new(self.key.to_owned(), self.help, schema) }]
    }

    fn sigma_key(&self) -> String {
        format!("{}_sigma", self.key)
    }
}

impl Property {
    fn new(key: String, help: &str, mut schema: Value) -> Self {
        schema["description"] = json!(help);
        Self { key, schema, is_required: true }
    }
}

fn finite_entry(key: String, number: Option<f64>) -> Option<(String, Written)> {
    let number = number.filter(|number| number.is_finite())?;
    Some((key, Written::Value(json!(number))))
}

/// An object in the order of its table; that of a [`Value`] is in the order of its keys.
struct Entries(Vec<(String, Written)>);

#[derive(Serialize)]
#[serde(untagged)]
enum Written {
    Value(Value),
    Objects(Vec<Entries>),
}

impl Serialize for Entries {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(key, value)| (key, value)))
    }
}

const fn field<T>(key: &'static str, help: &'static str, read: Read<T>) -> Field<T> {
    Field { key, help, read }
}

#[rustfmt::skip]
pub(super) const ESTIMATE: Record<Estimate> = Record {
    title: "EstimateRecord",
    help: "The filter's estimate after an observation.",
    fields: &[&[
        field("brick_nanos", "The instant for which it holds, ns of the brick's clock.", Read::I64(|of| of.stamp.as_nanos())),
        field("x_m", "East, m.", Read::Number(|of| Some(of.pose.x.0))),
        field("y_m", "North, m.", Read::Number(|of| Some(of.pose.y.0))),
        field("heading_rad", "Counter-clockwise from east, in (-pi, pi], rad.", Read::Number(|of| Some(of.pose.heading.rad()))),
        field("forward_m_per_s", "Forward speed, m/s.", Read::Number(|of| Some(of.forward_speed.0))),
        field("turn_rad_per_s", "Turn rate, rad/s.", Read::Number(|of| Some(of.turn_rate.0))),
        field("x_sigma_m", "One standard deviation of x, m.", Read::Number(|of| Some(of.x_sigma_m()))),
        field("y_sigma_m", "One standard deviation of y, m.", Read::Number(|of| Some(of.y_sigma_m()))),
        field("heading_sigma_rad", "One standard deviation of the heading, rad.", Read::Number(|of| Some(of.heading_sigma_rad()))),
        field("is_position_valid", "Whether the position was ever observed or given.", Read::Flag(|of| of.validity.position)),
        field("is_heading_valid", "Whether the heading was ever observed or given.", Read::Flag(|of| of.validity.heading)),
        field("is_dead_reckoning", "Whether nothing absolute was used for long.", Read::Flag(|of| of.is_dead_reckoning)),
        field("fix_age_s", "Time since the last fix that was used, s; left out before the first.", Read::Number(|of| of.fix_age.map(TimeDelta::as_secs_f64))),
        field("reset_counter", "Counts jumps that are no motion.", Read::U8(|of| of.reset_counter)),
    ]],
};

#[rustfmt::skip]
pub(super) const QUANTITY: Record<ScalarEstimate> = Record {
    title: "QuantityRecord",
    help: "The estimate of a filter that knows one quantity.",
    fields: &[&[
        field("brick_nanos", "The instant for which it holds, ns of the brick's clock.", Read::I64(|of| of.stamp.as_nanos())),
        field("value", "The value, in its unit.", Read::Number(|of| Some(of.value))),
        field("sigma", "One standard deviation, in the same unit.", Read::Number(|of| Some(of.sigma))),
        field("rate_per_s", "Its rate, per second.", Read::Number(|of| Some(of.rate_per_s))),
        field("unit", "The unit.", Read::Text(|of| of.unit.to_owned())),
    ]],
};

#[rustfmt::skip]
pub(super) const FUSION: Record<FusionRecord> = Record {
    title: "FusedRecord",
    help: "What became of one observation.",
    fields: &[&[
        field("sensor", "Number of the sensor.", Read::U8(|of| of.sensor.0)),
        field("kind", "Kind of the observation.", Read::Text(|of| of.kind.to_owned())),
        field("brick_nanos", "The instant that it spoke of, ns of the brick's clock.", Read::I64(|of| of.stamp.as_nanos())),
        field("lag_s", "How far behind the filter's time it was, s.", Read::Finite(|of| of.lag.as_secs_f64())),
        field("verdict", "Whether it was used, and why not.", Read::Text(|of| of.outcome.reason().to_owned())),
        field("innovation", "Observed minus predicted, SI units, as many components as were used.", Read::Numbers(|of| used(of, &of.innovation).to_vec())),
        field("innovation_covariance", "Covariance S of the innovation, row by row.", Read::Numbers(|of| {
            used(of, &of.innovation_covariance).iter().flat_map(|row| used(of, row)).copied().collect()
        })),
        field("nis", "Normalised innovation squared.", Read::Number(|of| Some(of.nis))),
        field("degrees_of_freedom", "Components used.", Read::U8(|of| of.degrees_of_freedom)),
        field("log_likelihood", "Log-likelihood of the innovation.", Read::Number(|of| Some(of.log_likelihood))),
    ]],
};

/// The components in use.
fn used<'a, C>(record: &FusionRecord, components: &'a [C; 3]) -> &'a [C] {
    components.get(..record.degrees_of_freedom.into()).unwrap_or(components)
}

#[rustfmt::skip]
const SOURCE: Record<SourceHealth> = Record {
    title: "SourceRecord",
    help: "What one sender has sent on a link.",
    fields: &[&[
        field("system", "MAVLink system id.", Read::U8(|of| of.source.system.0)),
        field("component", "MAVLink component id.", Read::U8(|of| of.source.component.0)),
        field("frames", "Frames received whole.", Read::U64(|of| of.frames)),
        field("lost", "Frames missing in its sequence numbers.", Read::U64(|of| of.lost)),
    ]],
};

pub(super) struct LinkReport {
    pub(super) link: LinkId,
    pub(super) health: LinkHealth,
    pub(super) sources: Vec<SourceHealth>,
}

#[rustfmt::skip]
pub(super) const LINK_HEALTH: Record<LinkReport> = Record {
    title: "HealthRecord",
    help: "The health of a link, in counts since the session began.",
    fields: &[&[
        field("link", "Number of the link.", Read::U16(|of| of.link.0)),
        field("", "", Read::Counters(|of| &of.health)),
        field("round_trip_s", "Round-trip time of the last answered time request, s.", Read::Number(|of| of.health.round_trip.map(TimeDelta::as_secs_f64))),
        field("clock_uncertainty_s", "Half the width of the clock bounds, s.", Read::Number(|of| of.health.clock_uncertainty.map(TimeDelta::as_secs_f64))),
        field("sources", "What each sender sent.", Read::Sources(|of| &of.sources)),
    ]],
};

/// One instant by the host's clock and by another.
pub(super) struct ClockAlignment {
    pub(super) clock: &'static str,
    pub(super) owner: Address,
    pub(super) host_nanos: i64,
    pub(super) other_nanos: i64,
    pub(super) offset: TimeDelta,
    pub(super) skew_ppm: Option<f64>,
    pub(super) uncertainty: TimeDelta,
    pub(super) round_trip: Option<TimeDelta>,
}

#[rustfmt::skip]
pub(super) const CLOCK: Record<ClockAlignment> = Record {
    title: "ClockRecord",
    help: "Two clocks were aligned anew.",
    fields: &[&[
        field("clock", "Whose clock: brick or camera.", Read::Text(|of| of.clock.to_owned())),
        field("system", "MAVLink system id of its owner.", Read::U8(|of| of.owner.system.0)),
        field("component", "MAVLink component id of its owner.", Read::U8(|of| of.owner.component.0)),
        field("host_nanos", "When, ns of the host's clock.", Read::I64(|of| of.host_nanos)),
        field("other_nanos", "The same instant, ns of the other clock.", Read::I64(|of| of.other_nanos)),
        field("offset_s", "The other clock minus the host's, s.", Read::Finite(|of| of.offset.as_secs_f64())),
        field("skew_ppm", "Rate of the other clock against the host's, minus one, in parts per million; left out where it is not known.", Read::Number(|of| of.skew_ppm)),
        field("uncertainty_s", "Half the distance between the bounds, s.", Read::Finite(|of| of.uncertainty.as_secs_f64())),
        field("round_trip_s", "Round-trip time of the exchange that led to it, s.", Read::Number(|of| of.round_trip.map(TimeDelta::as_secs_f64))),
    ]],
};

#[rustfmt::skip]
pub(super) const CALIBRATION: Record<Calibration> = Record {
    title: "CalibrationRecord",
    help: "What the filter has learned about the robot; a sigma of 0: taken as given.",
    fields: &[&[
        field("radius_scale", "Relative error of the mean wheel radius.", Read::Uncertain(|of| of.radius_scale)),
        field("radius_difference", "Relative difference of the wheels' radii, right minus left.", Read::Uncertain(|of| of.radius_difference)),
        field("track_scale", "Relative error of the track width.", Read::Uncertain(|of| of.track_scale)),
        field("gyro_bias_rad_per_s", "Gyro bias, rad/s.", Read::Uncertain(|of| of.gyro_bias_rad_per_s)),
        field("fix_delay_s", "How much earlier than its stamp a fix was true, s.", Read::Uncertain(|of| of.fix_delay_s)),
        field("tag_forward_m", "Where the tag is, forward of where the fix says, m.", Read::Uncertain(|of| of.tag_forward_m)),
        field("tag_left_m", "Where the tag is, to the left of where the fix says, m.", Read::Uncertain(|of| of.tag_left_m)),
        field("beacon_offset_m", "Offset of a beacon's ranges, m.", Read::Uncertain(|of| of.beacon_offset_m)),
        field("beacon_scale", "Relative error of a beacon's ranges.", Read::Uncertain(|of| of.beacon_scale)),
        field("landmark_offset_m", "Offset of the ranges to landmarks, m.", Read::Uncertain(|of| of.landmark_offset_m)),
        field("landmark_scale", "Relative error of the ranges to landmarks.", Read::Uncertain(|of| of.landmark_scale)),
        field("gyro_scale", "Relative error of the gyro's rate.", Read::Uncertain(|of| of.gyro_scale)),
        field("backlash_rad", "Total play between each encoder and its wheel, rad.", Read::Uncertain(|of| of.backlash_rad)),
        field("odometry_delay_s", "How much earlier than its stamp the motion of an odometer happened, s.", Read::Uncertain(|of| of.odometry_delay_s)),
        field("landmark_delay_s", "How much earlier than its stamp a landmark was sighted, s.", Read::Uncertain(|of| of.landmark_delay_s)),
        field("beacon_delay_s", "How much earlier than its stamp a range to a beacon was true, s.", Read::Uncertain(|of| of.beacon_delay_s)),
        field("range_delay_s", "How much earlier than its stamp a range to a wall was true, s.", Read::Uncertain(|of| of.range_delay_s)),
        field("compass_delay_s", "How much earlier than its stamp a compass heading was true, s.", Read::Uncertain(|of| of.compass_delay_s)),
        field("landmarks_x_m", "Where the camera of the landmarks sits, forward of mid-axle, m.", Read::Uncertain(|of| of.mountings[MountedSensor::Landmarks].x_m)),
        field("landmarks_y_m", "The same to the left, m.", Read::Uncertain(|of| of.mountings[MountedSensor::Landmarks].y_m)),
        field("landmarks_yaw_rad", "Its direction, counter-clockwise from forward, rad.", Read::Uncertain(|of| of.mountings[MountedSensor::Landmarks].yaw_rad)),
        field("beacons_x_m", "Where the radio tag sits, forward of mid-axle, m.", Read::Uncertain(|of| of.mountings[MountedSensor::Beacons].x_m)),
        field("beacons_y_m", "The same to the left, m.", Read::Uncertain(|of| of.mountings[MountedSensor::Beacons].y_m)),
        field("range_x_m", "Where the range finder sits, forward of mid-axle, m.", Read::Uncertain(|of| of.mountings[MountedSensor::Range].x_m)),
        field("range_y_m", "The same to the left, m.", Read::Uncertain(|of| of.mountings[MountedSensor::Range].y_m)),
        field("range_yaw_rad", "Its direction, counter-clockwise from forward, rad.", Read::Uncertain(|of| of.mountings[MountedSensor::Range].yaw_rad)),
        field("compass_yaw_rad", "The compass's direction, counter-clockwise from forward, rad.", Read::Uncertain(|of| of.mountings[MountedSensor::Compass].yaw_rad)),
    ]],
};

pub(super) struct TemperatureReading {
    pub(super) brick: Address,
    pub(super) channel: ChannelName,
    pub(super) stamp: Timestamp<BrickClock>,
    pub(super) shown: Celsius,
    pub(super) verdict: FusionOutcome,
    pub(super) settled: Option<ScalarEstimate>,
}

#[rustfmt::skip]
pub(super) const TEMPERATURE: Record<TemperatureReading> = Record {
    title: "TemperatureRecord",
    help: "A thermometer was read.",
    fields: &[&[
        field("system", "MAVLink system id of the brick.", Read::U8(|of| of.brick.system.0)),
        field("component", "MAVLink component id of the brick.", Read::U8(|of| of.brick.component.0)),
        field("channel", "Which of its thermometers.", Read::Text(|of| of.channel.to_string())),
        field("brick_nanos", "When it was read, ns of that brick's clock.", Read::I64(|of| of.stamp.as_nanos())),
        field("shown_c", "What it shows, °C.", Read::Number(|of| Some(of.shown.0))),
        field("verdict", "What became of it.", Read::Text(|of| of.verdict.reason().to_owned())),
        field("settled_c", "What it will show once it has settled, °C.", Read::Number(|of| Some(of.settled?.value))),
        field("settled_sigma_c", "One standard deviation of that, K.", Read::Number(|of| Some(of.settled?.sigma))),
    ]],
};

/// A command, and the robot that it names.
pub(super) struct CommandRequest {
    pub(super) robot: Option<RobotId>,
    pub(super) command: Command,
}

#[rustfmt::skip]
pub(super) const COMMAND: Record<CommandRequest> = Record {
    title: "CommandRecord",
    help: "A request of a person or a program.",
    fields: &[&[
        field("command", "Which.", Read::Text(|of| of.command.name().to_owned())),
        field("text", "The whole of it, for people.", Read::Text(|CommandRequest { robot, command }| {
            robot.map_or_else(|| command.to_string(), |robot| format!("robot {robot}: {command}"))
        })),
    ]],
};

#[rustfmt::skip]
pub(super) const GAP: Record<RecordingGap> = Record {
    title: "GapRecord",
    help: "Inputs that are missing in this recording because the disk was too slow: its replay is not that of the session.",
    fields: &[&[
        field("inputs", "How many.", Read::U64(|of| of.inputs)),
        field("from_host_nanos", "When the last input before them was given, ns of the host's clock.", Read::I64(|of| of.from.as_nanos())),
        field("to_host_nanos", "When the next input behind them was given, ns of the host's clock.", Read::I64(|of| of.to.as_nanos())),
    ]],
};

#[rustfmt::skip]
const TRUTH_FIELDS: &[Field<TruthSample>] = &[
    field("brick_nanos", "When, ns of the brick's clock.", Read::I64(|of| of.time.as_nanos())),
    field("x_m", "East, m.", Read::Finite(|of| of.pose.x.0)),
    field("y_m", "North, m.", Read::Finite(|of| of.pose.y.0)),
    field("heading_rad", "Counter-clockwise from east, in (-pi, pi], rad.", Read::Finite(|of| of.pose.heading.rad())),
    field("odometry_x_m", "East by the brick's own dead reckoning, m.", Read::Number(|of| Some(of.odometry?.x.0))),
    field("odometry_y_m", "North by the brick's own dead reckoning, m.", Read::Number(|of| Some(of.odometry?.y.0))),
    field("odometry_heading_rad", "Heading by the brick's own dead reckoning, rad.", Read::Number(|of| Some(of.odometry?.heading.rad()))),
];

#[rustfmt::skip]
const ROBOT_FIELDS: &[Field<TruthSample>] = &[
    field("link", "Number of the robot's link.", Read::U16(|of| of.robot.unwrap_or_default().link.0)),
    field("system", "MAVLink system id of the robot.", Read::U8(|of| of.robot.unwrap_or_default().address.system.0)),
    field("component", "MAVLink component id of the robot.", Read::U8(|of| of.robot.unwrap_or_default().address.component.0)),
];

pub(super) const TRUTH: Record<TruthSample> = Record {
    title: "TruthRecord",
    help: "Where the robot really was, as its simulation says.",
    fields: &[TRUTH_FIELDS],
};

pub(super) const ROBOT_TRUTH: Record<TruthSample> = Record {
    title: "RobotTruthRecord",
    help: "Where one of several simulated robots really was.",
    fields: &[ROBOT_FIELDS, TRUTH_FIELDS],
};
