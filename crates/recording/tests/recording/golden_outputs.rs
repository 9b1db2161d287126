//! What other programs read: event lines, CSV files, and the messages of a recording, JSON with their schemas.
//!
//! `tests/data/outputs.txt` has all of it for one set of events. These are contracts: look at a difference before you accept it.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use posebridge_recording::container::TruthSample;
use posebridge_recording::csv::CsvWriter;
use posebridge_recording::event_json::to_json_line;
use posebridge_telemetry::{
    Address, Arena, BeaconId, Calibration, Celsius, ChannelName, Command, Event, Fix, FusionOutcome, Heading, Input,
    LandmarkId, LinkCounts, LinkHealth, LinkId, LinkState, Meters, MetersPerSecond, MetersPerSecondSquared,
    MountedSensor, Mounting, Mountings, Observation, ObservationKind, Point2, Pose, PoseCorrection, PositionCovariance,
    Radians, RadiansPerSecond, ReceiveError, ResetCause, RobotId, SensorId, SignatureError, SourceHealth, TimeDelta,
    Timestamp, UncertainValue,
};
use serde_json::Value;

use crate::MemoryFile;
use crate::events::{aligned_event, estimate, events, fused_event, robot};
use crate::foxglove::{
    RecordedMessage, UTC_START_MICROS, assert_valid, json, one_message_of_each, read, write_messages,
};

fn other_robot(system: u8) -> RobotId {
    RobotId { link: LinkId(2), address: Address::new(system, 1) }
}

fn observation_events() -> Vec<Event> {
    let fix = Fix {
        position: Point2::new(Meters(1.4), Meters(-0.2)),
        heading: None,
        covariance: None,
        tag_in_body: Point2::new(Meters(0.1), Meters(0.2)),
        reset_counter: 7,
    };
    let covariance = PositionCovariance { xx_m2: 1.0, xy_m2: 0.5, yy_m2: 2.0, heading_rad2: f64::INFINITY };
    let observed = [
        ObservationKind::WheelAngles { left: Radians(0.1 + 0.2), right: Radians(-3.0) },
        ObservationKind::OdometerPose(Pose::new(Meters(0.1), Meters(2.0), Heading::from_rad(0.25))),
        ObservationKind::BodyVelocity { forward: MetersPerSecond(0.5), turn: RadiansPerSecond(-1.5) },
        ObservationKind::TurnRate(RadiansPerSecond(1.0 / 3.0)),
        ObservationKind::WheelAccelerations {
            left: MetersPerSecondSquared(1.0),
            right: MetersPerSecondSquared(f64::NAN),
        },
        ObservationKind::Fix(fix),
        ObservationKind::Fix(Fix { heading: Some(Heading::from_rad(1.0)), covariance: Some(covariance), ..fix }),
        ObservationKind::Landmark { id: LandmarkId(4_000_000_000), range: Meters(1.5), bearing: Radians(0.25) },
        ObservationKind::BeaconRange { id: BeaconId(17), range: Meters(1.5) },
        ObservationKind::WallRange(Meters(3.0)),
        ObservationKind::CompassHeading(Heading::from_rad(-1.0)),
        ObservationKind::Temperature(Celsius(21.5)),
    ];
    let event = |(system, measurement)| Event::ObservationAligned {
        robot: other_robot(system),
        source: Address::new(9, system),
        arrival: Timestamp::from_millis(1_234),
        observation: Observation {
            sensor: SensorId(system),
            stamp: Timestamp::from_nanos(1_234_567_891),
            stamp_sigma: TimeDelta::from_micros(12),
            measurement,
        },
    };
    (1..).zip(observed).map(event).collect()
}

fn receive_errors() -> Vec<Event> {
    let source = Address::new(7, 1);
    let defects = [
        ReceiveError::Checksum { message_id: 1, found: 2, expected: 3 },
        ReceiveError::UnframedBytes { bytes: 3 },
        ReceiveError::Timeout { bytes: 4 },
        ReceiveError::ImpossibleHeader { message_id: 5, length: 6 },
        ReceiveError::Payload { message_id: 8 },
        ReceiveError::AddressConflict { message_id: 9 },
        ReceiveError::SequenceGap { source, frames: 4 },
        ReceiveError::SignatureRejected { source, reason: SignatureError::Invalid },
        ReceiveError::ClockNotAligned { source },
    ];
    defects.map(|defect| Event::ReceiveError { link: LinkId(3), defect }).into()
}

