//! The messages that are taken from a bag: what identifies their types, and the row of numbers that each becomes.
//!
//! # Sources
//! common_interfaces of ROS 2 Jazzy for the fields, which are the same in all releases since Foxy. REP 103 for axes and units: x forward, y
//! left, z up, metres, radians.

use super::bag_reader::BagSchema;
use crate::ros2::cdr_reader::{CdrError, CdrReader};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SensorType {
    Odometry,
    PoseStamped,
    PoseWithCovarianceStamped,
    Imu,
    JointState,
    LaserScan,
}

struct TypeEntry {
    sensor: SensorType,
    /// `package/Type`.
    name: &'static str,
    /// Types without their packages, and names.
    fields: &'static [(&'static str, &'static str)],
    /// Of the row.
    columns: &'static str,
}

const HEADER: (&str, &str) = ("Header", "header");

const TYPES: &[TypeEntry] = &[
    TypeEntry {
        sensor: SensorType::Odometry,
        name: "nav_msgs/Odometry",
        fields: &[
            HEADER,
            ("string", "child_frame_id"),
            ("PoseWithCovariance", "pose"),
            ("TwistWithCovariance", "twist"),
        ],
        columns: "x_m,y_m,heading_rad,forward_m_per_s,turn_rad_per_s,var_x_m2,var_y_m2,var_heading_rad2",
    },
    TypeEntry {
        sensor: SensorType::PoseStamped,
        name: "geometry_msgs/PoseStamped",
        fields: &[HEADER, ("Pose", "pose")],
        columns: "x_m,y_m,heading_rad",
    },
    TypeEntry {
        sensor: SensorType::PoseWithCovarianceStamped,
        name: "geometry_msgs/PoseWithCovarianceStamped",
        fields: &[HEADER, ("PoseWithCovariance", "pose")],
        columns: "x_m,y_m,heading_rad,var_x_m2,var_y_m2,var_heading_rad2",
    },
    TypeEntry {
        sensor: SensorType::Imu,
        name: "sensor_msgs/Imu",
        fields: &[
            HEADER,
            ("Quaternion", "orientation"),
            ("float64[9]", "orientation_covariance"),
            ("Vector3", "angular_velocity"),
            ("float64[9]", "angular_velocity_covariance"),
            ("Vector3", "linear_acceleration"),
            ("float64[9]", "linear_acceleration_covariance"),
        ],
        columns: "turn_x_rad_per_s,turn_y_rad_per_s,turn_z_rad_per_s,acceleration_x_m_per_s2,acceleration_y_m_per_s2,\
            acceleration_z_m_per_s2",
    },
    TypeEntry {
        sensor: SensorType::JointState,
        name: "sensor_msgs/JointState",
        fields: &[
            HEADER,
            ("string[]", "name"),
            ("float64[]", "position"),
            ("float64[]", "velocity"),
            ("float64[]", "effort"),
        ],
        columns: "left_rad,right_rad",
    },
    TypeEntry {
        sensor: SensorType::LaserScan,
        name: "sensor_msgs/LaserScan",
        fields: &[
            HEADER,
            ("float32", "angle_min"),
            ("float32", "angle_max"),
            ("float32", "angle_increment"),
            ("float32", "time_increment"),
            ("float32", "scan_time"),
            ("float32", "range_min"),
            ("float32", "range_max"),
            ("float32[]", "ranges"),
            ("float32[]", "intensities"),
        ],
        columns: "range_m",
    },
];

/// Columns of every row, before those of its type.
pub(super) const TIME_COLUMNS: &str = "stamp_ns,log_ns";

/// Why the messages of a topic are not taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum TopicRefusal {
    /// No sensor has messages of this type.
    OtherType,
    /// The type is one of a sensor, but its messages cannot be decoded.
    Unreadable(String),
}

impl SensorType {
    pub(super) fn of_schema(schema: &BagSchema) -> Result<Self, TopicRefusal> {
        let name = schema.name.replace("/msg/", "/");
        let entry = TYPES.iter().find(|entry| entry.name == name).ok_or(TopicRefusal::OtherType)?;
        entry.check_definition(schema).map(|()| entry.sensor).map_err(TopicRefusal::Unreadable)
    }

