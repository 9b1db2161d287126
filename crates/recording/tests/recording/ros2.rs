//! A bag as another program finds it: topics, frames and times of several robots. The bytes of the messages are held by the crate's own
//! tests, and `tests/peers/test_ros2.py` reads a whole bag with rosbags.

use posebridge_recording::ros2::{RosBagError, RosBagWriter};
use posebridge_telemetry::{
    Address, Estimate, Event, HostClock, LinkId, LinkState, Observation, ObservationKind, RadiansPerSecond, RobotId,
    SensorId, TimeDelta, Timestamp, Validity,
};

use crate::events::{aligned_event, estimate, events};

const UTC_START_MICROS: u64 = 1_700_000_000_000_000;

struct BagRecord {
    topic: String,
    schema: String,
    log_time: u64,
    data: Vec<u8>,
}

fn write_bag(events: &[(i64, Event)]) -> (Vec<BagRecord>, Vec<u8>) {
    let mut writer = RosBagWriter::create(Vec::new(), UTC_START_MICROS).unwrap();
    for (millis, event) in events {
        writer.record(Timestamp::from_millis(*millis), event).unwrap();
    }
    let (bytes, count) = writer.finish().unwrap();
    let found = mcap::MessageStream::new(&bytes).unwrap().map(|message| {
        let message = message.unwrap();
        assert_eq!(message.channel.message_encoding, "cdr");
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(schema.encoding, "ros2msg");
        assert!(message.channel.metadata["offered_qos_profiles"].starts_with("- history: 1\n  depth: 10\n"));
        assert!(message.channel.metadata["topic_type_hash"].starts_with("RIHS01_"));
        BagRecord {
            topic: message.channel.topic.clone(),
            schema: schema.name.clone(),
            log_time: message.log_time,
            data: message.data.to_vec(),
        }
    });
    let found: Vec<BagRecord> = found.collect();
    assert_eq!(found.len() as u64, count);
    (found, bytes)
}

fn robot(system: u8) -> RobotId {
    RobotId { link: LinkId(0), address: Address::new(system, 1) }
}

fn updated(robot: RobotId, estimate: &Estimate) -> Event {
    Event::EstimateUpdated { robot, estimate: *estimate }
}

fn named(robot: RobotId, name: &str) -> Event {
    Event::RobotNamed { robot, name: name.to_owned() }
}

fn of_topic<'a>(found: &'a [BagRecord], topic: &str) -> Vec<&'a BagRecord> {
    found.iter().filter(|one| one.topic == topic).collect()
}

/// Seconds and nanoseconds at the beginning of a message with a header.
fn stamp(found: &BagRecord) -> (u32, u32) {
    let number = |at: usize| u32::from_le_bytes(found.data[at..at + 4].try_into().unwrap());
    (number(4), number(8))
}

/// Whether a text of CDR with this content is in the message.
fn names(found: &BagRecord, text: &str) -> bool {
    let mut encoded = (text.len() as u32 + 1).to_le_bytes().to_vec();
    encoded.extend_from_slice(text.as_bytes());
    encoded.push(0);
    found.data.windows(encoded.len()).any(|window| window == encoded)
}

#[test]
fn a_bag_has_the_profile_of_ros_and_a_summary() {
    let all: Vec<(i64, Event)> = events().into_iter().map(|event| (1_100, event)).collect();
    let (found, bytes) = write_bag(&all);
    // The magic, the opcode and the length of the header before the length of the profile.
    assert_eq!(&bytes[17..25], b"\x04\0\0\0ros2");
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, found.len() as u64);
    assert!(found.iter().any(|one| one.schema == "nav_msgs/msg/Odometry"));
    assert!(found.iter().any(|one| one.schema == "diagnostic_msgs/msg/DiagnosticArray"));
}

#[test]
fn the_log_time_is_the_arrival_and_the_stamp_the_instant_of_the_estimate() {
    let (found, _) = write_bag(&[(900, aligned_event(robot(1), 1_000)), (1_100, updated(robot(1), &estimate(5_000)))]);
    let odometry = of_topic(&found, "/odom");
    assert_eq!(odometry[0].log_time, UTC_START_MICROS * 1_000 + 1_100_000_000);
    // The brick's clock shows 5 s at one second of the host.
    assert_eq!(stamp(odometry[0]), (1_700_000_001, 0));
}

