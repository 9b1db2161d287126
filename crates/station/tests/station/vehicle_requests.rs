//! What ground stations ask of a robot as a vehicle: who answers, in which order, and how much one that floods can cause.

use std::collections::BTreeMap;

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, STATION, TestStation, at, config, link, messages, stream, ticks};
use posebridge_protocol::dialect::ids::{self, COMMAND_REQUEST_MESSAGE};
use posebridge_protocol::message::{
    CommandLong, FileTransfer, Heartbeat, LogMessage, Message, PlanContent, PlanMessage, SetMessageInterval, TimeSync,
    WireStamp,
};
use posebridge_protocol::routing::ForwardedDialects;
use posebridge_station::{AnnouncedAs, OutputKind, StationConfig};
use posebridge_telemetry::{Address, GeodeticOrigin, GeodeticPoint, HostClock, Meters, Priority, Radians, Timestamp};

/// A robot that is no vehicle by its own address, as one without MAVLink.
const WITHOUT_VEHICLE: Address = Address::new(1, 25);
const CAMERA: Address = Address::new(1, 100);
const ALL_OF_ROBOT: Address = Address::new(1, 0);

fn two_links() -> StationConfig {
    let mut config = config();
    config.robot_system = Some(BRICK.system);
    let mut gcs = link(GCS_LINK, vec![stream(OutputKind::Attitude, 100), stream(OutputKind::Odometry, 100)]);
    gcs.announced_as = AnnouncedAs::StationAndVehicle;
    gcs.rules.dialects = ForwardedDialects::Stock;
    config.links.push(gcs);
    // So that there is a home position to ask for.
    config.origin = GeodeticOrigin::new(GeodeticPoint { latitude: Radians(0.9), longitude: Radians(0.1) }, Meters(0.0));
    config
}

/// One of each kind of request, to a vehicle.
fn requests(target: Address) -> Vec<Message> {
    let command = |command, first: u32| {
        Message::Command(CommandLong { target, command, params: [first as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] })
    };
    let plan = |content| Message::Plan(PlanMessage { target, plan: 0, content });
    let transfer = |opcode, data: &[u8]| {
        Message::FileTransfer(FileTransfer {
            target,
            sequence: 7,
            session: 0,
            opcode,
            size: data.len() as u8,
            requested_opcode: 0,
            burst_complete: 0,
            offset: 0,
            data: data.to_vec(),
        })
    };
    vec![
        command(COMMAND_REQUEST_MESSAGE, ids::AUTOPILOT_VERSION),
        command(COMMAND_REQUEST_MESSAGE, ids::PROTOCOL_VERSION),
        command(COMMAND_REQUEST_MESSAGE, ids::COMPONENT_METADATA),
        command(COMMAND_REQUEST_MESSAGE, ids::AVAILABLE_MODES),
        command(COMMAND_REQUEST_MESSAGE, ids::SYS_STATUS),
        command(ids::COMMAND_GET_MESSAGE_INTERVAL, ids::SYS_STATUS),
        command(ids::COMMAND_GET_HOME_POSITION, 0),
        Message::ParamRequestRead { target, name: "SLIP_NIS".to_owned(), index: -1 },
        Message::ParamRequestRead { target, name: "_HASH_CHECK".to_owned(), index: -1 },
        Message::ParamSet { target, name: "SLIP_NIS".to_owned(), value: 20.0 },
        plan(PlanContent::RequestList),
        plan(PlanContent::Count { items: 3 }),
        plan(PlanContent::ClearAll),
        plan(PlanContent::SetCurrent { sequence: 0 }),
        plan(PlanContent::RequestInt { sequence: 0 }),
        transfer(4, b"/parameter.json"),
        transfer(15, b""),
        transfer(3, b"/"),
        Message::Log(LogMessage::RequestList { target, first: 0, last: u16::MAX }),
        Message::Log(LogMessage::RequestData { target, id: 0, offset: 0, bytes: 90 }),
        // The last, because the list goes on for a while.
        Message::ParamRequestList { target },
    ]
}

