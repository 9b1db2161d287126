//! Robots of one station beside each other: each keeps its own ids, estimate and settings, and none of its messages is lost to
//! another. Ground stations see the second of two robots with the same ids under another system.

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, STATION, TestStation, at, config, link, messages, stream, ticks};
use posebridge_protocol::dialect;
use posebridge_protocol::dialect::ids::{self, COMMAND_REQUEST_MESSAGE};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, checksum};
use posebridge_protocol::message::{CommandLong, Message, SetMessageInterval, TextPart, WireStamp};
use posebridge_station::{AnnouncedAs, LinkConfig, OutputKind, RobotBlock, RobotConfig, RobotMatch, StationConfig};
use posebridge_telemetry::{
    Address, Command, Event, Input, LinkId, PeerId, Recipients, RobotId, SensorId, SensorSwitch,
};

const NEIGHBOUR: Address = Address::new(2, 1);
const OTHER_LINK: LinkId = LinkId(5);

/// A station whose robots have sent telemetry five times, each by a peer of its own.
fn station_with(config: &StationConfig, addresses: &[Address]) -> (TestStation, Vec<RemotePeer>) {
    let mut station = TestStation::new(config);
    let mut robots: Vec<RemotePeer> =
        (0..).zip(addresses).map(|(peer, address)| RemotePeer::new(*address, LINK, peer)).collect();
    for k in 0..5 {
        drive(&mut station, &mut robots, k);
    }
    (station, robots)
}

/// Every robot sends its wheels' counts, one after the other, with numbers and a clock of its own.
fn drive(station: &mut TestStation, robots: &mut [RemotePeer], k: u32) {
    for (robot, index) in robots.iter_mut().zip(0_u32..) {
        let counts = i64::from(1_000 * index + 4 * k);
        robot.send(station, at(i64::from(50 * k + 5 * index)), &ticks(10_000 * index + 50 * k, counts, counts));
    }
}

fn ids(station: &TestStation) -> Vec<RobotId> {
    station.engine.robots().iter().map(posebridge_station::Robot::id).collect()
}

/// Recipients and contents of what was sent after the first `first_output` outputs.
fn sent_since(station: &TestStation, first_output: usize) -> Vec<(LinkId, Recipients, Message)> {
    let sent = station.sent_since(first_output);
    sent.flat_map(|sent| messages(sent.bytes).into_iter().map(move |message| (sent.link, sent.to, message))).collect()
}

#[test]
fn robots_beyond_the_limit_are_reported_once() {
    let config = StationConfig { max_robots: 1, ..config() };
    let (station, _) = station_with(&config, &[BRICK, NEIGHBOUR]);
    let texts = station.count(|event| matches!(event, Event::Text { text, .. } if text.contains("max_robots")));
    assert_eq!((station.engine.robots().len(), texts), (1, 1));
}

#[test]
fn of_two_robots_with_the_same_ids_the_one_that_falls_silent_is_lost() {
    let (mut station, mut robots) = station_with(&config(), &[BRICK, BRICK]);
    for k in 5..150 {
        drive(&mut station, &mut robots[..1], k);
    }
    let lost = |station: &TestStation| {
        let events = station.events().filter_map(|event| match event {
            Event::RobotLost { robot, .. } => Some((*robot, false)),
            Event::RobotDetected { robot } => Some((*robot, true)),
            _ => None,
        });
        events.collect::<Vec<_>>()
    };
    let second = ids(&station)[1];
    assert_eq!(lost(&station), [(second, false)]);
    drive(&mut station, &mut robots, 150);
    assert_eq!(lost(&station), [(second, false), (second, true)]);
}

#[test]
fn a_board_without_wheels_is_no_second_robot() {
    let (mut station, _) = station_with(&config(), &[BRICK]);
    let mut board = RemotePeer::new(Address::new(1, 2), LINK, 7);
    for k in 0..5_u32 {
        let stamp = WireStamp::Micros32(50_000 * k);
        let heading = posebridge_telemetry::Heading::from_rad(0.1);
        board.send(&mut station, at(i64::from(300 + 50 * k)), &Message::Compass { stamp, heading });
    }
    assert_eq!(station.engine.robots().len(), 1);
}

#[test]
fn frames_of_robots_with_the_same_ids_that_are_equal_to_the_byte_are_all_used() {
    let (mut station, mut robots) = station_with(&config(), &[BRICK, BRICK]);
    let first_aligned = station.aligned().len();
    let bytes = robots[0].frame(&ticks(5_000, 9, 9));
    for (peer, millis) in [(0, 400), (1, 410)] {
        station.bytes_from(at(millis), LINK, PeerId(peer), &bytes);
    }
    let used = station.aligned()[first_aligned..].iter().map(|aligned| aligned.robot).collect::<Vec<_>>();
    assert_eq!(used, ids(&station));
}

#[test]
fn messages_of_a_contested_robot_are_used_when_it_is_identified() {
    let (station, _) = station_with(&config(), &[BRICK, BRICK]);
    let second = ids(&station)[1];
    let aligned = station.aligned().into_iter().filter(|aligned| aligned.robot == second);
    let stamps = aligned.map(|aligned| aligned.observation.stamp.as_micros());
    assert_eq!(stamps.collect::<Vec<_>>(), [0, 50, 100, 150, 200].map(|millis| 10_000_000 + 1_000 * millis));
}

