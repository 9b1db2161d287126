//! The outputs of a recording: every message matches its channel's schema and its event.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;

use posebridge_recording::container::{
    FORMAT, INPUT_TOPIC, RecordingGap, RecordingHeader, RecordingWriter, TruthSample,
};
use posebridge_recording::foxglove::CHANNELS;
use posebridge_telemetry::{
    Calibration, Command, Event, FusionOutcome, Heading, Input, Meters, Pose, TimeDelta, Timestamp,
};
use serde_json::Value;

use crate::events::{estimate, events, fused_event, robot};
use crate::protobuf::{self, DecodedFields};

pub(crate) const UTC_START_MICROS: u64 = 1_700_000_000_000_000;

/// A message as another program finds it.
pub(crate) struct RecordedMessage {
    pub(crate) topic: String,
    pub(crate) encoding: String,
    pub(crate) schema: String,
    pub(crate) schema_data: Vec<u8>,
    pub(crate) log_time: u64,
    pub(crate) data: Vec<u8>,
}

pub(crate) fn writer(spacing: TimeDelta) -> RecordingWriter<Cursor<Vec<u8>>> {
    let header = RecordingHeader { format: FORMAT, utc_start_micros: UTC_START_MICROS, ..RecordingHeader::default() };
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header).unwrap();
    writer.set_output_spacing(spacing);
    writer
}

pub(crate) fn write_messages(
    spacing: TimeDelta,
    write: impl FnOnce(&mut RecordingWriter<Cursor<Vec<u8>>>),
) -> Vec<RecordedMessage> {
    let mut writer = writer(spacing);
    write(&mut writer);
    let bytes = writer.finish().unwrap().into_inner();
    let found = mcap::MessageStream::new(&bytes).unwrap().map(|message| {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        RecordedMessage {
            topic: message.channel.topic.clone(),
            encoding: schema.encoding.clone(),
            schema: schema.name.clone(),
            schema_data: schema.data.to_vec(),
            log_time: message.log_time,
            data: message.data.to_vec(),
        }
    });
    found.filter(|found| found.topic != INPUT_TOPIC).collect()
}

/// Every channel has a message.
pub(crate) fn one_message_of_each() -> Vec<RecordedMessage> {
    write_messages(TimeDelta::ZERO, |writer| {
        let now = Timestamp::from_millis(1_100);
        for event in events() {
            writer.record_event(now, &event).unwrap();
        }
        let set_pose = Command::SetPose {
            pose: Pose::new(Meters(0.0), Meters(0.0), Heading::from_rad(0.0)),
            position_sigma_m: 0.01,
            heading_sigma_rad: 0.1,
        };
        writer.record(now, &Input::Command(set_pose)).unwrap();
        let learned = Calibration::default();
        writer.record_calibration(now, None, &learned).unwrap();
        let gap = RecordingGap { inputs: 7, from: now, to: Timestamp::from_millis(1_200) };
        writer.record_gap(&gap).unwrap();
        let truth = TruthSample {
            robot: None,
            time: Timestamp::from_millis(5_100),
            pose: Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(3.0)),
            odometry: None,
        };
        writer.record_truth(now, &[truth]).unwrap();
    })
}

pub(crate) fn only<'a>(found: &'a [RecordedMessage], topic: &str) -> &'a RecordedMessage {
    let mut of_topic = found.iter().filter(|found| found.topic == topic);
    let one = of_topic.next().unwrap();
    assert!(of_topic.next().is_none(), "{topic} has more than one");
    one
}

pub(crate) fn json(found: &RecordedMessage) -> Value {
    serde_json::from_slice(&found.data).unwrap()
}

#[test]
fn every_channel_is_written_with_the_schema_of_the_table() {
    let found = one_message_of_each();
    let topics: BTreeSet<&str> = found.iter().map(|found| found.topic.as_str()).collect();
    let table: BTreeSet<&str> = CHANNELS.iter().map(|channel| channel.topic).collect();
    assert_eq!(topics, table);
    let schemas: BTreeMap<&str, &str> = CHANNELS.iter().map(|one| (one.topic, one.schema)).collect();
    for found in &found {
        assert_eq!(found.schema, schemas[found.topic.as_str()]);
        assert!(!found.schema_data.is_empty(), "{} has no schema", found.topic);
    }
}

