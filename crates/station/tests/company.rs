//! Who else is on a link: those who were replaced, those who were invented, and what they may cost the others.
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

use std::collections::BTreeMap;

use brick::{BRICK, HEARTBEAT, frame, ticks};
use network::RemotePeer;
use posebridge_protocol::dialect::ids;
use posebridge_protocol::framing::TransportKind;
use posebridge_protocol::message::{CommandLong, Message};
use posebridge_telemetry::{
    Address, Event, HostClock, Input, LinkCounts, LinkHealth, LinkId, LinkState, Output, PeerId, Priority, Recipients,
    SourceHealth, TimeDelta, Timestamp,
};
use station::{LINK, TestStation, at, config, link};

const GCS_LINK: LinkId = LinkId(5);
const GCS: Address = Address::new(254, 190);

fn health(station: &mut TestStation, id: LinkId) -> (LinkHealth, Vec<SourceHealth>) {
    let latest = station.outputs.iter().map(|(now, _)| *now).max();
    station.pass_until(latest.unwrap_or(at(0)) + TimeDelta::from_millis(1_000));
    let health = station.events().filter_map(|event| match event {
        Event::Health { link, health, sources } if *link == id => Some((*health, sources.clone())),
        _ => None,
    });
    health.last().expect("a second has passed")
}

/// Estimates that were sent to the robot's link.
fn estimates(station: &TestStation) -> usize {
    let outputs = station.outputs.iter();
    let estimates = outputs.filter(|(_, output)| {
        matches!(output, Output::Transmit { link: LINK, priority: Priority::Estimate { .. }, .. })
    });
    estimates.count()
}

/// Ten seconds of telemetry and much beside it by a connection that has replaced one of `before`; the port tells of so many peers.
fn by_a_new_connection(before: Timestamp<HostClock>, told: u32) -> TestStation {
    let mut config = config();
    config.links[0].rules.limits.bytes_per_s = Some(2_500);
    let mut station = TestStation::new(&config);
    RemotePeer::new(BRICK, LINK, 0).send(&mut station, before, &HEARTBEAT);
    let counts = LinkCounts { peers: told, ..LinkCounts::default() };
    station.handle(at(59_000), Input::Port { link: LINK, counts });
    let mut again = RemotePeer::new(BRICK, LINK, 1);
    for k in 0..200_u32 {
        let now = at(60_000 + i64::from(k) * 50);
        let (_, passed) = again.send(&mut station, now, &ticks(5_000 + k * 50, 0, 0));
        assert_eq!(passed, [], "message {k}");
        // Others on the same link would be told as much again.
        for _ in 0..3 {
            assert_eq!(again.send(&mut station, now, &HEARTBEAT).1, []);
        }
    }
    station
}

#[test]
fn who_was_replaced_by_a_new_connection_gets_nothing_and_costs_nothing() {
    // Long ago, as far as is known; and lately, but the port knows that he has gone.
    for (before, told) in [(at(10), 0), (at(57_000), 1)] {
        let mut station = by_a_new_connection(before, told);
        assert_eq!(health(&mut station, LINK).0.forwarded, 0);
        assert_eq!(estimates(&station), 200);
    }
}

#[test]
fn two_who_speak_on_one_link_hear_each_other() {
    for told in [0, 1, 2] {
        let mut station = TestStation::new(&config());
        let counts = LinkCounts { peers: told, ..LinkCounts::default() };
        station.handle(at(5), Input::Port { link: LINK, counts });
        RemotePeer::new(BRICK, LINK, 0).send(&mut station, at(10), &HEARTBEAT);
        let (_, passed) = RemotePeer::new(GCS, LINK, 1).send(&mut station, at(20), &HEARTBEAT);
        let to_the_other = (LINK, Recipients::AllExcept(PeerId(1)), Priority::Forwarded);
        assert_eq!(passed, [to_the_other], "{told}");
    }
}

#[test]
fn a_limit_is_asked_once_for_a_frame_and_not_once_for_each_who_gets_it() {
    let mut config = config();
    config.links.push(link(GCS_LINK, vec![]));
    let interval = TimeDelta::from_millis(200);
    config.links[0].rules.limits.min_intervals = BTreeMap::from([(ids::PARAM_SET, interval)]);
    let mut station = TestStation::new(&config);
    // The robot has reconnected: it was heard by two peers of its link.
    for peer in 0..2 {
        RemotePeer::new(BRICK, LINK, peer).send(&mut station, at(10), &HEARTBEAT);
    }
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    let set = Message::ParamSet { target: BRICK, name: "GAIN".to_owned(), value: 1.0 };
    let to_both = [0, 1].map(|peer| (LINK, Recipients::Peer(PeerId(peer)), Priority::Forwarded));
    assert_eq!(gcs.send(&mut station, at(100), &set).1, to_both);
    assert_eq!(gcs.send(&mut station, at(299), &set).1, []);
    assert_eq!(gcs.send(&mut station, at(300), &set).1, to_both);
    assert_eq!(health(&mut station, LINK).0.rate_limited, 1);
}

