//! Fixes from anywhere: every message that carries one, several cameras at once, JSON beside MAVLink, spaces that jump, and questions.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/station.rs"]
#[expect(dead_code, reason = "here every input names its link")]
mod station;

use brick::{BRICK, HEARTBEAT, frame, messages, ticks};
use posebridge_protocol::bricks::{CodecSettings, brick_protocol};
use posebridge_protocol::message::{
    CommandAck, Heartbeat, Message, Odometry, OdometryPose, TimeSync, VisionFix, WireStamp,
};
use posebridge_station::{BrickLink, FixRequestConfig, StationConfig};
use posebridge_telemetry::{
    Address, Event, FusionOutcome, FusionRecord, Heading, HostClock, Input, LinkId, Meters, MetersPerSecond,
    Observation, ObservationKind, Output, PeerId, Pose, RadiansPerSecond, ReceiveError, SensorId, TimeDelta, Timestamp,
};
use station::{LINK, TestStation, at, config, link};

/// A camera that speaks MAVLink on a link of its own.
const TRACKER: Address = Address::new(1, 100);
const TRACKER_LINK: LinkId = LinkId(5);
/// Cameras that speak JSON.
const JSON_LINK: LinkId = LinkId(6);
/// What the clocks show at host zero.
const BRICK_AHEAD_MS: i64 = 100_000;
const TRACKER_AHEAD_MS: i64 = 500_000;
const JSON_AHEAD_MS: i64 = 7_000;
/// Where the tracker says that the robot is; the robot starts at the origin.
const PLACE_M: [f64; 2] = [0.012, -0.008];

fn three_links() -> StationConfig {
    let mut config = config();
    config.links.push(link(TRACKER_LINK, vec![]));
    let mut json = link(JSON_LINK, vec![]);
    json.brick = Some(BrickLink {
        protocol: brick_protocol("camera-json").expect("there is a row"),
        settings: CodecSettings::default(),
    });
    config.links.push(json);
    config
}

fn push_bytes(station: &mut TestStation, now: Timestamp<HostClock>, link: LinkId, bytes: &[u8]) {
    let peer = PeerId::default();
    let bytes = bytes.to_vec();
    station.handle(now, Input::Bytes { link, peer, bytes });
}

/// What the clock of a participant shows, in milliseconds.
fn clock_reading_ms(now: Timestamp<HostClock>, ahead_ms: i64) -> i64 {
    now.as_micros() / 1_000 + ahead_ms
}

/// Everybody answers the time requests of the last tenth of a second, and the robot, which stands, tells its wheels.
fn tenth(station: &mut TestStation, k: i64) {
    let now = at(100 * k);
    let before = station.outputs.len();
    station.pass_until(now);
    let requests: Vec<(LinkId, i64, Timestamp<HostClock>)> = station.outputs[before..]
        .iter()
        .filter_map(|(sent, output)| match output {
            Output::Transmit { link, bytes, .. } => Some((*link, request_in(*link, bytes)?, *sent)),
            Output::Event(_) | Output::Request(_) => None,
        })
        .collect();
    for (link, request, sent) in requests {
        let answered = sent + TimeDelta::from_millis(1);
        let bytes = answer(link, request, answered);
        push_bytes(station, answered + TimeDelta::from_millis(1), link, &bytes);
    }
    let wheels = ticks(clock_reading_ms(now, BRICK_AHEAD_MS) as u32, 0, 0);
    push_bytes(station, now + TimeDelta::from_millis(3), LINK, &frame(BRICK, &wheels));
}

/// The number of a time request.
fn request_in(link: LinkId, bytes: &[u8]) -> Option<i64> {
    if link == JSON_LINK {
        let text = std::str::from_utf8(bytes).expect("JSON is text");
        let (_, number) = text.split_once("\"time_request\":")?;
        return number.trim_end_matches(['}', '\n']).parse().ok();
    }
    messages(bytes).iter().find_map(|message| match message {
        Message::TimeSync(sync) if sync.answer_nanos == 0 => Some(sync.request_nanos),
        _ => None,
    })
}

fn answer(link: LinkId, request: i64, now: Timestamp<HostClock>) -> Vec<u8> {
    let (who, ahead_ms) = match link {
        LINK => (BRICK, BRICK_AHEAD_MS),
        TRACKER_LINK => (TRACKER, TRACKER_AHEAD_MS),
        _ => {
            let time_us = now.as_micros() + JSON_AHEAD_MS * 1_000;
            let line = format!("{{\"time_answer\": {request}, \"time_us\": {time_us}}}\n");
            return line.into_bytes();
        }
    };
    let sync = TimeSync { answer_nanos: now.as_nanos() + ahead_ms * 1_000_000, request_nanos: request, target: None };
    frame(who, &Message::TimeSync(sync))
}