fn is_answer_to(request: &Message, answer: &Message) -> bool {
    match (request, answer) {
        (Message::Command(command), Message::CommandAck(ack)) => ack.command == command.command,
        (Message::SetMessageInterval(_), Message::CommandAck(ack)) => ack.command == ids::COMMAND_SET_MESSAGE_INTERVAL,
        (Message::ParamRequestList { .. }, Message::ParamValue { index, .. }) => *index == 0,
        (Message::ParamRequestRead { name, .. }, Message::ParamHash { .. }) => name == "_HASH_CHECK",
        (
            Message::ParamRequestRead { name, .. } | Message::ParamSet { name, .. },
            Message::ParamValue { name: reported, .. },
        ) => name == reported,
        (Message::Plan(request), Message::MissionCurrent(_)) => {
            matches!(request.content, PlanContent::SetCurrent { .. })
        }
        (Message::Plan(request), Message::Plan(_)) => !matches!(request.content, PlanContent::SetCurrent { .. }),
        (Message::FileTransfer(request), Message::FileTransfer(answer)) => answer.requested_opcode == request.opcode,
        (Message::Log(LogMessage::RequestList { .. }), Message::Log(LogMessage::Entry { .. }))
        | (Message::Log(LogMessage::RequestData { .. }), Message::Log(LogMessage::Data { .. })) => true,
        _ => false,
    }
}

/// Messages by their senders on the link of the ground stations, after the first `first_output` outputs.
fn heard(station: &TestStation, first_output: usize) -> Vec<(Address, Message)> {
    let sent = station.sent_since(first_output).filter(|sent| sent.link == GCS_LINK);
    let heard = sent.flat_map(|sent| {
        let source = Address::new(sent.bytes[5], sent.bytes[6]);
        messages(sent.bytes).into_iter().map(move |message| (source, message))
    });
    heard.collect()
}

/// How many answers to this request the vehicle has given, and whether the request was forwarded to the robot.
fn ask(station: &mut TestStation, gcs: &mut RemotePeer, millis: i64, request: &Message) -> (usize, bool) {
    let first_output = station.outputs.len();
    let passed = gcs.send(station, at(millis), request);
    station.pass_until(at(millis + 19));
    let answers = heard(station, first_output);
    let of_vehicle =
        answers.iter().filter(|(source, answer)| *source == BRICK && is_answer_to(request, answer)).count();
    (of_vehicle, passed.iter().any(|(link, _, _)| *link == LINK))
}

/// Two seconds of a robot, with its heartbeats.
fn drive(station: &mut TestStation, robot: &mut RemotePeer, from_ms: u32, telemetry: impl Fn(u32) -> Message) {
    for millis in (from_ms..from_ms + 2_000).step_by(50) {
        station.pass_until(at(i64::from(millis)));
        if (millis - from_ms) % 1_000 == 500 {
            robot.send(station, at(i64::from(millis)), &HEARTBEAT);
        }
        robot.send(station, at(i64::from(millis)), &telemetry(millis));
    }
}

fn wheels(millis: u32) -> Message {
    ticks(millis, i64::from(millis), i64::from(millis))
}

/// Of the standard dialect.
fn distance(millis: u32) -> Message {
    let travelled = Meters(f64::from(millis) * 1e-4);
    Message::WheelDistance { stamp: WireStamp::Micros64(u64::from(millis) * 1_000), left: travelled, right: travelled }
}

#[test]
fn every_request_to_a_robot_without_mavlink_is_answered_for_it() {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(WITHOUT_VEHICLE, LINK, 0);
    drive(&mut station, &mut robot, 0, wheels);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    for (from_ms, target) in [(2_000, BRICK), (3_000, ALL_OF_ROBOT)] {
        // A list of parameters goes on for a while.
        station.pass_until(at(from_ms - 1));
        for (index, request) in (0..).zip(requests(target)) {
            let (answers, _) = ask(&mut station, &mut gcs, from_ms + 20 * index, &request);
            assert!(answers > 0, "{request:?} to {target}");
        }
    }
}

