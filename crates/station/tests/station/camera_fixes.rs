//! Fixes from anywhere: every message that carries one, several cameras at once, JSON beside MAVLink, spaces that jump, and requests.

use crate::support::{
    BRICK, HEARTBEAT, LINK, SentBytes, TestStation, TimeRequest, at, config, frame, link, messages, ticks, vision_fix,
};
use posebridge_protocol::bricks::{CodecSettings, brick_protocol};
use posebridge_protocol::message::{CommandAck, Heartbeat, Message, Odometry, OdometryPose, TimeSync, VisionFix};
use posebridge_station::{BrickLink, FixRequestConfig, OwnershipPolicy, StationConfig};
use posebridge_telemetry::{
    Address, Event, Fix, FusionOutcome, FusionRecord, Heading, HostClock, Input, LinkId, Meters, MetersPerSecond,
    Observation, ObservationKind, Output, OutsideFix, PeerId, Point2, Pose, PositionCovariance, RadiansPerSecond,
    ReceiveError, Recipients, Request, RobotId, SensorId, TimeDelta, Timestamp,
};

/// A camera with MAVLink on a link of its own.
const TRACKER: Address = Address::new(1, 100);
const TRACKER_LINK: LinkId = LinkId(5);
/// Cameras with JSON.
const JSON_LINK: LinkId = LinkId(6);
/// What the clocks show at host zero.
const BRICK_AHEAD_MS: i64 = 100_000;
const TRACKER_AHEAD_MS: i64 = 500_000;
const JSON_AHEAD_MS: i64 = 7_000;
/// Position of the robot by the tracker; the robot starts at the origin.
const POSITION_M: [f64; 2] = [0.012, -0.008];

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

/// What the clock of a participant shows, in milliseconds.
fn clock_reading_ms(now: Timestamp<HostClock>, ahead_ms: i64) -> i64 {
    now.as_micros() / 1_000 + ahead_ms
}

/// All peers answer the time requests of the last tenth of a second, and the robot, which is at rest, sends its wheels.
fn tenth(station: &mut TestStation, k: i64) {
    let now = at(100 * k);
    let before = station.outputs.len();
    station.pass_until(now);
    let requests = station.sent_since(before).filter_map(|sent| request_in(sent));
    for TimeRequest { link, nanos, sent } in requests.collect::<Vec<_>>() {
        let answered = sent + TimeDelta::from_millis(1);
        let bytes = answer(link, nanos, answered);
        station.bytes_from(answered + TimeDelta::from_millis(1), link, PeerId::default(), &bytes);
    }
    let wheels = ticks(clock_reading_ms(now, BRICK_AHEAD_MS) as u32, 0, 0);
    station.bytes_from(now + TimeDelta::from_millis(3), LINK, PeerId::default(), &frame(BRICK, &wheels));
}

fn request_in(sent: SentBytes<'_>) -> Option<TimeRequest> {
    let nanos = if sent.link == JSON_LINK {
        let text = std::str::from_utf8(sent.bytes).expect("JSON is text");
        let (_, number) = text.split_once("\"time_request\":")?;
        number.trim_end_matches(['}', '\n']).parse().ok()
    } else {
        messages(sent.bytes).iter().find_map(|message| match message {
            Message::TimeSync(sync) if sync.answer_nanos == 0 => Some(sync.request_nanos),
            _ => None,
        })
    };
    Some(TimeRequest { sent: sent.now, link: sent.link, nanos: nanos? })
}

fn answer(link: LinkId, request: i64, now: Timestamp<HostClock>) -> Vec<u8> {
    let (camera, ahead_ms) = match link {
        LINK => (BRICK, BRICK_AHEAD_MS),
        TRACKER_LINK => (TRACKER, TRACKER_AHEAD_MS),
        _ => {
            let time_us = now.as_micros() + JSON_AHEAD_MS * 1_000;
            let line = format!("{{\"time_answer\": {request}, \"time_us\": {time_us}}}\n");
            return line.into_bytes();
        }
    };
    let sync = TimeSync { answer_nanos: now.as_nanos() + ahead_ms * 1_000_000, request_nanos: request, target: None };
    frame(camera, &Message::TimeSync(sync))
}