/// A station that has talked with everybody for a second and knows the robot.
fn station_of(config: &StationConfig) -> TestStation {
    let mut station = TestStation::new(config);
    push_bytes(&mut station, at(1), LINK, &frame(BRICK, &HEARTBEAT));
    for k in 1..=12 {
        tenth(&mut station, k);
    }
    station
}

/// The fixes that were observed, each with its verdict and arrival.
fn fixes(station: &TestStation) -> Vec<(Observation, FusionOutcome, Timestamp<HostClock>)> {
    let mut observed = None;
    let mut found = vec![];
    for event in station.events() {
        match event {
            Event::ObservationAligned { observation, arrival, .. } => observed = Some((*observation, *arrival)),
            Event::ObservationFused { record: FusionRecord { outcome: verdict, .. }, .. } => {
                if let Some((observation, arrival)) = observed.take()
                    && matches!(observation.measurement, ObservationKind::Fix(_))
                {
                    found.push((observation, *verdict, arrival));
                }
            }
            _ => {}
        }
    }
    found
}

fn vision_fix(exposed: Timestamp<HostClock>, reset_counter: u8) -> VisionFix {
    VisionFix {
        stamp: WireStamp::Micros64((clock_reading_ms(exposed, TRACKER_AHEAD_MS) * 1_000) as u64),
        x: Meters(PLACE_M[0]),
        y: Meters(PLACE_M[1]),
        heading: Some(Heading::from_rad(0.01)),
        covariance: Some([1e-6, 0.0, 1e-6, 1e-4]),
        reset_counter,
        tag: None,
    }
}

fn odometry(exposed: Timestamp<HostClock>) -> Message {
    let fix = vision_fix(exposed, 0);
    Message::Odometry(Odometry {
        stamp: fix.stamp,
        pose: OdometryPose::Arena(Pose::new(fix.x, fix.y, Heading::from_rad(0.01))),
        forward_speed: MetersPerSecond(0.0),
        turn_rate: RadiansPerSecond(0.0),
        covariance: Some([1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-4]),
        reset_counter: 0,
        quality: 0,
    })
}

fn json_fix(camera: &str, exposed: Timestamp<HostClock>) -> Vec<u8> {
    let exposed_us = exposed.as_micros() + JSON_AHEAD_MS * 1_000;
    let [x_m, y_m] = PLACE_M;
    let line = format!(
        "{{\"camera\": \"{camera}\", \"exposed_us\": {exposed_us}, \"x_m\": {x_m}, \"y_m\": {y_m}, \
         \"heading_rad\": 0.01, \"sigma_m\": 0.001, \"sigma_heading_rad\": 0.01}}\n"
    );
    line.into_bytes()
}

#[test]
fn every_message_that_carries_a_fix_moves_the_pose_at_its_own_time() {
    let exposed = at(1_150);
    let without_sigma = VisionFix { covariance: None, ..vision_fix(exposed, 0) };
    for (name, link, bytes) in [
        ("VISION_POSITION_ESTIMATE", TRACKER_LINK, frame(TRACKER, &Message::VisionPosition(vision_fix(exposed, 0)))),
        (
            "VISION_POSITION_ESTIMATE without covariance",
            TRACKER_LINK,
            frame(TRACKER, &Message::VisionPosition(without_sigma)),
        ),
        ("ATT_POS_MOCAP", TRACKER_LINK, frame(TRACKER, &Message::MocapPosition(vision_fix(exposed, 0)))),
        ("ODOMETRY", TRACKER_LINK, frame(TRACKER, &odometry(exposed))),
        (
            "another component on the robot's link",
            LINK,
            // Its clock was never heard there: it is aligned from scratch below.
            frame(Address::new(1, 191), &Message::VisionPosition(vision_fix(exposed, 0))),
        ),
        ("JSON", JSON_LINK, json_fix("camera", exposed)),
    ] {
        let mut station = station_of(&three_links());
        push_bytes(&mut station, at(1_300), link, &bytes);
        let found = fixes(&station);
        if link == LINK {
            assert_eq!(found.len(), 0, "{name}: its clock is not known yet");
            let source = Address::new(1, 191);
            let unaligned = ReceiveError::ClockNotAligned { source };
            let is_told = |event: &Event| matches!(event, Event::ReceiveError { defect, .. } if *defect == unaligned);
            assert!(station.events().any(is_told), "{name}");
            continue;
        }
        let [(observation, verdict, arrival)] = found[..] else {
            panic!("{name}: {found:?}");
        };
        assert_eq!((verdict, arrival), (FusionOutcome::Accepted, at(1_300)), "{name}");
        let expected = Timestamp::from_millis(clock_reading_ms(exposed, BRICK_AHEAD_MS));
        let off_ms = (observation.stamp - expected).as_millis_f64();
        assert!(off_ms.abs() < 2.0, "{name}: {off_ms} ms");
        let latest = station.engine.latest_time().expect("it has observed");
        let estimate = station.engine.estimate_at(latest).expect("it knows");
        let moved_m = estimate.pose.origin().x.0;
        assert!((0.005..0.0125).contains(&moved_m), "{name}: {moved_m}");
    }
}

