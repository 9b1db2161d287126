//! Robots of one station beside each other: each keeps its own ids, estimate and settings, and none of its messages is lost to another.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/network.rs"]
mod network;
#[path = "support/station.rs"]
mod station;

use std::collections::BTreeSet;

use brick::{BRICK, HEARTBEAT, messages, ticks};
use network::{RemotePeer, passed_on};
use posebridge_protocol::dialect::ids::{self, COMMAND_REQUEST_MESSAGE};
use posebridge_protocol::message::{CommandLong, Message, SetMessageInterval, WireStamp};
use posebridge_station::{OutputKind, RobotBlock, RobotConfig, RobotMatch, StationConfig};
use posebridge_telemetry::{Address, Event, Input, LinkId, Output, PeerId, Recipients, RobotId};
use station::{LINK, STATION, TestStation, at, config, link, stream};

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

/// Recipients and contents of what was sent after the first `seen` outputs.
fn sent_since(station: &TestStation, seen: usize) -> Vec<(LinkId, Recipients, Message)> {
    let outputs = station.outputs[seen..].iter();
    let sent = outputs.filter_map(|(_, output)| match output {
        Output::Transmit { link, to, bytes, .. } => Some((*link, *to, messages(bytes))),
        _ => None,
    });
    sent.flat_map(|(link, to, messages)| messages.into_iter().map(move |message| (link, to, message))).collect()
}

#[test]
fn an_id_that_was_given_to_one_robot_is_not_that_of_another() {
    // The second is given system 2, which the third has, and so on.
    let (station, _) = station_with(&config(), &[BRICK, BRICK, NEIGHBOUR, Address::new(3, 1)]);
    let ids = ids(&station);
    assert_eq!(ids.len(), 4);
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), 4, "{ids:?}");
    for robot in station.engine.robots() {
        assert_eq!(robot.latest_time().map(|time| time.as_micros() % 10_000_000), Some(200_000), "each goes on");
    }
}

#[test]
fn robots_beyond_the_limit_are_reported_once() {
    let config = StationConfig { max_robots: 1, ..config() };
    let (station, _) = station_with(&config, &[BRICK, NEIGHBOUR]);
    let texts =
        station.events().filter(|event| matches!(event, Event::Text { text, .. } if text.contains("max_robots")));
    assert_eq!((station.engine.robots().len(), texts.count()), (1, 1));
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
    let seen = station.outputs.len();
    let bytes = robots[0].frame(&ticks(5_000, 9, 9));
    for (peer, millis) in [(0, 400), (1, 410)] {
        station.handle(at(millis), Input::Bytes { link: LINK, peer: PeerId(peer), bytes: bytes.clone() });
    }
    let used = station.outputs[seen..].iter().filter_map(|(_, output)| match output {
        Output::Event(Event::ObservationAligned { robot, .. }) => Some(*robot),
        _ => None,
    });
    assert_eq!(used.collect::<Vec<_>>(), ids(&station));
}

#[test]
fn what_a_robot_sends_before_it_is_told_apart_is_used_when_it_is() {
    let (station, _) = station_with(&config(), &[BRICK, BRICK]);
    let second = ids(&station)[1];
    let stamps = station.events().filter_map(|event| match event {
        Event::ObservationAligned { robot, observation, .. } if *robot == second => Some(observation.stamp.as_micros()),
        _ => None,
    });
    assert_eq!(stamps.collect::<Vec<_>>(), [0, 50, 100, 150, 200].map(|millis| 10_000_000 + 1_000 * millis));
}

