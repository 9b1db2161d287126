//! A recording that is sent as a robot would send it.

use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_protocol::message::{Message, Odometry, OdometryPose, WireStamp};
use posebridge_protocol::recorded_robot::RecordedRobot;
use posebridge_telemetry::{
    BrickClock, DriveGeometry, EncoderTicks, Meters, MetersPerSecond, Observation, ObservationKind, Radians,
    RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};

use crate::support::at;

/// One degree per count, wheels of different size.
const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(0.03),
    right_wheel_radius: Meters(0.05),
    track_width: Meters(0.1),
    tick: Radians(std::f64::consts::PI / 180.0),
};
const START: Timestamp<BrickClock> = Timestamp::from_millis(40_000);

fn robot() -> RecordedRobot {
    RecordedRobot::new(START, GEOMETRY, "ada")
}

fn decoded(bytes: &[u8]) -> Vec<Message> {
    let mut framer = Framer::new(FramerConfig::default());
    let mut messages = Vec::new();
    framer.push(at(0), bytes, &mut |found| match found {
        FramerOutput::Frame(frame) => messages.extend(decode(&frame).expect("a whole message")),
        other => panic!("{other:?}"),
    });
    messages
}

/// The one message of an observation.
fn sent_for(robot: &mut RecordedRobot, after_start_ms: i64, measurement: ObservationKind) -> Message {
    let stamp = START + TimeDelta::from_millis(after_start_ms);
    robot.take_bytes();
    let sent = robot.send(&Observation { sensor: SensorId::WHEELS, stamp, stamp_sigma: TimeDelta::ZERO, measurement });
    assert!(sent, "no message for {measurement:?}");
    let messages = decoded(&robot.take_bytes());
    assert_eq!(messages.len(), 1, "{messages:?}");
    messages[0].clone()
}

fn turned(left_rad: f64, right_rad: f64) -> ObservationKind {
    ObservationKind::WheelAngles { left: Radians(left_rad), right: Radians(right_rad) }
}

#[test]
fn integer_counts_are_sent_as_counts_and_other_angles_as_distances() {
    let [left, right] = [120.0_f64, -7.0].map(f64::to_radians);
    let Message::WheelTicks(ticks) = sent_for(&mut robot(), 2_500, turned(left, right)) else {
        panic!("no counts");
    };
    assert_eq!((ticks.left, ticks.right), (EncoderTicks(120), EncoderTicks(-7)));
    assert_eq!(ticks.stamp, WireStamp::Micros32(42_500_000));
    // Half a count of either wheel.
    for [left_rad, right_rad] in [[left + 0.5_f64.to_radians(), right], [left, right + 0.5_f64.to_radians()]] {
        let Message::WheelDistance { left, right, .. } = sent_for(&mut robot(), 2_500, turned(left_rad, right_rad))
        else {
            panic!("no distances");
        };
        assert!((left.0 - 0.03 * left_rad).abs() < 1e-6 && (right.0 - 0.05 * right_rad).abs() < 1e-6);
    }
}

#[test]
fn commanded_speeds_are_sent_as_the_pose_to_which_they_lead() {
    let mut robot = robot();
    let speeds = ObservationKind::BodyVelocity { forward: MetersPerSecond(0.5), turn: RadiansPerSecond(0.2) };
    sent_for(&mut robot, 1_000, speeds);
    let Message::Odometry(Odometry { pose: OdometryPose::Odom(pose), .. }) = sent_for(&mut robot, 3_000, speeds) else {
        panic!("no pose that drifts");
    };
    // One metre in the mean direction of a turn of 0.4 rad.
    let found = [pose.x.0, pose.y.0, pose.heading.rad()];
    let expected = [0.2_f64.cos(), 0.2_f64.sin(), 0.4];
    assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{found:?}");
}

#[test]
fn the_description_is_sent_on_request_and_every_five_seconds() {
    let mut robot = robot();
    robot.send_heartbeat_now();
    let [Message::Heartbeat(_), Message::RobotDescription(description)] = &decoded(&robot.take_bytes())[..] else {
        panic!("not a heartbeat and a description");
    };
    assert_eq!((description.name.as_str(), description.ticks_per_turn.round()), ("ada", 360.0));
    let descriptions = |robot: &mut RecordedRobot| {
        let messages = decoded(&robot.take_bytes());
        messages.iter().filter(|message| matches!(message, Message::RobotDescription(_))).count()
    };
    let mut times = Vec::new();
    for second in 1..=30 {
        robot.advance_clock(TimeDelta::from_millis(1_000 * second));
        if descriptions(&mut robot) > 0 {
            times.push(second);
        }
    }
    assert_eq!(times, [5, 10, 15, 20, 25, 30]);
}