/// A station that has talked with everybody for a second and knows the robot.
fn station_of(config: &StationConfig) -> TestStation {
    let mut station = TestStation::new(config);
    station.bytes_from(at(1), LINK, PeerId::default(), &frame(BRICK, &HEARTBEAT));
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

fn tracked_fix(exposed: Timestamp<HostClock>, reset_counter: u8) -> VisionFix {
    VisionFix {
        y: Meters(POSITION_M[1]),
        heading: Some(Heading::from_rad(0.01)),
        covariance: Some([1e-6, 0.0, 1e-6, 1e-4]),
        reset_counter,
        ..vision_fix(clock_reading_ms(exposed, TRACKER_AHEAD_MS), POSITION_M[0])
    }
}

fn odometry(exposed: Timestamp<HostClock>) -> Message {
    let fix = tracked_fix(exposed, 0);
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
    let [x_m, y_m] = POSITION_M;
    let line = format!(
        "{{\"camera\": \"{camera}\", \"exposed_us\": {exposed_us}, \"x_m\": {x_m}, \"y_m\": {y_m}, \
         \"heading_rad\": 0.01, \"sigma_m\": 0.001, \"sigma_heading_rad\": 0.01}}\n"
    );
    line.into_bytes()
}

#[test]
fn every_message_that_carries_a_fix_moves_the_pose_at_its_own_time() {
    let exposed = at(1_150);
    let without_sigma = VisionFix { covariance: None, ..tracked_fix(exposed, 0) };
    for (name, link, bytes) in [
        ("VISION_POSITION_ESTIMATE", TRACKER_LINK, frame(TRACKER, &Message::VisionPosition(tracked_fix(exposed, 0)))),
        (
            "VISION_POSITION_ESTIMATE without covariance",
            TRACKER_LINK,
            frame(TRACKER, &Message::VisionPosition(without_sigma)),
        ),
        ("ATT_POS_MOCAP", TRACKER_LINK, frame(TRACKER, &Message::MocapPosition(tracked_fix(exposed, 0)))),
        ("ODOMETRY", TRACKER_LINK, frame(TRACKER, &odometry(exposed))),
        (
            "another component on the robot's link",
            LINK,
            // Its clock is new there: it is aligned from scratch below.
            frame(Address::new(1, 191), &Message::VisionPosition(tracked_fix(exposed, 0))),
        ),
        ("JSON", JSON_LINK, json_fix("camera", exposed)),
    ] {
        let mut station = station_of(&three_links());
        station.bytes_from(at(1_300), link, PeerId::default(), &bytes);
        let found = fixes(&station);
        if link == LINK {
            assert_eq!(found.len(), 0, "{name}: its clock is not known yet");
            assert_eq!(station.unaligned(Address::new(1, 191)).len(), 1, "{name}");
            continue;
        }
        let [(observation, verdict, arrival)] = found[..] else {
            panic!("{name}: {found:?}");
        };
        assert_eq!((verdict, arrival), (FusionOutcome::Accepted, at(1_300)), "{name}");
        let expected = Timestamp::from_millis(clock_reading_ms(exposed, BRICK_AHEAD_MS));
        let off_ms = (observation.stamp - expected).as_millis_f64();
        assert!(off_ms.abs() < 2.0, "{name}: {off_ms} ms");
        let latest = station.engine.first_robot().latest_time().expect("it has observed");
        let estimate = station.engine.first_robot().estimate_at(latest).expect("it knows");
        let moved_m = estimate.pose.origin().x.0;
        assert!((0.005..0.0125).contains(&moved_m), "{name}: {moved_m}");
    }
}

#[test]
fn a_fix_without_a_time_counts_at_its_arrival_less_the_declared_delay() {
    let mut station = station_of(&three_links());
    let line = b"{\"camera\": \"plain\", \"x_m\": 0.01, \"y_m\": 0}\n";
    station.bytes_from(at(1_300), JSON_LINK, PeerId::default(), line);
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
    for k in 0..6 {
        let exposed = at(1_250 + 20 * k);
        let arrival = |offset_ms: i64| at(1_300 + 20 * k + offset_ms);
        let tracked = frame(TRACKER, &Message::VisionPosition(tracked_fix(exposed, 0)));
        station.bytes_from(arrival(0), TRACKER_LINK, PeerId::default(), &tracked);
        station.bytes_from(arrival(1), JSON_LINK, PeerId::default(), &json_fix("camera", exposed));
        let line = b"{\"camera\": \"plain\", \"x_m\": 0.01, \"y_m\": 0}\n";
        station.bytes_from(arrival(2), JSON_LINK, PeerId::default(), line);
    }
    let found: Vec<(SensorId, FusionOutcome)> =
        fixes(&station).iter().map(|(observation, verdict, _)| (observation.sensor, *verdict)).collect();
    let verdicts = |camera: &str| {
        let own = found.iter().filter(|(sensor, _)| sensor.name() == camera);
        own.map(|(_, verdict)| *verdict).collect::<Vec<_>>()
    };
    assert_eq!(verdicts("camera"), [FusionOutcome::Accepted; 6]);
    // While the first sees the robot the others have to agree with it a few times.
    let mut newcomer = [FusionOutcome::Unused; 6];
    newcomer[4..].fill(FusionOutcome::Accepted);
    assert_eq!([verdicts("camera 2"), verdicts("camera 3")], [newcomer, newcomer]);
    // The clock of each is known: no stamp was refused.
    assert_eq!(station.count(|event| matches!(event, Event::ReceiveError { .. })), 0);
}

#[test]
fn when_the_space_of_a_tracker_jumps_the_estimate_goes_there_as_a_counted_reset() {
    let mut station = station_of(&three_links());
    let mut observed = |at_ms: i64, x_m: f64, reset_counter: u8| {
        let fix = VisionFix { x: Meters(x_m), ..tracked_fix(at(at_ms - 50), reset_counter) };
        let bytes = frame(TRACKER, &Message::VisionPosition(fix));
        station.bytes_from(at(at_ms), TRACKER_LINK, PeerId::default(), &bytes);
        let (_, verdict, _) = *fixes(&station).last().expect("it was observed");
        let latest = station.engine.first_robot().latest_time().expect("it has observed");
        let estimate = station.engine.first_robot().estimate_at(latest).expect("it knows");
        (verdict, estimate.reset_counter, estimate.pose.origin().x.0)
    };
    // The first fix of a tracker is no jump, whatever its counter.
    assert_eq!(observed(1_300, 0.0, 4).0, FusionOutcome::Accepted);
    // Far away without a changed counter: refused.
    assert_eq!(observed(1_350, 2.0, 4).0, FusionOutcome::Gated);
    let (verdict, resets, x_m) = observed(1_400, 2.0, 5);
    assert_eq!((verdict, resets), (FusionOutcome::PoseReset, 1));
    assert!((x_m - 2.0).abs() < 1e-3, "{x_m}");
    assert_eq!(observed(1_450, 2.0, 5).0, FusionOutcome::Accepted);
}

#[test]
fn a_payload_that_is_refused_is_counted_each_time_and_explained_once() {
    let mut station = station_of(&three_links());
    let failed = Message::Odometry(match odometry(at(1_200)) {
        Message::Odometry(odometry) => Odometry { quality: -1, ..odometry },
        other => panic!("{other:?}"),
    });
    // Twice by each of more senders than are described.
    for k in 0..200 {
        let source = Address::new(7, (k % 100) as u8);
        station.bytes_from(at(1_300 + k), TRACKER_LINK, PeerId::default(), &frame(source, &failed));
    }
    let is_refused =
        |event: &Event| matches!(event, Event::ReceiveError { defect: ReceiveError::Payload { message_id: 331 }, .. });
    assert_eq!(station.count(is_refused), 200);
    let is_explained = |event: &Event| matches!(event, Event::Text { text, .. } if text.contains("it has failed"));
    assert_eq!(station.count(is_explained), 64);
    assert_eq!(fixes(&station).len(), 0);
}

/// The requests for a fix: recipient and instant.
fn fix_requests(station: &TestStation) -> Vec<(LinkId, i64)> {
    let is_request = |sent: &SentBytes<'_>| {
        if sent.link == JSON_LINK {
            return sent.bytes.windows(11).any(|part| part == b"fix_request");
        }
        messages(sent.bytes).iter().any(|message| {
            matches!(message, Message::Command(command)
                if command.command == 512 && command.params[0] == 102.0 && command.target == TRACKER)
        })
    };
    station.sent().filter(is_request).map(|sent| (sent.link, sent.now.as_micros() / 1_000)).collect()
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
fn only_cameras_that_answer_get_requests_and_those_that_refuse_no_more() {
    // The start's sigma is 10 mm.
    let mut station = station_of(&requesting_config(0.009));
    assert_eq!(fix_requests(&station), []);
    station.bytes_from(at(1_210), TRACKER_LINK, PeerId::default(), &camera_heartbeat());
    let hello = b"{\"camera\": \"a\", \"takes_requests\": true}\n{\"camera\": \"b\", \"x_m\": 9, \"y_m\": 9}\n";
    station.bytes_from(at(1_211), JSON_LINK, PeerId::default(), hello);
    tenth(&mut station, 13);
    assert_eq!(fix_requests(&station), [(TRACKER_LINK, 1_303), (JSON_LINK, 1_303)]);
    let refusal = CommandAck { command: 512, result: 3, target: None };
    station.bytes_from(at(1_320), TRACKER_LINK, PeerId::default(), &frame(TRACKER, &Message::CommandAck(refusal)));
    for k in 14..=30 {
        tenth(&mut station, k);
    }
    // Every 250 ms at the soonest, which with telemetry each 100 ms is each 300; it never reacts and rests after four.
    let later = fix_requests(&station)[2..].to_vec();
    assert_eq!(later, [(JSON_LINK, 1_603), (JSON_LINK, 1_903), (JSON_LINK, 2_203)]);
}

#[test]
fn no_fix_is_requested_while_the_estimate_is_certain_enough() {
    let mut station = station_of(&requesting_config(0.009));
    station.bytes_from(at(1_210), TRACKER_LINK, PeerId::default(), &camera_heartbeat());
    let fix = frame(TRACKER, &Message::VisionPosition(tracked_fix(at(1_200), 0)));
    station.bytes_from(at(1_220), TRACKER_LINK, PeerId::default(), &fix);
    for k in 13..=20 {
        tenth(&mut station, k);
    }
    assert_eq!(fix_requests(&station), []);
}

// A room with robots behind one port, each with a camera without a configured address: all cameras have the same ids.

const ROBOTS: u32 = 12;

/// What the camera beside a robot shows at host zero, in milliseconds.
fn camera_ahead_ms(robot: u32) -> i64 {
    1_000_000 + 77_000 * i64::from(robot)
}

fn robot_ahead_ms(robot: u32) -> i64 {
    5_000 + 9_000 * i64::from(robot)
}

fn robot_address(robot: u32) -> Address {
    Address::new(1 + robot as u8, 1)
}

/// Position of a robot: each a little further along the arena.
fn robot_x_m(robot: u32) -> f64 {
    1e-3 * f64::from(robot)
}

fn send(station: &mut TestStation, now: Timestamp<HostClock>, robot: u32, from: Address, message: &Message) {
    station.bytes_from(now, LINK, PeerId(robot), &frame(from, message));
}

/// Robots and cameras answer the time requests of the last tenth of a second; the robots, which are at rest, send their wheels.
fn answer_last_tenth(station: &mut TestStation, k: i64) {
    let now = at(100 * k);
    let before = station.outputs.len();
    station.pass_until(now);
    for request in station.time_requests(before) {
        for robot in 0..ROBOTS {
            for (from, ahead_ms) in [(robot_address(robot), robot_ahead_ms(robot)), (TRACKER, camera_ahead_ms(robot))] {
                let answered = request.sent + TimeDelta::from_millis(1);
                let answer_nanos = answered.as_nanos() + ahead_ms * 1_000_000;
                let sync = Message::TimeSync(TimeSync { answer_nanos, request_nanos: request.nanos, target: None });
                send(station, answered + TimeDelta::from_millis(1), robot, from, &sync);
            }
        }
    }
    for robot in 0..ROBOTS {
        let shown = now.as_micros() / 1_000 + robot_ahead_ms(robot);
        send(station, now + TimeDelta::from_millis(3), robot, robot_address(robot), &ticks(shown as u32, 0, 0));
    }
}

#[test]
fn each_camera_corrects_the_robot_beside_it_by_its_own_clock_and_is_its_first() {
    let mut station = TestStation::new(&config());
    for robot in 0..ROBOTS {
        for from in [robot_address(robot), TRACKER] {
            send(&mut station, at(1), robot, from, &HEARTBEAT);
        }
    }
    for k in 1..=15 {
        answer_last_tenth(&mut station, k);
    }
    let exposed = at(1_480);
    for robot in 0..ROBOTS {
        let exposed_ms = exposed.as_micros() / 1_000 + camera_ahead_ms(robot);
        let fix = VisionFix { covariance: Some([1e-6, 0.0, 1e-6, 1e-4]), ..vision_fix(exposed_ms, robot_x_m(robot)) };
        send(&mut station, at(1_510), robot, TRACKER, &Message::VisionPosition(fix));
    }
    let fixes = station.aligned().into_iter().filter(|aligned| aligned.source == TRACKER);
    let observed = fixes.map(|aligned| {
        let index = u32::from(aligned.robot.address.system.0) - 1;
        let expected_ms = exposed.as_micros() / 1_000 + robot_ahead_ms(index);
        let off = aligned.observation.stamp - Timestamp::from_millis(expected_ms);
        assert!(off.as_millis_f64().abs() < 3.0, "robot {index} is off by {off:?}");
        (index, aligned.observation.sensor)
    });
    assert_eq!(observed.collect::<Vec<_>>(), (0..ROBOTS).map(|robot| (robot, SensorId::CAMERA)).collect::<Vec<_>>());
    for robot in station.engine.robots() {
        let latest = robot.latest_time().expect("it was observed");
        let x_m = robot.estimate_at(latest).expect("it was observed").pose.x.0;
        let expected_m = robot_x_m(u32::from(robot.id().address.system.0) - 1);
        assert!((x_m - expected_m).abs() <= 0.1 * expected_m, "{x_m} {expected_m}");
    }
}

#[test]
fn a_robots_broadcast_goes_to_the_ground_station_and_to_no_other_robot() {
    let mut station = TestStation::new(&config());
    let ground_station = PeerId(ROBOTS);
    let gcs_heartbeat = Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 });
    for robot in 0..ROBOTS {
        send(&mut station, at(1), robot, robot_address(robot), &HEARTBEAT);
        send(&mut station, at(2), robot, robot_address(robot), &ticks(1_000, 0, 0));
    }
    let recipients_of = |station: &mut TestStation, from: u32, address, message: &Message, now| {
        let before = station.outputs.len();
        send(station, now, from, address, message);
        let bytes = frame(address, message);
        // The sequence number is that of the first frame in both.
        let sent = station.sent_since(before).filter(|sent| sent.bytes == bytes);
        sent.map(|sent| sent.to).collect::<Vec<Recipients>>()
    };
    let all_others = vec![Recipients::AllExcept(ground_station)];
    assert_eq!(recipients_of(&mut station, ROBOTS, Address::new(254, 190), &gcs_heartbeat, at(3)), all_others);
    let of_robot = recipients_of(&mut station, 4, robot_address(4), &ticks(1_050, 7, 8), at(50));
    assert_eq!(of_robot, [Recipients::Peer(ground_station)]);
}