#[test]
fn commands_of_the_station_pay_from_the_budget_as_those_of_others_do() {
    let estimates_beside = |wanted: Vec<(u32, TimeDelta)>| {
        let mut config = config();
        config.brick_message_intervals = wanted;
        config.links[0].rules.limits.bytes_per_s = Some(200);
        let mut station = TestStation::new(&config);
        // It answers no request, so that each is said five times.
        for k in 0..100_u32 {
            let now = at(i64::from(k) * 50);
            if k % 20 == 0 {
                station.bytes(now, &frame(BRICK, &HEARTBEAT));
            }
            station.bytes(now, &frame(BRICK, &ticks(5_000 + k * 50, 0, 0)));
            station.pass_until(now);
        }
        estimates(&station)
    };
    let alone = estimates_beside(vec![]);
    let beside = estimates_beside(vec![(42_100, TimeDelta::from_millis(50))]);
    // Five requests of 45 bytes are more than three estimates of 64.
    assert!(alone >= beside + 3, "{alone} {beside}");
}

#[test]
fn a_link_that_comes_up_again_has_reconnected_even_if_nothing_was_received() {
    let mut station = TestStation::new(&config());
    for (now, state) in
        [(at(100), LinkState::Down), (at(200), LinkState::Up), (at(300), LinkState::Down), (at(400), LinkState::Up)]
    {
        station.link(now, LINK, state);
    }
    assert_eq!(health(&mut station, LINK).0.reconnects, 2);
}

#[test]
fn health_tells_of_those_who_were_heard_most_when_somebody_invents_senders() {
    let mut station = TestStation::new(&config());
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    for k in 0..10_u32 {
        brick.send(&mut station, at(i64::from(k)), &ticks(5_000 + k, 0, 0));
    }
    // Every address that sixteen bits can name, and then as many peers have gone.
    for system in 0..=255 {
        let frames: Vec<u8> =
            (0..=255).flat_map(|component| frame(Address::new(system, component), &HEARTBEAT)).collect();
        let input = Input::Bytes { link: LINK, peer: PeerId(1 + u32::from(system)), bytes: frames };
        station.handle(at(100), input);
    }
    let told = |station: &mut TestStation| {
        let (_, sources) = health(station, LINK);
        assert!(sources.len() <= 1_024, "{}", sources.len());
        let of_brick = sources.iter().find(|said| said.source == BRICK);
        of_brick.map(|said| said.frames)
    };
    assert_eq!(told(&mut station), Some(11));
    station.pass_until(at(40_000));
    assert_eq!(told(&mut station), Some(11));
}

#[test]
fn invented_peers_are_many_and_stay_cheap() {
    let mut config = config();
    config.links[0].framing = TransportKind::Stream;
    let mut station = TestStation::new(&config);
    let begun = &frame(BRICK, &ticks(5_000, 0, 0))[..12];
    for peer in 0..100_000_u32 {
        let input = Input::Bytes { link: LINK, peer: PeerId(peer), bytes: begun.to_vec() };
        station.engine.handle(at(i64::from(peer) / 20), &input);
        while station.engine.poll().is_some() {}
    }
    // Twenty in a millisecond: fewer than may wait at a time. Each is given up when its time has come.
    station.pass_until(at(6_000));
    let (health, _) = health(&mut station, LINK);
    assert_eq!(health.timeouts, 100_000);
}

#[test]
fn a_command_reaches_the_robot_beside_a_flood_of_invented_senders() {
    let mut config = config();
    config.links.push(link(GCS_LINK, vec![]));
    let mut station = TestStation::new(&config);
    RemotePeer::new(BRICK, LINK, 0).send(&mut station, at(10), &HEARTBEAT);
    for number in 0..6_000_u32 {
        let source = Address::new(2 + (number / 250) as u8, (number % 250) as u8);
        RemotePeer::new(source, LINK, 1).send(&mut station, at(20), &HEARTBEAT);
    }
    let command = Message::Command(CommandLong { target: BRICK, command: 400, params: [1.0; 7] });
    let (_, passed) = RemotePeer::new(GCS, GCS_LINK, 0).send(&mut station, at(30), &command);
    let to_brick = (LINK, Recipients::Peer(PeerId(0)), Priority::Command);
    assert_eq!(passed, [to_brick]);
}