#[test]
fn a_robot_that_requests_a_message_gets_its_own_and_no_other_gets_it() {
    let (mut station, mut robots) = station_with(&config(), &[BRICK, NEIGHBOUR]);
    let request = |message_id: u32| {
        let params = [message_id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Message::Command(CommandLong { target: STATION, command: COMMAND_REQUEST_MESSAGE, params })
    };
    let first_output = station.outputs.len();
    robots[1].send(&mut station, at(400), &request(ids::PB_PLANAR_POSE));
    let poses = sent_since(&station, first_output).into_iter().filter_map(|(_, to, message)| match message {
        Message::PlanarPose(pose) => Some((to, pose.stamp)),
        _ => None,
    });
    let [(to, stamp)] = poses.collect::<Vec<_>>()[..] else { panic!("one pose was requested") };
    assert_eq!(to, Recipients::Peer(PeerId(1)));
    assert!(matches!(stamp, WireStamp::Micros32(10_200_000)), "by the clock of the robot that asks: {stamp:?}");
    // The pose could not be assigned to a robot.
    let first_output = station.outputs.len();
    RemotePeer::new(Address::new(254, 190), LINK, 9).send(&mut station, at(500), &request(ids::PB_PLANAR_POSE));
    assert!(
        !sent_since(&station, first_output).iter().any(|(_, _, message)| matches!(message, Message::PlanarPose(_)))
    );
}

#[test]
fn a_robot_changes_the_interval_of_its_own_messages_alone() {
    let (mut station, mut robots) = station_with(&config(), &[BRICK, NEIGHBOUR]);
    let never = SetMessageInterval { target: STATION, message_id: ids::PB_PLANAR_POSE, interval: None };
    robots[1].send(&mut station, at(240), &Message::SetMessageInterval(never));
    let first_output = station.outputs.len();
    drive(&mut station, &mut robots, 5);
    let poses = sent_since(&station, first_output)
        .into_iter()
        .filter(|(_, _, message)| matches!(message, Message::PlanarPose(_)));
    assert_eq!(poses.map(|(_, to, _)| to).collect::<Vec<_>>(), [Recipients::Peer(PeerId(0))]);
}

#[test]
fn an_estimate_that_comes_back_is_an_echo_under_a_robots_system_too() {
    let mut config = config();
    config.links.push(link(OTHER_LINK, vec![stream(OutputKind::Odometry, 0)]));
    let (mut station, _) = station_with(&config, &[BRICK, NEIGHBOUR]);
    // MAVLink 2: the sender's system and component.
    let under_its_system = station
        .sent()
        .filter(|sent| sent.link == OTHER_LINK && sent.bytes[5..7] == [NEIGHBOUR.system.0, STATION.component.0]);
    let bytes = under_its_system.last().expect("the second robot's odometry is sent there").bytes.to_vec();
    let observed = station.aligned().len();
    let echo = RemotePeer::new(NEIGHBOUR, OTHER_LINK, 0);
    assert_eq!(echo.send_bytes(&mut station, at(300), &bytes), []);
    assert_eq!(station.aligned().len(), observed);
    assert_eq!(station.engine.robots().len(), 2);
}

#[test]
fn what_a_robot_broadcasts_does_not_go_to_the_link_of_another_robot() {
    let mut config = config();
    config.links.push(link(OTHER_LINK, vec![]));
    let (mut station, mut robots) = station_with(&config, &[BRICK]);
    let mut neighbour = RemotePeer::new(NEIGHBOUR, OTHER_LINK, 0);
    let forwarded = neighbour.send(&mut station, at(300), &HEARTBEAT);
    assert_eq!(forwarded.len(), 1, "nobody knows yet that it is a robot");
    neighbour.send(&mut station, at(310), &ticks(20_000, 0, 0));
    assert_eq!(neighbour.send(&mut station, at(360), &ticks(20_050, 0, 0)), []);
    assert_eq!(robots[0].send(&mut station, at(370), &ticks(320, 0, 0)), []);
}

#[test]
fn a_source_that_is_left_out_is_left_out_of_robots_that_appear_later() {
    let (mut station, _) = station_with(&config(), &[BRICK]);
    let command = Command::SwitchSource { sensor: SensorId::WHEELS, to: SensorSwitch::Off };
    station.handle(at(300), Input::Command(command));
    let mut neighbour = RemotePeer::new(NEIGHBOUR, LINK, 1);
    neighbour.send(&mut station, at(310), &ticks(20_000, 0, 0));
    let robots = station.engine.robots().iter();
    let switched_off = robots.map(|robot| robot.switched_off().collect::<Vec<_>>());
    assert_eq!(switched_off.collect::<Vec<_>>(), [[SensorId::WHEELS], [SensorId::WHEELS]]);
}

#[test]
fn a_robot_of_redundant_links_takes_the_block_of_either_and_gets_its_estimate_on_both() {
    let links = [LINK, OTHER_LINK];
    for matched in links {
        let mut config = config();
        config.links = links
            .map(|id| {
                let mut link = link(id, vec![stream(OutputKind::PlanarPose, 0)]);
                link.rules.group = Some(0);
                link
            })
            .to_vec();
        let robot = RobotConfig { name: Some("left".to_owned()), ..config.robot.clone() };
        config.robots.push(RobotBlock { matches: RobotMatch { link: Some(matched), ..RobotMatch::default() }, robot });
        let mut station = TestStation::new(&config);
        let mut robot = RemotePeer::new(BRICK, OTHER_LINK, 0);
        for k in 0..5 {
            robot.send(&mut station, at(i64::from(50 * k)), &ticks(50 * k, 0, 0));
        }
        assert_eq!(station.engine.robots()[0].name(), Some("left"), "matched by link {matched}");
        let poses = |on: LinkId| {
            let sent = sent_since(&station, 0).into_iter();
            sent.filter(|(link, _, message)| *link == on && matches!(message, Message::PlanarPose(_))).count()
        };
        assert_eq!(links.map(poses), [5, 5]);
    }
}

/// How ground stations see the second robot.
const SECOND: Address = Address::new(2, 1);
const SIGNED: u8 = 1;

/// Two robots with the same ids, both known, and a ground station that has been heard.
fn two_robots() -> (TestStation, Vec<RemotePeer>, RemotePeer) {
    let mut config = config();
    config.links.push(LinkConfig {
        announced_as: AnnouncedAs::StationAndVehicle,
        ..link(GCS_LINK, vec![stream(OutputKind::Attitude, 0)])
    });
    let (mut station, robots) = station_with(&config, &[BRICK, BRICK]);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    gcs.send(&mut station, at(300), &HEARTBEAT);
    assert_eq!(station.engine.robots().len(), 2);
    (station, robots, gcs)
}

/// The frames that were sent on a link since `first_output` outputs: recipients, sender and message.
fn frames_since(station: &TestStation, first_output: usize, on: LinkId) -> Vec<(Recipients, Address, Message)> {
    let mut frames = Vec::new();
    for sent in station.sent_since(first_output).filter(|sent| sent.link == on) {
        Framer::new(FramerConfig::default()).push(sent.now, sent.bytes, &mut |found| match found {
            FramerOutput::Frame(frame) => {
                let message = dialect::decode(&frame).expect("it makes sense");
                frames.extend(message.map(|message| (sent.to, frame.source, message)));
            }
            _ => panic!("a frame is damaged"),
        });
    }
    frames
}

#[test]
fn every_frame_of_the_second_robot_bears_the_system_that_is_announced() {
    let (mut station, mut robots, _) = two_robots();
    let first_output = station.outputs.len();
    let text = |content: &str| Message::StatusText { severity: 4, text: content.to_owned(), part: TextPart::default() };
    robots[0].send(&mut station, at(310), &text("first"));
    robots[1].send(&mut station, at(320), &text("second"));
    drive(&mut station, &mut robots, 7);
    let frames = frames_since(&station, first_output, GCS_LINK);
    let senders = |is_it: &dyn Fn(&Message) -> bool| {
        frames.iter().filter(|(_, _, message)| is_it(message)).map(|(_, from, _)| *from).collect::<Vec<_>>()
    };
    assert_eq!(senders(&|message| *message == text("first")), [BRICK]);
    assert_eq!(senders(&|message| *message == text("second")), [SECOND]);
    assert_eq!(senders(&|message| matches!(message, Message::WheelTicks(_))), [BRICK, SECOND]);
}

#[test]
fn a_message_to_one_of_two_robots_with_the_same_ids_reaches_that_one_under_its_own_ids() {
    let (mut station, _, mut gcs) = two_robots();
    for (target, peer) in [(BRICK, 0), (SECOND, 1)] {
        let first_output = station.outputs.len();
        // A command that is the robot's own.
        let command = |target| Message::Command(CommandLong { target, command: 400, params: [0.0; 7] });
        gcs.send(&mut station, at(400), &command(target));
        let expected = (Recipients::Peer(PeerId(peer)), GCS, command(BRICK));
        let frames = frames_since(&station, first_output, LINK).into_iter().filter(|(_, from, _)| *from == GCS);
        assert_eq!(frames.collect::<Vec<_>>(), [expected], "{target}");
    }
}

#[test]
fn a_signed_frame_that_would_have_to_be_changed_is_dropped_and_counted() {
    let (mut station, mut robots, _) = two_robots();
    let before = station.later_health(GCS_LINK).drops_out;
    let mut bytes = robots[1].frame(&HEARTBEAT);
    let end = bytes.len() - 2;
    bytes[2] |= SIGNED;
    // 50 is HEARTBEAT's CRC_EXTRA in minimal.xml.
    let sum = checksum(&bytes[1..end], 50);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
    bytes.extend([7; 13]);
    // Ground stations would take it for another robot's, and other robots have no use for it.
    assert_eq!(robots[1].send_bytes(&mut station, at(2_500), &bytes), []);
    assert_eq!(station.later_health(GCS_LINK).drops_out, before + 1);
}