#[test]
fn a_fix_without_a_time_counts_at_its_arrival_less_the_declared_delay() {
    let mut station = station_of(&three_links());
    let line = b"{\"camera\": \"plain\", \"x_m\": 0.01, \"y_m\": 0}\n";
    push_bytes(&mut station, at(1_300), JSON_LINK, line);
    let [(observation, FusionOutcome::Accepted, _)] = fixes(&station)[..] else {
        panic!("{:?}", fixes(&station));
    };
    // 60 ms, give or take 40.
    let expected = Timestamp::from_millis(clock_reading_ms(at(1_240), BRICK_AHEAD_MS));
    let off_ms = (observation.stamp - expected).as_millis_f64();
    assert!(off_ms.abs() < 2.0, "{off_ms}");
    let sigma_ms = observation.stamp_sigma.as_millis_f64();
    assert!((40.0 / 3.0_f64.sqrt()..26.0).contains(&sigma_ms), "{sigma_ms}");
}

#[test]
fn each_camera_is_a_sensor_of_its_own_with_a_clock_of_its_own() {
    let mut station = station_of(&three_links());
    let exposed = at(1_250);
    let tracked = frame(TRACKER, &Message::VisionPosition(vision_fix(exposed, 0)));
    push_bytes(&mut station, at(1_300), TRACKER_LINK, &tracked);
    push_bytes(&mut station, at(1_301), JSON_LINK, &json_fix("camera", exposed));
    let line = b"{\"camera\": \"plain\", \"x_m\": 0.01, \"y_m\": 0}\n";
    push_bytes(&mut station, at(1_302), JSON_LINK, line);
    push_bytes(&mut station, at(1_303), TRACKER_LINK, &tracked);
    let found: Vec<(SensorId, FusionOutcome)> =
        fixes(&station).iter().map(|(observation, verdict, _)| (observation.sensor, *verdict)).collect();
    let names: Vec<&str> = found.iter().map(|(sensor, _)| sensor.name()).collect();
    assert_eq!(names, ["camera", "camera 2", "camera 3", "camera"]);
    assert!(found[..3].iter().all(|(_, verdict)| *verdict == FusionOutcome::Accepted), "{found:?}");
    // The clock of each is known: no stamp was refused.
    let is_unaligned =
        |event: &Event| matches!(event, Event::ReceiveError { defect: ReceiveError::ClockNotAligned { .. }, .. });
    assert!(!station.events().any(is_unaligned));
}

#[test]
fn when_the_space_of_a_tracker_jumps_the_estimate_goes_there_as_a_counted_reset() {
    let mut station = station_of(&three_links());
    let mut told = |at_ms: i64, x_m: f64, reset_counter: u8| {
        let fix = VisionFix { x: Meters(x_m), ..vision_fix(at(at_ms - 50), reset_counter) };
        let bytes = frame(TRACKER, &Message::VisionPosition(fix));
        push_bytes(&mut station, at(at_ms), TRACKER_LINK, &bytes);
        let (_, verdict, _) = *fixes(&station).last().expect("it was observed");
        let latest = station.engine.latest_time().expect("it has observed");
        let estimate = station.engine.estimate_at(latest).expect("it knows");
        (verdict, estimate.reset_counter, estimate.pose.origin().x.0)
    };
    // The first word of a tracker is no jump, whatever its counter.
    assert_eq!(told(1_300, 0.0, 4).0, FusionOutcome::Accepted);
    // Far away without a word about it: refused.
    assert_eq!(told(1_350, 2.0, 4).0, FusionOutcome::Gated);
    let (verdict, resets, x_m) = told(1_400, 2.0, 5);
    assert_eq!((verdict, resets), (FusionOutcome::PoseReset, 1));
    assert!((x_m - 2.0).abs() < 1e-3, "{x_m}");
    assert_eq!(told(1_450, 2.0, 5).0, FusionOutcome::Accepted);
}