#[test]
fn every_protobuf_message_has_the_fields_of_its_descriptor() {
    let found = one_message_of_each();
    let mut checked = 0;
    for found in found.iter().filter(|found| found.encoding == "protobuf") {
        let fields = protobuf::read(&found.schema_data, &found.schema, &found.data);
        assert!(!fields.is_empty(), "{} says nothing", found.topic);
        checked += 1;
    }
    assert!(checked > 8, "{checked}");
}

/// What of a JSON schema our records need: objects of numbers, texts and lists, without references or alternatives.
pub(crate) fn assert_valid(value: &Value, schema: &Value, path: &str) {
    let kind = schema["type"].as_str();
    let kind = kind.unwrap_or_else(|| panic!("{path}: no single type in {schema}"));
    match kind {
        "object" => {
            let properties = schema["properties"].as_object().unwrap();
            let object = value.as_object().unwrap();
            for (key, value) in object {
                let property = properties.get(key);
                let property = property.unwrap_or_else(|| panic!("{path}.{key} is unknown"));
                assert!(property["description"].is_string(), "{path}.{key}");
                assert_valid(value, property, &format!("{path}.{key}"));
            }
            for key in schema["required"].as_array().into_iter().flatten() {
                assert!(object.contains_key(key.as_str().unwrap()), "{path}: {key}");
            }
        }
        "array" => {
            for item in value.as_array().unwrap() {
                assert_valid(item, &schema["items"], &format!("{path}[]"));
            }
        }
        "number" => assert!(value.is_number(), "{path}: {value}"),
        "integer" => assert!(value.is_i64() || value.is_u64(), "{path}: {value}"),
        "string" => assert!(value.is_string(), "{path}: {value}"),
        "boolean" => assert!(value.is_boolean(), "{path}: {value}"),
        other => panic!("{path}: viewers do not know {other}"),
    }
}

pub(crate) fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "{found} {expected}");
}

pub(crate) fn read(found: &RecordedMessage) -> DecodedFields {
    protobuf::read(&found.schema_data, &found.schema, &found.data)
}

#[test]
fn an_estimate_is_an_odometry_at_its_own_instant() {
    let found = one_message_of_each();
    let message = only(&found, "/posebridge/odometry");
    let odometry = read(message);
    // When it came: 1.1 s after the start. For when it holds: 50 ms behind the alignment at 1 s, by a clock that is a thousandth fast.
    assert_eq!(message.log_time, UTC_START_MICROS * 1_000 + 1_100_000_000);
    assert_eq!(odometry.number("timestamp.seconds"), 1_700_000_001.0);
    near(odometry.number("timestamp.nanos") * 1e-9, (0.05_f64 / 1.001 * 1e9).round() * 1e-9);
    assert_eq!(odometry.text("frame_id"), "arena");
    assert_eq!(odometry.text("body_frame_id"), "body");
    near(odometry.number("pose.position.x"), 1.5);
    near(odometry.number("pose.position.y"), -0.25);
    near(odometry.number("pose.orientation.z"), 0.3_f64.sin());
    near(odometry.number("pose.orientation.w"), 0.3_f64.cos());
    near(odometry.number("linear_velocity.x"), 0.2);
    near(odometry.number("angular_velocity.z"), -0.5);
    let pose = odometry.numbers("pose_covariance");
    let velocity = odometry.numbers("velocity_covariance");
    assert_eq!((pose.len(), velocity.len()), (36, 36));
    let of = estimate(0).covariance;
    // Rows and columns x, y, z, roll, pitch, yaw.
    for (at, expected) in [(0, of[0][0]), (1, of[0][1]), (5, of[0][2]), (7, of[1][1])] {
        near(pose[at], expected);
    }
    for (at, expected) in [(30, of[2][0]), (31, of[2][1]), (35, of[2][2]), (14, 0.0)] {
        near(pose[at], expected);
    }
    for (at, expected) in [(0, of[3][3]), (5, of[3][4]), (30, of[4][3]), (35, of[4][4])] {
        near(velocity[at], expected);
    }
}