#[test]
fn a_robot_that_requests_a_message_gets_its_own_and_nobody_else_gets_it() {
    let (mut station, mut robots) = station_with(&config(), &[BRICK, NEIGHBOUR]);
    let request = |message_id: u32| {
        let params = [message_id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Message::Command(CommandLong { target: STATION, command: COMMAND_REQUEST_MESSAGE, params })
    };
    let seen = station.outputs.len();
    robots[1].send(&mut station, at(400), &request(ids::PB_PLANAR_POSE));
    let poses = sent_since(&station, seen).into_iter().filter_map(|(_, to, message)| match message {
        Message::PlanarPose(pose) => Some((to, pose.stamp)),
        _ => None,
    });
    let [(to, stamp)] = poses.collect::<Vec<_>>()[..] else { panic!("one pose was requested") };
    assert_eq!(to, Recipients::Peer(PeerId(1)));
    assert!(matches!(stamp, WireStamp::Micros32(10_200_000)), "by the clock of the robot that asks: {stamp:?}");
    // Nobody could tell whose pose it is.
    let seen = station.outputs.len();
    RemotePeer::new(Address::new(254, 190), LINK, 9).send(&mut station, at(500), &request(ids::PB_PLANAR_POSE));
    assert!(!sent_since(&station, seen).iter().any(|(_, _, message)| matches!(message, Message::PlanarPose(_))));
}

#[test]
fn a_robot_changes_the_interval_of_its_own_messages_alone() {
    let (mut station, mut robots) = station_with(&config(), &[BRICK, NEIGHBOUR]);
    let never = SetMessageInterval { target: STATION, message_id: ids::PB_PLANAR_POSE, interval: None };
    robots[1].send(&mut station, at(240), &Message::SetMessageInterval(never));
    let seen = station.outputs.len();
    drive(&mut station, &mut robots, 5);
    let poses =
        sent_since(&station, seen).into_iter().filter(|(_, _, message)| matches!(message, Message::PlanarPose(_)));
    assert_eq!(poses.map(|(_, to, _)| to).collect::<Vec<_>>(), [Recipients::Peer(PeerId(0))]);
}

#[test]
fn an_estimate_that_comes_back_is_an_echo_under_a_robots_system_too() {
    let mut config = config();
    config.links.push(link(OTHER_LINK, vec![stream(OutputKind::Odometry, 0)]));
    let (mut station, _) = station_with(&config, &[BRICK, NEIGHBOUR]);
    let under_its_system = station.outputs.iter().rev().find_map(|(_, output)| match output {
        // MAVLink 2: the sender's system and component.
        Output::Transmit { link: OTHER_LINK, bytes, .. }
            if bytes[5..7] == [NEIGHBOUR.system.0, STATION.component.0] =>
        {
            Some(bytes.clone())
        }
        _ => None,
    });
    let seen = station.outputs.len();
    let bytes = under_its_system.expect("the second robot's odometry is sent there");
    station.handle(at(300), Input::Bytes { link: OTHER_LINK, peer: PeerId(0), bytes: bytes.clone() });
    let is_observed = |(_, output): &(_, Output)| matches!(output, Output::Event(Event::ObservationAligned { .. }));
    assert!(!station.outputs[seen..].iter().any(is_observed));
    assert_eq!(passed_on(&station, seen, &bytes), []);
    assert_eq!(station.engine.robots().len(), 2);
}

#[test]
fn what_a_robot_broadcasts_does_not_go_to_the_link_of_another_robot() {
    let mut config = config();
    config.links.push(link(OTHER_LINK, vec![]));
    let (mut station, mut robots) = station_with(&config, &[BRICK]);
    let mut neighbour = RemotePeer::new(NEIGHBOUR, OTHER_LINK, 0);
    let (_, forwarded) = neighbour.send(&mut station, at(300), &HEARTBEAT);
    assert_eq!(forwarded.len(), 1, "nobody knows yet that it is a robot");
    neighbour.send(&mut station, at(310), &ticks(20_000, 0, 0));
    let (_, forwarded) = neighbour.send(&mut station, at(360), &ticks(20_050, 0, 0));
    assert_eq!(forwarded, []);
    let (_, forwarded) = robots[0].send(&mut station, at(370), &ticks(320, 0, 0));
    assert_eq!(forwarded, []);
}

#[test]
fn a_source_that_is_left_out_is_left_out_of_robots_that_appear_later() {
    use posebridge_telemetry::{Command, SensorId, SensorSwitch};
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
fn a_robot_that_is_off_does_not_keep_another_with_its_ids_from_being_followed_on_another_link() {
    let mut config = config();
    config.links.push(link(OTHER_LINK, vec![]));
    let (mut station, _) = station_with(&config, &[BRICK]);
    let mut moved = RemotePeer::new(BRICK, OTHER_LINK, 0);
    for k in 0..120_u32 {
        moved.send(&mut station, at(i64::from(300 + 50 * k)), &ticks(20_000 + 50 * k, 0, 0));
    }
    assert_eq!(station.engine.robots().len(), 2);
    let latest = station.engine.robots()[1].latest_time().expect("it is followed");
    assert_eq!(latest.as_micros(), 20_000_000 + 50_000 * 119);
}

#[test]
fn a_robot_of_redundant_links_takes_the_block_of_either_and_hears_its_estimate_on_both() {
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