#[test]
fn robots_have_topics_and_frames_of_their_names() {
    let (found, _) = write_bag(&[
        (10, updated(robot(1), &estimate(10))),
        (20, named(robot(2), "left #1")),
        (30, updated(robot(2), &estimate(30))),
        (40, named(robot(3), "left/1")),
        (50, updated(robot(3), &estimate(50))),
        (60, updated(robot(4), &estimate(60))),
    ]);
    for (topic, body) in [
        ("/odom", "base_link"),
        ("/left_1/odom", "left_1/base_link"),
        ("/left_1_2/odom", "left_1_2/base_link"),
        ("/robot_0_4_1/odom", "robot_0_4_1/base_link"),
    ] {
        let odometry = of_topic(&found, topic);
        assert_eq!(odometry.len(), 1, "{topic}");
        assert!(names(odometry[0], "map") && names(odometry[0], body), "{topic}");
    }
    assert_eq!(of_topic(&found, "/tf").len(), 4);
}

#[test]
fn a_name_that_comes_before_the_first_estimate_counts_also_for_the_first_robot() {
    let (found, _) = write_bag(&[(10, named(robot(1), "red")), (20, updated(robot(1), &estimate(20)))]);
    assert_eq!(of_topic(&found, "/red/odom").len(), 1);
    assert_eq!(of_topic(&found, "/red/pose").len(), 1);
    assert!(of_topic(&found, "/odom").is_empty());
}

#[test]
fn a_relative_estimate_is_in_odom_and_no_pose_in_the_map() {
    let relative = |millis| {
        let validity = Validity { position: false, heading: false, speeds: true };
        Estimate { validity, ..estimate(millis) }
    };
    let without_heading = {
        let validity = Validity { position: true, heading: false, speeds: true };
        Estimate { validity, ..estimate(100) }
    };
    let (found, _) = write_bag(&[
        (50, updated(robot(1), &relative(50))),
        (100, updated(robot(1), &without_heading)),
        (150, updated(robot(1), &estimate(150))),
    ]);
    let odometry = of_topic(&found, "/odom");
    assert_eq!(odometry.len(), 2);
    assert!(names(odometry[0], "odom") && !names(odometry[0], "map"));
    assert!(names(odometry[1], "map"));
    assert_eq!(of_topic(&found, "/pose").len(), 1);
    let transforms = of_topic(&found, "/tf");
    // Two transforms, once there is a map.
    let counts: Vec<u8> = transforms.iter().map(|one| one.data[4]).collect();
    assert_eq!(counts, [1, 2]);
}

#[test]
fn an_instant_has_one_transform() {
    let again = updated(robot(1), &estimate(50));
    let (found, _) = write_bag(&[
        (40, aligned_event(robot(1), 1_000)),
        (1_050, again.clone()),
        (1_060, again),
        (1_070, updated(robot(1), &estimate(49))),
    ]);
    assert_eq!(of_topic(&found, "/odom").len(), 3);
    assert_eq!(of_topic(&found, "/tf").len(), 1);
}

#[test]
fn the_turn_rate_of_a_gyro_is_that_of_an_imu() {
    let observation = Observation {
        sensor: SensorId(7),
        stamp: Timestamp::from_millis(50),
        stamp_sigma: TimeDelta::ZERO,
        measurement: ObservationKind::TurnRate(RadiansPerSecond(-0.5)),
    };
    let arrival = Timestamp::<HostClock>::from_millis(60);
    let event = Event::ObservationAligned { robot: robot(1), source: robot(1).address, arrival, observation };
    let (found, _) = write_bag(&[(60, event)]);
    let [imu] = of_topic(&found, "/imu")[..] else { panic!("{} messages", found.len()) };
    assert_eq!(imu.schema, "sensor_msgs/msg/Imu");
    assert!(imu.data.windows(8).any(|window| window == (-0.5_f64).to_le_bytes()));
}

#[test]
fn a_link_that_is_down_is_an_error() {
    let level = |found: &BagRecord| {
        // Header, stamp, an empty text (five bytes, filled up to eight), the count.
        found.data[4 + 8 + 8 + 4]
    };
    let (found, _) = write_bag(&[
        (10, Event::Link { link: LinkId(0), state: LinkState::Down }),
        (20, Event::Link { link: LinkId(0), state: LinkState::Up }),
        (30, Event::RobotLost { robot: robot(1), silence: TimeDelta::from_millis(5_000) }),
    ]);
    assert_eq!(found.iter().map(level).collect::<Vec<_>>(), [1, 0, 3]);
}

#[test]
fn what_does_not_fit_into_the_times_of_ros_is_refused() {
    let late = RosBagWriter::create(Vec::new(), 1 << 52).err();
    assert!(matches!(late, Some(RosBagError::StartTime(_))), "{late:?}");
    let mut writer = RosBagWriter::create(Vec::new(), UTC_START_MICROS).unwrap();
    let early = writer.record(Timestamp::from_millis(-1), &named(robot(1), "red")).err();
    assert!(matches!(early, Some(RosBagError::NegativeTime(_))), "{early:?}");
}