#[test]
fn what_the_vehicle_cannot_do_is_refused_and_still_passed_on_to_all_components() {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(WITHOUT_VEHICLE, LINK, 0);
    drive(&mut station, &mut robot, 0, wheels);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    let unknown = |target| {
        let interval = SetMessageInterval { target, message_id: 60_000, interval: None };
        let command = CommandLong { target, command: 400, params: [0.0; 7] };
        [Message::Command(command), Message::SetMessageInterval(interval)]
    };
    let mut answers = |station: &mut TestStation, from_ms: i64, target| {
        let asked = (0..).zip(unknown(target));
        asked.map(|(index, request)| ask(station, &mut gcs, from_ms + 20 * index, &request)).collect::<Vec<_>>()
    };
    assert_eq!(answers(&mut station, 2_000, BRICK), [(1, false); 2]);
    assert_eq!(answers(&mut station, 2_100, ALL_OF_ROBOT), [(1, true); 2], "the robot may be able to, as 1/25");
    station.pass_until(at(40_000));
    assert_eq!(answers(&mut station, 40_000, ALL_OF_ROBOT), [(1, false); 2], "nobody else is there");
}

#[test]
fn a_robot_that_speaks_mavlink_itself_is_left_alone() {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(BRICK, LINK, 0);
    drive(&mut station, &mut robot, 0, distance);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    for (index, request) in (0..).zip(requests(BRICK)) {
        assert_eq!(ask(&mut station, &mut gcs, 2_000 + 20 * index, &request), (0, true), "{request:?}");
    }
    // Neither by itself: its state is its own.
    let shown = heard(&station, 0).into_iter().filter(|(source, _)| *source == BRICK);
    let others: Vec<Message> = shown.map(|(_, message)| message).filter(|message| !is_expected(message)).collect();
    assert_eq!(others, []);
}

/// The robot is a computer beside an autopilot, which is the vehicle.
#[test]
fn an_autopilot_beside_the_robot_is_left_alone() {
    let mut station = TestStation::new(&two_links());
    let mut companion = RemotePeer::new(WITHOUT_VEHICLE, LINK, 0);
    let mut autopilot = RemotePeer::new(BRICK, LINK, 0);
    for millis in (0..2_000).step_by(50) {
        station.pass_until(at(millis));
        if millis % 500 == 0 {
            autopilot.send(&mut station, at(millis), &HEARTBEAT);
        }
        companion.send(&mut station, at(millis), &distance(millis as u32));
    }
    let before = station.outputs.len();
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    for (index, request) in (0..).zip(requests(BRICK)) {
        assert_eq!(ask(&mut station, &mut gcs, 2_000 + 20 * index, &request), (0, true), "{request:?}");
    }
    let status = heard(&station, before).into_iter().filter(|(_, message)| matches!(message, Message::SystemStatus(_)));
    assert_eq!(status.count(), 0);
}

/// What the robot sends, and the attitude that the station knows alone.
const fn is_expected(message: &Message) -> bool {
    matches!(message, Message::Heartbeat(_) | Message::WheelDistance { .. } | Message::Attitude { .. })
}

#[test]
fn a_brick_of_our_dialect_is_answered_for_until_it_answers_itself() {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(BRICK, LINK, 0);
    drive(&mut station, &mut robot, 0, wheels);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    for (index, request) in (0..).zip(requests(BRICK)) {
        let (answers, is_forwarded) = ask(&mut station, &mut gcs, 2_000 + 20 * index, &request);
        assert!(answers > 0 && !is_forwarded, "{request:?}");
    }
    let own = Message::ParamValue { name: "ITS_OWN".to_owned(), value: 1.0, count: 1, index: 0 };
    station.pass_until(at(2_999));
    robot.send(&mut station, at(3_000), &own);
    let list = Message::ParamRequestList { target: BRICK };
    assert_eq!(ask(&mut station, &mut gcs, 3_020, &list), (0, true), "it has parameters of its own");
    let plan = Message::Plan(PlanMessage { target: BRICK, plan: 0, content: PlanContent::RequestList });
    assert_eq!(ask(&mut station, &mut gcs, 3_040, &plan), (1, false), "but no plans");
    // After a restart another program may run on it.
    for millis in (0..1_000).step_by(50) {
        robot.send(&mut station, at(4_000 + i64::from(millis)), &wheels(millis));
    }
    assert_eq!(ask(&mut station, &mut gcs, 5_020, &list), (1, false));
}