/// A counter has the number of its place.
fn health_event() -> Event {
    let health = LinkHealth {
        bytes_in: 1,
        bytes_out: 2,
        frames_in: 3,
        frames_out: 4,
        checksum_errors: 5,
        garbage_bytes: 6,
        unknown_ids: 7,
        foreign_frames: 26,
        timeouts: 8,
        frames_lost: 9,
        reconnects: 10,
        drops_out: 11,
        rejected_frames: 12,
        duplicates: 13,
        address_conflicts: 14,
        forwarded: 15,
        filtered: 16,
        rate_limited: 17,
        excess_requests: 27,
        port: LinkCounts {
            bytes_out: 18,
            drops_out: 19,
            kernel_drops: 24,
            flood_drops: 25,
            peers: 20,
            queued_frames: 21,
            queued_bytes: 22,
            capacity_bytes_per_s: Some(23.5),
        },
        round_trip: None,
        clock_uncertainty: Some(TimeDelta::from_micros(77)),
    };
    let source = |system, frames| SourceHealth { source: Address::new(system, 9), frames, lost: 2 };
    Event::Health { link: LinkId(4), health, sources: vec![source(7, 1), source(8, 3)] }
}

/// Every kind of event, values that are no numbers, and robots with and without names.
fn all_events() -> Vec<Event> {
    let mut broken = estimate(5_000);
    broken.pose = Pose::<Arena>::new(Meters(f64::NAN), Meters(2.0), Heading::from_rad(0.0));
    broken.covariance[0][0] = f64::INFINITY;
    broken.fix_age = None;
    broken.last_correction =
        Some(PoseCorrection { dx_m: 0.1, dy_m: -0.2, turn: Radians(0.3), cause: ResetCause::Relocated });
    let mut all = events();
    all.push(Event::EstimateUpdated { robot: robot(), estimate: broken });
    all.push(fused_event(FusionOutcome::Gated, f64::INFINITY));
    all.extend(observation_events());
    all.extend(receive_errors());
    all.push(health_event());
    all.push(Event::Link { link: LinkId(1), state: LinkState::Up });
    all.push(Event::RobotNamed { robot: other_robot(3), name: "left, \"old\"".to_owned() });
    all.push(Event::EstimateUpdated { robot: other_robot(3), estimate: estimate(7_000) });
    all.push(Event::EstimateUpdated { robot: other_robot(4), estimate: estimate(7_000) });
    all.push(Event::Temperature {
        brick: robot(),
        channel: ChannelName::from_bytes(b"temp2"),
        arrival: Timestamp::ZERO,
        stamp: Timestamp::ZERO,
        shown: Celsius(f64::NAN),
        verdict: FusionOutcome::Malformed,
        settled: None,
    });
    all
}

fn calibration() -> Calibration {
    let number = |value| UncertainValue { value, sigma: value + 0.5 };
    let mut mountings = Mountings::default();
    for (index, sensor) in MountedSensor::ALL.into_iter().enumerate() {
        let first = 17.0 + 3.0 * index as f64;
        mountings[sensor] = Mounting { x_m: number(first), y_m: number(first + 1.0), yaw_rad: number(first + 2.0) };
    }
    Calibration {
        radius_scale: number(1.0),
        radius_difference: number(2.0),
        track_scale: UncertainValue { value: 3.0, sigma: f64::NAN },
        gyro_bias_rad_per_s: number(4.0),
        fix_delay_s: number(5.0),
        tag_forward_m: number(6.0),
        tag_left_m: number(7.0),
        beacon_offset_m: number(8.0),
        beacon_scale: number(9.0),
        landmark_offset_m: number(10.0),
        landmark_scale: number(11.0),
        gyro_scale: number(12.0),
        landmark_delay_s: number(13.0),
        beacon_delay_s: number(14.0),
        range_delay_s: number(15.0),
        compass_delay_s: number(16.0),
        odometry_delay_s: number(40.0),
        backlash_rad: number(41.0),
        mountings,
    }
}