    fn entry(self) -> &'static TypeEntry {
        TYPES.iter().find(|entry| entry.sensor == self).unwrap_or(&TYPES[0])
    }

    pub(super) fn columns(self) -> &'static str {
        self.entry().columns
    }
}

impl TypeEntry {
    fn check_definition(&self, schema: &BagSchema) -> Result<(), String> {
        match schema.encoding.as_str() {
            // Some writers leave the definition out.
            "ros2msg" if !schema.definition.trim().is_empty() => {
                let found = defined_fields(&schema.definition);
                let expected = self.fields.iter().map(|(kind, name)| format!("{kind} {name}")).collect::<Vec<_>>();
                if found == expected {
                    return Ok(());
                }
                let other = found.iter().find(|field| !expected.contains(field));
                let missing = expected.iter().find(|field| !found.contains(field));
                let field = other.or(missing).map_or("", String::as_str);
                let shown: String = field.chars().take(60).collect();
                Err(format!("its definition is not that of ROS 2: `{shown}`"))
            }
            // By its name: the text of the interface language says the same at length.
            "ros2msg" | "ros2idl" | "" => Ok(()),
            other => Err(format!("its definition is `{}`, not ros2msg or ros2idl", other.escape_default())),
        }
    }
}

/// The fields of the first message of a schema, as type without package and name. Constants and comments are none.
fn defined_fields(definition: &str) -> Vec<String> {
    let lines = definition.lines().take_while(|line| !line.starts_with("====="));
    let fields = lines.filter_map(|line| {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        let (kind, name) = (words.next()?, words.next()?);
        let kind = kind.rsplit('/').next().unwrap_or(kind);
        (!line.contains('=')).then(|| format!("{kind} {name}"))
    });
    fields.collect()
}

/// What a row needs to know beside its message.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct RowOptions {
    /// Names of the left and the right wheel's joint; `None` takes the first with `left` and `right` in them.
    pub(super) joints: Option<[String; 2]>,
    /// Direction of the range that is taken of a scan, counter-clockwise from forward.
    pub(super) bearing_rad: f64,
}

/// The numbers of one message; those that are not finite mean that there is none.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SensorRow {
    /// UTC; 0 if the sender set none.
    pub(super) stamp_nanos: i64,
    pub(super) frame: String,
    pub(super) values: Vec<f64>,
    /// Names of the joints that were taken.
    pub(super) joints: Option<[String; 2]>,
}

/// What a message holds.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum MessageContent {
    Row(SensorRow),
    /// A scan that sees nothing in this direction, joints of an arm: no damage and no row.
    Nothing,
}

/// The end of a joint's or a frame's name that is kept.
const MAX_SHOWN: usize = 80;

pub(super) fn decode(sensor: SensorType, options: &RowOptions, data: &[u8]) -> Result<MessageContent, CdrError> {
    let mut reader = CdrReader::open(data)?;
    let (sec, nanosec) = (reader.i32()?, reader.u32()?);
    let frame = shorten(reader.text()?);
    let mut joints = None;
    let values = match sensor {
        SensorType::Odometry => {
            reader.text()?;
            let (pose, covariance) = (planar_pose(&mut reader)?, reader.doubles::<36>()?);
            let [forward, _, _, _, _, turn] = reader.doubles()?;
            reader.doubles::<36>()?;
            let [x, y, heading] = pose;
            vec![x, y, heading, forward, turn, covariance[0], covariance[7], covariance[35]]
        }
        SensorType::PoseStamped => planar_pose(&mut reader)?.to_vec(),
        SensorType::PoseWithCovarianceStamped => {
            let ([x, y, heading], covariance) = (planar_pose(&mut reader)?, reader.doubles::<36>()?);
            vec![x, y, heading, covariance[0], covariance[7], covariance[35]]
        }
        SensorType::Imu => {
            reader.doubles::<13>()?;
            let turn = reader.doubles::<3>()?;
            reader.doubles::<9>()?;
            let acceleration = reader.doubles::<3>()?;
            let covariance = reader.doubles::<9>()?;
            // -1 says that there is no accelerometer.
            let is_measured = covariance[0] != -1.0;
            let acceleration = acceleration.map(|value| if is_measured { value } else { 0.0 });
            [turn, acceleration].concat()
        }
        SensorType::JointState => {
            let Some((names, angles)) = wheel_angles(&mut reader, options)? else {
                return Ok(MessageContent::Nothing);
            };
            joints = Some(names);
            angles.to_vec()
        }
        SensorType::LaserScan => {
            let Some(range_m) = range_at(&mut reader, options.bearing_rad)? else {
                return Ok(MessageContent::Nothing);
            };
            vec![range_m]
        }
    };
    let stamp_nanos = i64::from(sec) * 1_000_000_000 + i64::from(nanosec);
    Ok(MessageContent::Row(SensorRow { stamp_nanos, frame, values, joints }))
}