#[test]
fn a_camera_whose_time_falls_begins_anew_and_is_used_again_when_its_clock_is_known() {
    let mut station = station_of(&three_links());
    push_bytes(&mut station, at(1_290), JSON_LINK, &json_fix("camera", at(1_250)));
    assert_eq!(fixes(&station).len(), 1);
    // Switched off and on: its clock began at zero 5 s later than before, so to speak.
    let line = b"{\"exposed_s\": 0.5, \"x_m\": 0.01, \"y_m\": 0}\n";
    push_bytes(&mut station, at(1_295), JSON_LINK, line);
    assert_eq!(fixes(&station).len(), 1);
    let is_told = |event: &Event| matches!(event, Event::ReceiveError { defect: ReceiveError::ClockNotAligned { source }, .. } if *source == TRACKER);
    assert!(station.events().any(is_told));
}

#[test]
fn a_payload_that_is_refused_is_counted_each_time_and_explained_once() {
    let mut station = station_of(&three_links());
    let failed = Message::Odometry(match odometry(at(1_200)) {
        Message::Odometry(odometry) => Odometry { quality: -1, ..odometry },
        other => panic!("{other:?}"),
    });
    for k in 0..3 {
        push_bytes(&mut station, at(1_300 + k), TRACKER_LINK, &frame(TRACKER, &failed));
    }
    let count = |wanted: &dyn Fn(&Event) -> bool| station.events().filter(|event| wanted(event)).count();
    let is_refused =
        |event: &Event| matches!(event, Event::ReceiveError { defect: ReceiveError::Payload { message_id: 331 }, .. });
    assert_eq!(count(&is_refused), 3);
    let is_explained = |event: &Event| matches!(event, Event::Text { text, .. } if text.contains("it has failed"));
    assert_eq!(count(&is_explained), 1);
    assert_eq!(fixes(&station).len(), 0);
}

/// Who was asked for a fix, with the instant.
fn fix_requests(station: &TestStation) -> Vec<(LinkId, i64)> {
    let outputs = station.outputs.iter();
    let asked = outputs.filter_map(|(now, output)| {
        let Output::Transmit { link, bytes, .. } = output else {
            return None;
        };
        let is_question = if *link == JSON_LINK {
            bytes.windows(11).any(|part| part == b"fix_request")
        } else {
            messages(bytes).iter().any(|message| {
                matches!(message, Message::Command(command)
                    if command.command == 512 && command.params[0] == 102.0 && command.target == TRACKER)
            })
        };
        is_question.then_some((*link, now.as_micros() / 1_000))
    });
    asked.collect()
}

/// A camera's sign of life.
fn camera_heartbeat() -> Vec<u8> {
    let heartbeat = Heartbeat { vehicle_type: 30, autopilot: 8, base_mode: 0, system_status: 4 };
    frame(TRACKER, &Message::Heartbeat(heartbeat))
}

fn requesting_config(above_m: f64) -> StationConfig {
    StationConfig {
        fix_requests: FixRequestConfig {
            above_m: Some(above_m),
            above_rad: None,
            interval: TimeDelta::from_millis(250),
        },
        ..three_links()
    }
}

#[test]
fn only_cameras_that_answer_are_asked_and_those_that_refuse_not_again() {
    // The start's sigma is 10 mm.
    let mut station = station_of(&requesting_config(0.009));
    assert_eq!(fix_requests(&station), []);
    push_bytes(&mut station, at(1_210), TRACKER_LINK, &camera_heartbeat());
    let hello = b"{\"camera\": \"a\", \"takes_requests\": true}\n{\"camera\": \"b\", \"x_m\": 9, \"y_m\": 9}\n";
    push_bytes(&mut station, at(1_211), JSON_LINK, hello);
    tenth(&mut station, 13);
    assert_eq!(fix_requests(&station), [(TRACKER_LINK, 1_303), (JSON_LINK, 1_303)]);
    let refusal = CommandAck { command: 512, result: 3, target: None };
    push_bytes(&mut station, at(1_320), TRACKER_LINK, &frame(TRACKER, &Message::CommandAck(refusal)));
    for k in 14..=30 {
        tenth(&mut station, k);
    }
    // Every 250 ms at the soonest, which with telemetry each 100 ms is each 300; it never reacts and rests after four.
    let later = fix_requests(&station)[2..].to_vec();
    assert_eq!(later, [(JSON_LINK, 1_603), (JSON_LINK, 1_903), (JSON_LINK, 2_203)]);
}

#[test]
fn nobody_is_asked_while_the_station_is_sure_enough() {
    let mut station = station_of(&requesting_config(0.009));
    push_bytes(&mut station, at(1_210), TRACKER_LINK, &camera_heartbeat());
    let fix = frame(TRACKER, &Message::VisionPosition(vision_fix(at(1_200), 0)));
    push_bytes(&mut station, at(1_220), TRACKER_LINK, &fix);
    for k in 13..=20 {
        tenth(&mut station, k);
    }
    assert_eq!(fix_requests(&station), []);
}
