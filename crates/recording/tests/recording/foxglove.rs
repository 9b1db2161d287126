//! The outputs of a recording: their channels, of several robots as well, and how they are thinned. What is in them is in
//! `golden_outputs`.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;

use posebridge_recording::container::{
    FORMAT, INPUT_TOPIC, RecordingGap, RecordingHeader, RecordingWriter, TruthSample,
};
use posebridge_recording::foxglove::CHANNELS;
use posebridge_telemetry::{
    Address, Calibration, Command, Event, FusionOutcome, Heading, Input, LinkId, Meters, Pose, RobotId, TimeDelta,
    Timestamp,
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

fn writer_with(spacing: TimeDelta) -> RecordingWriter<Cursor<Vec<u8>>> {
    let header = RecordingHeader { format: FORMAT, utc_start_micros: UTC_START_MICROS, ..RecordingHeader::default() };
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header).unwrap();
    writer.set_output_spacing(spacing);
    writer
}

pub(crate) fn write_messages(
    spacing: TimeDelta,
    write: impl FnOnce(&mut RecordingWriter<Cursor<Vec<u8>>>),
) -> Vec<RecordedMessage> {
    let mut writer = writer_with(spacing);
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

fn only<'a>(found: &'a [RecordedMessage], topic: &str) -> &'a RecordedMessage {
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
    // A compared filter's name is the last part of its topics.
    let topic_of = |found: &RecordedMessage| found.topic.trim_end_matches("/ekf5").to_owned();
    let topics: BTreeSet<String> = found.iter().map(topic_of).collect();
    let table: BTreeSet<String> = CHANNELS.iter().map(|channel| channel.topic.to_owned()).collect();
    assert_eq!(topics, table);
    let schemas: BTreeMap<&str, &str> = CHANNELS.iter().map(|one| (one.topic, one.schema)).collect();
    for found in &found {
        assert_eq!(found.schema, schemas[topic_of(found).as_str()]);
        assert!(!found.schema_data.is_empty(), "{} has no schema", found.topic);
    }
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

pub(crate) fn read(found: &RecordedMessage) -> DecodedFields {
    protobuf::read(&found.schema_data, &found.schema, &found.data)
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

const SPACING: TimeDelta = TimeDelta::from_millis(50);

fn left() -> RobotId {
    RobotId { link: LinkId(2), address: Address::new(2, 1) }
}

fn named() -> Event {
    Event::RobotNamed { robot: left(), name: "left".to_owned() }
}

fn estimated(robot: RobotId, millis: i64) -> Event {
    Event::EstimateUpdated { robot, estimate: estimate(millis) }
}

fn fused(robot: RobotId) -> Event {
    let Event::ObservationFused { record, .. } = fused_event(FusionOutcome::Accepted, 1.0) else {
        panic!("another event");
    };
    Event::ObservationFused { robot, record }
}

fn on<'a>(found: &'a [RecordedMessage], topic: &str) -> Vec<&'a RecordedMessage> {
    found.iter().filter(|found| found.topic == topic).collect()
}

#[test]
fn the_poses_of_two_robots_are_on_two_topics_and_each_is_thinned_by_itself() {
    let found = write_messages(SPACING, |writer| {
        writer.record_event(Timestamp::ZERO, &named()).unwrap();
        // The second robot comes 10 ms behind the first, and half as often.
        for n in 0..100 {
            let now = 10 * n;
            writer.record_event(Timestamp::from_millis(now), &estimated(robot(), now)).unwrap();
            if n % 2 == 1 {
                writer.record_event(Timestamp::from_millis(now), &estimated(left(), now)).unwrap();
                writer.record_event(Timestamp::from_millis(now), &fused(left())).unwrap();
            }
        }
    });
    for (topic, expected) in [
        ("/posebridge/pose", 20),
        ("/posebridge/odometry", 20),
        ("posebridge/estimate", 20),
        ("posebridge/fusion", 0),
        // It comes every 20 ms, so that every third is due.
        ("/robots/left/pose", 17),
        ("/robots/left/odometry", 17),
        ("/robots/left/ellipse", 17),
        ("/robots/left/estimate", 17),
        ("/robots/left/fusion", 17),
        ("/robots/left/path", 1),
    ] {
        assert_eq!(on(&found, topic).len(), expected, "{topic}");
    }
}

#[test]
fn the_path_of_a_robot_has_no_pose_of_another() {
    let found = write_messages(TimeDelta::ZERO, |writer| {
        for n in 0..30_i64 {
            let now = Timestamp::from_millis(100 * n);
            for (robot, east_m) in [(robot(), 1.0), (left(), 2.0)] {
                let mut estimate = estimate(100 * n);
                estimate.pose = Pose::new(Meters(east_m), Meters(0.0), Heading::from_rad(0.0));
                writer.record_event(now, &Event::EstimateUpdated { robot, estimate }).unwrap();
            }
        }
    });
    for (topic, east_m) in [("/posebridge/path", 1.0), ("/robots/2_2_1/path", 2.0)] {
        let paths = on(&found, topic);
        assert_eq!(paths.len(), 2, "{topic}");
        assert_eq!(read(paths[1]).numbers("poses.position.x"), [east_m; 21], "{topic}");
    }
}

#[test]
fn the_next_part_goes_on_with_the_topics_of_the_part_before() {
    let mut state = None;
    write_messages(TimeDelta::ZERO, |writer| {
        for event in [named(), estimated(robot(), 0), estimated(left(), 0)] {
            writer.record_event(Timestamp::ZERO, &event).unwrap();
        }
        let fresh = writer_with(TimeDelta::ZERO);
        state = Some(std::mem::replace(writer, fresh).finish_part().unwrap());
    });
    let found = write_messages(TimeDelta::ZERO, |writer| {
        writer.restore_outputs(state.take().unwrap());
        writer.record_event(Timestamp::from_millis(10), &estimated(left(), 10)).unwrap();
    });
    let topics: BTreeSet<&str> = found.iter().map(|found| found.topic.as_str()).collect();
    assert!(topics.contains("/robots/left/pose") && !topics.contains("/posebridge/pose"), "{topics:?}");
}

#[test]
fn robots_beyond_the_64th_are_counted_and_told_and_their_truth_is_kept() {
    let robot_of = |system| RobotId { link: LinkId(0), address: Address::new(system, 1) };
    let found = write_messages(TimeDelta::ZERO, |writer| {
        for system in 1..=66 {
            writer.record_event(Timestamp::ZERO, &estimated(robot_of(system), 0)).unwrap();
        }
        assert_eq!(writer.skipped_outputs(), 2);
        let pose = Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(3.0));
        let robot = Some(robot_of(66));
        let sample = TruthSample { robot, time: Timestamp::ZERO, pose, odometry: None };
        writer.record_truth(Timestamp::ZERO, &[sample]).unwrap();
        assert_eq!(writer.skipped_outputs(), 3);
    });
    let poses = found.iter().filter(|found| found.topic.ends_with("/pose"));
    assert_eq!(poses.map(|found| &found.topic).collect::<BTreeSet<_>>().len(), 64);
    assert!(read(only(&found, "/log")).text("message").contains("more than 64 robots"));
    assert_eq!(json(only(&found, "posebridge/truth"))["system"], 66);
}