fn shorten(text: &str) -> String {
    text.chars().take(MAX_SHOWN).collect()
}

/// x, y and the heading, which is not a number for a quaternion of zeros.
fn planar_pose(reader: &mut CdrReader<'_>) -> Result<[f64; 3], CdrError> {
    let [x, y, _z, qx, qy, qz, qw] = reader.doubles()?;
    let is_unset = [qx, qy, qz, qw] == [0.0; 4];
    // The yaw of roll, pitch and yaw about fixed axes (REP 103).
    let heading = (2.0 * (qw * qz + qx * qy)).atan2(qw * qw + qx * qx - qy * qy - qz * qz);
    Ok([x, y, if is_unset { f64::NAN } else { heading }])
}

type WheelAngles = ([String; 2], [f64; 2]);

/// `None` if the message is not about both wheels.
fn wheel_angles(reader: &mut CdrReader<'_>, options: &RowOptions) -> Result<Option<WheelAngles>, CdrError> {
    // A text has a count of four bytes at least.
    let count = reader.count(4, "sequence of names")?;
    let mut found: [Option<(usize, &str)>; 2] = [None, None];
    for index in 0..count {
        let name = reader.text()?;
        let lower = name.to_ascii_lowercase();
        for (side, place) in found.iter_mut().enumerate() {
            let is_it = match &options.joints {
                Some(names) => names[side] == name,
                None => lower.contains(["left", "right"][side]),
            };
            if is_it && place.is_none() {
                *place = Some((index, name));
            }
        }
    }
    let positions = reader.sequence(8)?;
    let [Some((left, left_name)), Some((right, right_name))] = found else {
        return Ok(None);
    };
    let angles = positions.double(left).zip(positions.double(right));
    Ok(angles.map(|(left, right)| ([shorten(left_name), shorten(right_name)], [left, right])))
}