#[test]
fn the_heartbeat_of_a_camera_that_fell_silent_with_the_vehicle_is_not_sent_when_that_comes_back() {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(BRICK, LINK, 0);
    let mut camera = RemotePeer::new(CAMERA, LINK, 1);
    drive(&mut station, &mut robot, 0, wheels);
    camera.send(&mut station, at(1_960), &Message::Heartbeat(Heartbeat::CAMERA));
    drive(&mut station, &mut robot, 60_000, wheels);
    let of_camera = heard(&station, 0).into_iter().filter(|(source, _)| *source == CAMERA);
    assert_eq!(of_camera.count(), 0);
    assert_eq!(station.later_health(GCS_LINK).rate_limited, 1);
}

/// Whoever begins to listen at any instant hears the vehicle's heartbeat before any other.
#[test]
fn the_first_heartbeat_that_anybody_hears_is_the_vehicles() {
    for address in [BRICK, WITHOUT_VEHICLE] {
        let mut station = TestStation::new(&two_links());
        let mut robot = RemotePeer::new(address, LINK, 0);
        let mut camera = RemotePeer::new(CAMERA, LINK, 1);
        station.pass_until(at(770));
        // Its period is not quite the station's.
        for from_ms in [1_000, 3_000, 5_050, 7_050] {
            drive(&mut station, &mut robot, from_ms, wheels);
            camera.send(&mut station, at(i64::from(from_ms) + 1_960), &Message::Heartbeat(Heartbeat::CAMERA));
        }
        let beats: Vec<(Timestamp<HostClock>, Address)> = station
            .sent()
            .filter(|sent| sent.link == GCS_LINK && matches!(messages(sent.bytes)[..], [Message::Heartbeat(_)]))
            .map(|sent| (sent.now, Address::new(sent.bytes[5], sent.bytes[6])))
            .collect();
        let of = |sender| beats.iter().filter(|(_, source)| *source == sender).count();
        assert!(of(BRICK) >= 8 && of(STATION) >= 7 && of(CAMERA) >= 3, "{address}: {beats:?}");
        // Before the vehicle is known nobody waits for it.
        let first = beats.iter().position(|(_, source)| *source == BRICK).expect("it beats");
        for at_once in beats[first..].chunk_by(|(one, _), (next, _)| one == next) {
            assert_eq!(at_once[0].1, BRICK, "{address}: {beats:?}");
        }
    }
}

/// Bytes in a millisecond of a line of 100 Mbit/s.
const LINE_BYTES_PER_MS: f64 = 12_500.0;
const FLOOD_MS: i64 = 5_000;

/// What a station with a robot sends in some seconds, with somebody who repeats each request a thousand times a second or without.
struct Flooded {
    station: TestStation,
    /// When estimates went to the robot, and how many.
    estimates: BTreeMap<i64, usize>,
    /// The longest that a message of the station waited on the flooded line behind others.
    longest_wait_ms: f64,
    bytes: usize,
}