fn csv_files(events: &[Event]) -> BTreeMap<String, String> {
    let mut files = BTreeMap::new();
    let open = |name: &str| Ok(files.entry(name.to_owned()).or_insert_with(MemoryFile::default).clone());
    let mut writer = CsvWriter::new(open);
    for event in events {
        writer.record(Timestamp::from_millis(2_500), event).unwrap();
    }
    let counts = writer.finish().unwrap();
    let files: BTreeMap<_, _> =
        files.into_iter().map(|(name, file)| (name, String::from_utf8(file.content()).unwrap())).collect();
    let lines = |text: &String| text.lines().count() as u64 - 1;
    assert_eq!(counts, files.iter().map(|(name, text)| (name.clone(), lines(text))).collect::<Vec<_>>());
    files
}

#[test]
fn what_other_programs_read_is_as_it_was() {
    let all = all_events();
    let mut outputs = String::from("## event lines\n");
    for event in &all {
        writeln!(outputs, "{}", to_json_line(event)).unwrap();
    }
    for (name, text) in csv_files(&all) {
        write!(outputs, "\n## {name}.csv\n{text}").unwrap();
    }
    let mut messages = one_message_of_each();
    messages.extend(write_messages(TimeDelta::ZERO, |writer| {
        for event in &all {
            writer.record_event(Timestamp::from_millis(1_100), event).unwrap();
        }
        for robot in [None, Some(other_robot(3))] {
            writer.record_calibration(Timestamp::ZERO, robot, &calibration()).unwrap();
        }
        let pose = Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(3.0));
        let sample = TruthSample { robot: Some(other_robot(3)), time: Timestamp::ZERO, pose, odometry: Some(pose) };
        writer.record_truth(Timestamp::ZERO, &[sample]).unwrap();
        // By the robot's own clock, where that is aligned.
        writer.record_event(Timestamp::ZERO, &aligned_event(other_robot(3), 3_000)).unwrap();
        let sample = |robot| TruthSample { robot, time: Timestamp::from_millis(5_000), pose, odometry: None };
        let robots = [Some(robot()), Some(other_robot(3))];
        writer.record_truth(Timestamp::ZERO, &robots.map(sample)).unwrap();
        writer.record(Timestamp::ZERO, &Input::RobotCommand { robot: robot(), command: Command::ResetPose }).unwrap();
    }));
    let mut by_schema: BTreeMap<(&str, &[u8]), Vec<String>> = BTreeMap::new();
    for message in &messages {
        let RecordedMessage { topic, schema, .. } = message;
        if message.encoding == "protobuf" {
            let since_start = message.log_time - UTC_START_MICROS * 1_000;
            let line = format!("[{since_start}] {topic}: {}", read(message));
            by_schema.entry((schema, b"protocol buffers")).or_default().push(line);
            continue;
        }
        let json_schema: Value = serde_json::from_slice(&message.schema_data).unwrap();
        assert_valid(&json(message), &json_schema, topic);
        let line = format!("{topic}: {}", String::from_utf8(message.data.clone()).unwrap());
        by_schema.entry((schema, &message.schema_data)).or_default().push(line);
    }
    for ((name, schema), texts) in by_schema {
        write!(outputs, "\n## {name}\n{}\n{}\n", String::from_utf8_lossy(schema), texts.join("\n")).unwrap();
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/outputs.txt");
    if std::env::var_os("POSEBRIDGE_WRITE_OUTPUTS").is_some() {
        std::fs::write(path, &outputs).unwrap();
    }
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    for (number, (found, expected)) in outputs.lines().zip(kept.lines()).enumerate() {
        assert_eq!(found, expected, "line {} of tests/data/outputs.txt", number + 1);
    }
    assert!(outputs == kept, "run this test with POSEBRIDGE_WRITE_OUTPUTS=1 and look at the difference");
}