#[test]
fn the_ellipse_holds_95_percent() {
    let found = write_messages(TimeDelta::ZERO, |writer| {
        let mut round = estimate(5_000);
        round.covariance[0][1] = 0.0;
        round.covariance[1][0] = 0.0;
        round.covariance[0][0] = 4e-4;
        round.covariance[1][1] = 1e-4;
        let estimated = Event::EstimateUpdated { robot: robot(), estimate: round };
        writer.record_event(Timestamp::ZERO, &estimated).unwrap();
    });
    let scene = read(only(&found, "/posebridge/ellipse"));
    let sigmas = (-2.0 * 0.05_f64.ln()).sqrt();
    near(scene.number("entities.cylinders.size.x"), 2.0 * sigmas * 0.02);
    near(scene.number("entities.cylinders.size.y"), 2.0 * sigmas * 0.01);
    near(scene.number("entities.cylinders.bottom_scale"), 1.0);
    assert_eq!(scene.text("entities.id"), "ellipse");
}

#[test]
fn estimates_are_thinned_and_what_was_not_accepted_stays() {
    let found = write_messages(TimeDelta::from_millis(50), |writer| {
        for n in 0..100 {
            let now = Timestamp::from_millis(10 * n);
            let estimated = Event::EstimateUpdated { robot: robot(), estimate: estimate(10 * n) };
            writer.record_event(now, &estimated).unwrap();
            let verdict = if n == 33 { FusionOutcome::Gated } else { FusionOutcome::Accepted };
            writer.record_event(now, &fused_event(verdict, 1.0)).unwrap();
        }
    });
    let count = |topic: &str| found.iter().filter(|found| found.topic == topic).count();
    assert_eq!(count("/posebridge/odometry"), 20);
    assert_eq!(count("posebridge/estimate"), 20);
    assert_eq!(count("posebridge/fusion"), 21);
    assert_eq!(count("/posebridge/path"), 1);
    let gated = |found: &&RecordedMessage| json(found)["verdict"] == "gated";
    let fusions = found.iter().filter(|found| found.topic == "posebridge/fusion");
    assert_eq!(fusions.filter(gated).count(), 1);
}

#[test]
fn the_path_stays_small_and_reaches_from_the_start_to_here() {
    let found = write_messages(TimeDelta::ZERO, |writer| {
        for n in 0..3_000_i64 {
            let mut moving = estimate(100 * n);
            moving.pose = Pose::new(Meters(n as f64), Meters(0.0), Heading::from_rad(0.0));
            let estimated = Event::EstimateUpdated { robot: robot(), estimate: moving };
            let now = Timestamp::from_millis(100 * n);
            writer.record_event(now, &estimated).unwrap();
        }
    });
    let last = found.iter().rfind(|found| found.topic == "/posebridge/path");
    let path = read(last.unwrap());
    let east = path.numbers("poses.position.x");
    assert!((100..256).contains(&east.len()), "{}", east.len());
    // Zero is not written in protocol buffers: the pose at the start has no x.
    assert!(east.first().is_some_and(|x| *x <= 32.0));
    assert!(east.last().is_some_and(|x| *x > 2_950.0));
}

#[test]
fn a_line_keeps_its_words_and_its_severity() {
    let found = one_message_of_each();
    let lines: Vec<(String, f64)> = found
        .iter()
        .filter(|found| found.topic == "/log")
        .map(|found| {
            let line = read(found);
            (line.text("message"), line.number("level"))
        })
        .collect();
    let level_of = |words: &str| {
        let line = lines.iter().find(|(text, _)| text.contains(words));
        line.unwrap_or_else(|| panic!("{words}: {lines:?}")).1
    };
    assert_eq!(level_of("motor hot"), 4.0);
    assert_eq!(level_of("robot 0/1/1 detected"), 2.0);
    assert_eq!(level_of("link 0 is down"), 3.0);
    assert_eq!(level_of("7 inputs are missing"), 4.0);
    assert_eq!(level_of("moved to a fix"), 3.0);
}

#[test]
fn the_truth_stands_where_the_brick_s_clock_was() {
    let found = one_message_of_each();
    let at = only(&found, "posebridge/truth").log_time;
    // 100 ms behind the alignment, by a clock that is a thousandth fast.
    let since_s = (at - UTC_START_MICROS * 1_000) as f64 * 1e-9;
    near(since_s, (1e9 + (0.1_f64 / 1.001 * 1e9).round()) * 1e-9);
    let pose = read(only(&found, "/truth/pose"));
    near(pose.number("pose.position.y"), 2.0);
}