/// What another station or program says, whose time is on the host's clock.
fn outside_fix(exposed: Timestamp<HostClock>) -> Input {
    let [x_m, y_m] = POSITION_M;
    let fix = Fix {
        position: Point2::new(Meters(x_m), Meters(y_m)),
        heading: Some(Heading::from_rad(0.01)),
        covariance: Some(PositionCovariance { xx_m2: 1e-6, xy_m2: 0.0, yy_m2: 1e-6, heading_rad2: 1e-4 }),
        tag_in_body: Point2::new(Meters(0.0), Meters(0.0)),
        reset_counter: 0,
    };
    let uncertainty = TimeDelta::from_millis(6);
    let fix = OutsideFix { source: Address::new(1, 100), time: exposed, uncertainty, fix };
    Input::OutsideFix { robot: RobotId { link: LINK, address: BRICK }, fix }
}

#[test]
fn a_fix_from_outside_moves_the_pose_at_its_time_and_the_error_of_that_time_is_part_of_it() {
    let mut station = station_of(&three_links());
    station.handle(at(1_300), outside_fix(at(1_150)));
    let (observation, verdict, arrival) = fixes(&station)[0];
    assert_eq!((verdict, arrival), (FusionOutcome::Accepted, at(1_300)));
    let exposed_ms = clock_reading_ms(at(1_150), BRICK_AHEAD_MS) as f64;
    assert!((observation.stamp.as_nanos() as f64 / 1e6 - exposed_ms).abs() < 2.0, "{:?}", observation.stamp);
    // Anywhere within 6 ms, and what is not known of the robot's clock: a uniform distribution has 1/sqrt(3) of that.
    let sigma_ms = observation.stamp_sigma.as_millis_f64();
    assert!((6.0 / 3.0_f64.sqrt()..5.0).contains(&sigma_ms), "{sigma_ms} ms");
    // A camera of this station with the same address is another one.
    tenth(&mut station, 13);
    station.bytes_from(
        at(1_400),
        TRACKER_LINK,
        PeerId::default(),
        &frame(TRACKER, &Message::VisionPosition(tracked_fix(at(1_350), 0))),
    );
    let sensors: Vec<SensorId> = fixes(&station).iter().map(|(observation, ..)| observation.sensor).collect();
    assert_eq!(sensors, [SensorId::camera(0), SensorId::camera(1)]);
    // One for a robot that is not known is left.
    let stranger = RobotId { link: LINK, address: Address::new(9, 1) };
    let Input::OutsideFix { fix, .. } = outside_fix(at(1_350)) else { panic!("it is one") };
    station.handle(at(1_410), Input::OutsideFix { robot: stranger, fix });
    assert_eq!(fixes(&station).len(), 2);
}

