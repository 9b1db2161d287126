//! The truth of simulated robots beside the inputs.

use std::io::Cursor;

use posebridge_recording::container::{ReadError, RecordingWriter, TRUTH_TOPIC, TruthSample, read_truth};
use posebridge_telemetry::{Address, Heading, LinkId, Meters, Pose, RobotId, Timestamp};

use crate::header;

const LEFT: RobotId = RobotId { link: LinkId(0), address: Address::new(1, 1) };
const RIGHT: RobotId = RobotId { link: LinkId(300), address: Address::new(2, 200) };

fn sample(robot: Option<RobotId>, millis: i64) -> TruthSample {
    let pose = Pose::new(Meters(1.5), Meters(-2.0), Heading::from_rad(0.5));
    TruthSample { robot, time: Timestamp::from_millis(millis), pose, odometry: None }
}

fn recording(samples: &[TruthSample]) -> Vec<u8> {
    let mut writer = RecordingWriter::create(Cursor::new(Vec::new()), &header()).unwrap();
    writer.record_truth(Timestamp::from_millis(2_000), samples).unwrap();
    writer.finish().unwrap().into_inner()
}

/// A recording of [`RIGHT`] with one text in the JSON of its sample replaced by another of the same length.
fn damaged(text: &str, by: &str) -> Vec<u8> {
    assert_eq!(text.len(), by.len());
    let mut bytes = recording(&[sample(Some(RIGHT), 20)]);
    let at = bytes.windows(text.len()).position(|found| found == text.as_bytes()).unwrap();
    bytes[at..at + by.len()].copy_from_slice(by.as_bytes());
    bytes
}

#[test]
fn the_truth_of_two_robots_comes_back_with_its_robots() {
    let samples = [
        sample(Some(LEFT), 20),
        sample(Some(RIGHT), 20),
        TruthSample { odometry: Some(sample(None, 0).pose), ..sample(Some(RIGHT), 40) },
        sample(Some(LEFT), 60),
    ];
    assert_eq!(read_truth(&recording(&samples)).unwrap(), samples);
}

#[test]
fn the_truth_of_the_only_robot_has_no_ids_in_message_and_schema() {
    let bytes = recording(&[sample(None, 20)]);
    let mut messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let truth = messages.find(|message| message.channel.topic == TRUTH_TOPIC).unwrap();
    assert_eq!(&*truth.data, br#"{"brick_nanos":20000000,"x_m":1.5,"y_m":-2.0,"heading_rad":0.5}"#);
    let schema = &truth.channel.schema.as_ref().unwrap().data;
    assert!(!String::from_utf8_lossy(schema).contains("component"));
}

#[test]
fn a_sample_that_names_a_robot_by_halves_is_an_error_that_says_so() {
    for (pair, other) in
        [("\"link\":300", "\"----\":300"), ("\"system\":2", "\"------\":2"), ("\"component\":200", "\"---------\":200")]
    {
        let Err(ReadError::Truth { what, .. }) = read_truth(&damaged(pair, other)) else {
            panic!("{pair} is missing");
        };
        assert!(what.contains("only all three"), "{what}");
    }
}

#[test]
fn an_id_that_no_robot_can_have_is_an_error() {
    let found = read_truth(&damaged("\"component\":200", "\"component\":256"));
    assert!(matches!(found, Err(ReadError::Truth { .. })), "{found:?}");
}
