//! Several robots in one recording: each is on topics of its own, and what is written of it depends on no other.

use std::collections::BTreeSet;

use posebridge_recording::container::TruthSample;
use posebridge_telemetry::{
    Address, Calibration, Event, FusionOutcome, Heading, LinkId, Meters, Pose, RobotId, TimeDelta, Timestamp,
};

use crate::events::{aligned_event, estimate, fused_event, robot};
use crate::foxglove::{
    RecordedMessage, UTC_START_MICROS, json, near, only, read, write_messages, writer as new_writer,
};

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

/// As [`aligned_event`], at this instant of the host's clock.
fn aligned(robot: RobotId, host_millis: i64) -> Event {
    let Event::BrickClockAligned { offset, skew_ppm, uncertainty, round_trip, brick, .. } = aligned_event() else {
        panic!("another event");
    };
    let host = Timestamp::from_millis(host_millis);
    Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host }
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
fn a_robot_has_a_frame_of_its_own_and_the_first_keeps_its_names() {
    let found = write_messages(TimeDelta::ZERO, |writer| {
        for event in [estimated(robot(), 0), named(), estimated(left(), 0)] {
            writer.record_event(Timestamp::ZERO, &event).unwrap();
        }
    });
    let children: Vec<String> = on(&found, "/tf").iter().map(|found| read(found).text("child_frame_id")).collect();
    assert_eq!(children, ["body", "left/body"]);
    for (topic, body) in [("/posebridge/odometry", "body"), ("/robots/left/odometry", "left/body")] {
        let odometry = read(only(&found, topic));
        assert_eq!((odometry.text("body_frame_id").as_str(), odometry.text("frame_id").as_str()), (body, "arena"));
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
fn the_truth_of_a_robot_stands_where_its_own_clock_was() {
    let truth = |robot| TruthSample {
        robot,
        time: Timestamp::from_millis(5_000),
        pose: Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(3.0)),
        odometry: None,
    };
    let found = write_messages(TimeDelta::ZERO, |writer| {
        writer.record_event(Timestamp::ZERO, &aligned(robot(), 1_000)).unwrap();
        writer.record_event(Timestamp::ZERO, &aligned(left(), 3_000)).unwrap();
        writer.record_truth(Timestamp::ZERO, &[truth(Some(robot())), truth(Some(left())), truth(None)]).unwrap();
    });
    let seconds = |found: &RecordedMessage| (found.log_time - UTC_START_MICROS * 1_000) as f64 * 1e-9;
    let first: Vec<f64> = on(&found, "/truth/pose").into_iter().map(seconds).collect();
    assert_eq!(first.len(), 2);
    near(first[0], 1.0);
    near(first[1], 1.0);
    near(seconds(only(&found, "/robots/2_2_1/truth/pose")), 3.0);
    let records: Vec<_> = on(&found, "posebridge/truth").into_iter().map(json).collect();
    let systems: Vec<_> =
        records.iter().map(|record| record.get("system").and_then(serde_json::Value::as_u64)).collect();
    assert_eq!(systems, [Some(1), Some(2), None]);
}

#[test]
fn clock_and_calibration_of_a_robot_are_on_its_topics() {
    let found = write_messages(TimeDelta::ZERO, |writer| {
        for event in [aligned_event(), aligned(left(), 3_000)] {
            writer.record_event(Timestamp::ZERO, &event).unwrap();
        }
        for robot in [None, Some(robot()), Some(left())] {
            writer.record_calibration(Timestamp::ZERO, robot, &Calibration::default()).unwrap();
        }
    });
    let topics = ["posebridge/clock", "/robots/2_2_1/clock", "posebridge/calibration", "/robots/2_2_1/calibration"];
    assert_eq!(topics.map(|topic| on(&found, topic).len()), [1, 1, 2, 1]);
}

#[test]
fn the_next_part_goes_on_with_the_topics_of_the_part_before() {
    let mut state = None;
    write_messages(TimeDelta::ZERO, |writer| {
        for event in [named(), estimated(robot(), 0), estimated(left(), 0)] {
            writer.record_event(Timestamp::ZERO, &event).unwrap();
        }
        let fresh = new_writer(TimeDelta::ZERO);
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