#[test]
fn in_a_fleet_a_fix_of_a_tag_is_shared_with_its_time_on_the_host_s_clock() {
    for (ownership, shared) in [(OwnershipPolicy::Unmanaged, 0), (OwnershipPolicy::Fleet, 1)] {
        let mut station = station_of(&StationConfig { ownership, ..three_links() });
        let line = String::from_utf8(json_fix("camera", at(1_150))).unwrap();
        let tagged = line.replace("\"x_m\"", "\"tag\": 7, \"x_m\"");
        for line in [&line, &tagged] {
            station.bytes_from(at(1_300), JSON_LINK, PeerId::default(), line.as_bytes());
        }
        let requests: Vec<_> = station
            .outputs
            .iter()
            .filter_map(|(_, output)| match output {
                Output::Request(Request::ShareFix { tag, fix }) => Some((*tag, fix)),
                _ => None,
            })
            .collect();
        assert_eq!(requests.len(), shared);
        for (tag, shared) in requests {
            assert_eq!((tag, shared.fix.position.x), (7, Meters(POSITION_M[0])));
            assert!((shared.time - at(1_150)).as_millis_f64().abs() < 2.0, "{:?}", shared.time);
            assert!(shared.uncertainty > TimeDelta::ZERO && shared.uncertainty < TimeDelta::from_millis(5));
        }
    }
}