fn flooded(requests: &[Message]) -> Flooded {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(WITHOUT_VEHICLE, LINK, 0);
    drive(&mut station, &mut robot, 0, wheels);
    let mut flooder = RemotePeer::new(GCS, GCS_LINK, 9);
    let first_output = station.outputs.len();
    for millis in 2_000..2_000 + FLOOD_MS {
        station.pass_until(at(millis));
        for request in requests {
            flooder.send(&mut station, at(millis), request);
        }
        if millis % 50 == 0 {
            robot.send(&mut station, at(millis), &wheels(millis as u32));
        }
    }
    station.pass_until(at(2_000 + FLOOD_MS + 1_000));
    let (mut estimates, mut bytes) = (BTreeMap::new(), 0);
    let (mut line_free_at_ms, mut longest_wait_ms) = (0.0_f64, 0.0_f64);
    for sent in station.sent_since(first_output) {
        let now_ms = sent.now.as_micros() as f64 * 1e-3;
        match sent.priority {
            Priority::Estimate { .. } if sent.link == LINK => {
                *estimates.entry(sent.now.as_micros()).or_default() += 1;
            }
            _ if sent.link == GCS_LINK => {
                bytes += sent.bytes.len();
                let begins_ms = line_free_at_ms.max(now_ms);
                if matches!(sent.priority, Priority::Estimate { .. }) {
                    longest_wait_ms = longest_wait_ms.max(begins_ms - now_ms);
                }
                line_free_at_ms = begins_ms + sent.bytes.len() as f64 / LINE_BYTES_PER_MS;
            }
            _ => {}
        }
    }
    Flooded { station, estimates, longest_wait_ms, bytes }
}

#[test]
fn a_peer_that_repeats_each_request_a_thousand_times_a_second_delays_no_estimate_and_gets_a_bounded_rate() {
    let mut flood = requests(BRICK);
    flood.push(Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 1, target: None }));
    let quiet = flooded(&[]);
    let mut loud = flooded(&flood);
    assert_eq!(loud.estimates, quiet.estimates, "the robot gets its estimates at the same instants");
    assert!(loud.estimates.len() >= 99, "{}", loud.estimates.len());
    let seconds = FLOOD_MS as f64 * 1e-3 + 1.0;
    let rate = (loud.bytes - quiet.bytes) as f64 / seconds;
    println!("{:.0} bytes/s more, an estimate waits {:.3} ms at most", rate, loud.longest_wait_ms);
    assert!(loud.longest_wait_ms < 1.0, "{} ms", loud.longest_wait_ms);
    // 200 answers a second of 280 bytes, 400 more at once, and the lists of parameters, 50 of 37 bytes a second.
    assert!(rate < 200.0 * 280.0 + 400.0 * 280.0 / seconds + 100.0 * 49.0, "{rate}");
    let asked = FLOOD_MS as u64 * flood.len() as u64;
    let excess = loud.station.later_health(GCS_LINK).excess_requests;
    println!("{excess} of {asked} requests are above the budget");
    assert!(excess > asked * 9 / 10 && excess < asked, "{excess} of {asked}");
    // Another peer of the link is served as if nobody else were there.
    let mut other = RemotePeer::new(Address::new(253, 190), GCS_LINK, 10);
    let end = 2_000 + FLOOD_MS + 5_000;
    loud.station.pass_until(at(end));
    for (index, request) in (0..).zip(requests(BRICK)) {
        let (answers, _) = ask(&mut loud.station, &mut other, end + 20 * index, &request);
        assert!(answers > 0, "{request:?}");
    }
    assert_eq!(loud.station.later_health(GCS_LINK).excess_requests, excess);
}

/// A ground station that fetches everything twice in a second, with a repetition of each request, hits no limit.
#[test]
fn a_connect_hits_no_limit() {
    let mut station = TestStation::new(&two_links());
    let mut robot = RemotePeer::new(WITHOUT_VEHICLE, LINK, 0);
    drive(&mut station, &mut robot, 0, wheels);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 1);
    for millis in 0..4 {
        for request in requests(BRICK).iter().chain(&requests(ALL_OF_ROBOT)) {
            gcs.send(&mut station, at(2_000 + millis * 250), request);
        }
    }
    assert_eq!(station.later_health(GCS_LINK).excess_requests, 0);
}