/// The range in a direction, if the scan covers it and something was there.
fn range_at(reader: &mut CdrReader<'_>, bearing_rad: f64) -> Result<Option<f64>, CdrError> {
    let angle_min = f64::from(reader.f32()?);
    reader.f32()?;
    let increment = f64::from(reader.f32()?);
    reader.f32()?;
    reader.f32()?;
    let (min_m, max_m) = (reader.f32()?, reader.f32()?);
    let ranges = reader.sequence(4)?;
    if !(increment.is_finite() && angle_min.is_finite()) || increment == 0.0 {
        return Ok(None);
    }
    // The same direction counts from either end: a scan may go from 0 to a whole turn.
    let turn = std::f64::consts::TAU;
    let steps = [0.0, turn, -turn].map(|more| ((bearing_rad + more - angle_min) / increment).round());
    let index = steps.into_iter().find(|step| *step >= 0.0 && *step < ranges.count() as f64);
    let range = index.and_then(|index| ranges.single(index as usize));
    Ok(range.filter(|range| range.is_finite() && (min_m..=max_m).contains(range)).map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::super::bag_reader::BagReader;
    use super::super::summary::sensor_of;
    use super::*;

    /// See `make_bags.py` beside it.
    const BAGS: [&[u8]; 2] = [
        include_bytes!("../../../tests/data/ros2/rosbags-zstd.mcap"),
        include_bytes!("../../../tests/data/ros2/big-endian-lz4.mcap"),
    ];

    #[test]
    fn a_message_that_is_cut_anywhere_is_an_error_or_has_all_that_is_read() {
        for bag in BAGS {
            let mut reader = BagReader::open(bag).unwrap();
            let mut kinds = Vec::new();
            while let Some(message) = reader.next().unwrap() {
                let Ok(sensor) = sensor_of(message.channel) else { continue };
                let whole = decode(sensor, &RowOptions::default(), message.data).unwrap();
                let cuts: Vec<_> = (0..message.data.len())
                    .map(|length| decode(sensor, &RowOptions::default(), &message.data[..length]))
                    .collect();
                let complete = cuts.iter().position(Result::is_ok).unwrap_or(cuts.len());
                assert!(cuts[complete..].iter().all(|cut| cut.as_ref() == Ok(&whole)), "{sensor:?}");
                // What is not read is behind it: speeds and efforts of joints, intensities of a scan.
                assert!(complete + 32 >= message.data.len(), "{sensor:?} is complete after {complete} bytes");
                kinds.push(sensor);
            }
            kinds.dedup();
            assert!(kinds.len() >= TYPES.len(), "{kinds:?}");
        }
    }

    #[test]
    fn a_type_is_known_by_its_name_and_its_fields() {
        let of = |name: &str, encoding: &str, definition: &str| {
            let (name, encoding, definition) = (name.to_owned(), encoding.to_owned(), definition.to_owned());
            SensorType::of_schema(&BagSchema { name, encoding, definition })
        };
        let pose = "# where it is\nint8 X=1\nstd_msgs/Header header\n\ngeometry_msgs/Pose pose # the pose\n=====\nMSG: a/B\nfloat64 c\n";
        assert_eq!(of("geometry_msgs/msg/PoseStamped", "ros2msg", pose), Ok(SensorType::PoseStamped));
        assert_eq!(
            of("geometry_msgs/msg/PoseStamped", "ros2idl", "module geometry_msgs {"),
            Ok(SensorType::PoseStamped)
        );
        assert_eq!(of("sensor_msgs/msg/Image", "ros2msg", ""), Err(TopicRefusal::OtherType));
        let error = of("geometry_msgs/msg/PoseStamped", "ros2msg", "std_msgs/Header header\nPose2D pose\n");
        let TopicRefusal::Unreadable(why) = error.unwrap_err() else { panic!("the type is known") };
        assert!(why.contains("`Pose2D pose`"), "{why}");
        assert!(of("geometry_msgs/msg/PoseStamped", "protobuf", pose).is_err());
    }

    #[test]
    fn the_range_ahead_is_found_from_either_end_of_a_whole_turn() {
        for (angle_min, increment, bearing_rad, expected) in [
            (0.0, 1.0, 0.0, Some(10.0)),
            (0.0, 1.0, -1.28, Some(15.0)),
            (-3.0, 1.0, 0.0, Some(13.0)),
            (3.0, -1.0, 0.0, Some(13.0)),
            (1.0, 0.1, 0.0, None),
            (0.0, 0.0, 0.0, None),
        ] {
            let mut message = b"\0\x01\0\0".to_vec();
            for value in [angle_min, 0.0, increment, 0.0, 0.0, 0.5, 100.0_f32] {
                message.extend(value.to_le_bytes());
            }
            message.extend(6_u32.to_le_bytes());
            message.extend((0_u8..6).flat_map(|index| (10.0 + f32::from(index)).to_le_bytes()));
            let mut reader = CdrReader::open(&message).unwrap();
            assert_eq!(range_at(&mut reader, bearing_rad), Ok(expected), "{angle_min} {increment} {bearing_rad}");
        }
    }
}
