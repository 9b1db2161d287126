//! What comes back round a loop of links, late: it is passed on, obeyed and used once.

use crate::support::network::{BytesInTransit, RemotePeer};
use crate::support::{BRICK, HEARTBEAT, LINK, STATION, TestStation, at, config, link, ticks, time_answer};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Message, SetMessageInterval};
use posebridge_telemetry::{Address, Event, LinkId, ReceiveError, TimeDelta};

/// Two links to another station.
const NEAR: LinkId = LinkId(4);
const FAR: LinkId = LinkId(5);

fn station_in_a_loop() -> TestStation {
    let mut config = config();
    config.links.push(link(NEAR, vec![]));
    config.links.push(link(FAR, vec![]));
    TestStation::new(&config)
}

#[test]
fn a_frame_that_was_queued_on_its_round_trip_is_not_forwarded_again() {
    // 64 KiB of forwarded frames may wait for a line of 57600 baud.
    let longest_wait = TimeDelta::from_secs_f64(65_536.0 / 5_760.0);
    for wait in [TimeDelta::from_millis(1_500), longest_wait] {
        let mut station = station_in_a_loop();
        let mut brick = RemotePeer::new(BRICK, LINK, 0);
        let far = RemotePeer::new(BRICK, FAR, 0);
        let mut in_transit = BytesInTransit::default();
        for k in 0..800_u32 {
            let now = at(i64::from(k) * 50);
            let frame = brick.frame(&ticks(5_000 + k * 50, 0, 0));
            assert_eq!(brick.send_bytes(&mut station, now, &frame).len(), 2, "out by both links");
            in_transit.send(now + wait, (), frame);
            while let Some(((), back)) = in_transit.take_due(now) {
                assert_eq!(far.send_bytes(&mut station, now, &back), [], "after {wait:?}");
            }
        }
        assert_eq!(station.aligned().len(), 800);
    }
}

#[test]
fn a_command_that_comes_by_two_endpoints_is_executed_once_and_answered_where_it_came_first() {
    const GCS: Address = Address::new(254, 190);
    let mut station = station_in_a_loop();
    let mut near = RemotePeer::new(GCS, NEAR, 0);
    let frame = near.frame(&Message::SetMessageInterval(SetMessageInterval {
        target: STATION,
        message_id: ids::ODOMETRY,
        interval: Some(TimeDelta::from_millis(50)),
    }));
    let first_output = station.outputs.len();
    near.send_bytes(&mut station, at(100), &frame);
    RemotePeer::new(GCS, FAR, 0).send_bytes(&mut station, at(140), &frame);
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    for k in 0..20_u32 {
        let now = at(200 + i64::from(k) * 50);
        brick.send(&mut station, now, &ticks(5_000 + k * 50, 0, 0));
    }
    let counts = [NEAR, FAR].map(|link| {
        let messages = station.messages_since(first_output, link);
        let acks = messages.iter().filter(|m| matches!(m, Message::CommandAck(_)));
        let stream = messages.iter().filter(|m| matches!(m, Message::Odometry(_)));
        (acks.count(), stream.count())
    });
    assert_eq!(counts, [(1, 20), (0, 0)]);
}

#[test]
fn a_reply_is_accepted_on_the_requests_link_even_if_the_loop_is_quicker() {
    let mut station = station_in_a_loop();
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    brick.send(&mut station, at(0), &ticks(5_000, 0, 0));
    let mut first_output = 0;
    for k in 1..40_i64 {
        let now = at(k * 100);
        station.pass_until(now);
        for request in station.time_requests(first_output).into_iter().filter(|request| request.link == LINK) {
            let answer = brick.frame(&time_answer(request.nanos + 5_002_000_000, request.nanos));
            RemotePeer::new(BRICK, NEAR, 0).send_bytes(&mut station, now, &answer);
            brick.send_bytes(&mut station, now, &answer);
        }
        first_output = station.outputs.len();
    }
    assert!(station.count(|event| matches!(event, Event::BrickClockAligned { .. })) > 8);
}

#[test]
fn a_robot_is_detected_on_its_own_link_and_not_where_its_heartbeats_loop_back() {
    for round_first in [false, true] {
        let mut station = station_in_a_loop();
        let mut brick = RemotePeer::new(BRICK, LINK, 0);
        let near = RemotePeer::new(BRICK, NEAR, 0);
        brick.send(&mut station, at(0), &ticks(5_000, 0, 0));
        for k in 1..10_i64 {
            let now = at(k * 1_000);
            station.pass_until(now);
            let frame = brick.frame(&HEARTBEAT);
            if round_first {
                near.send_bytes(&mut station, now, &frame);
            }
            brick.send_bytes(&mut station, now, &frame);
            if !round_first {
                near.send_bytes(&mut station, now, &frame);
            }
        }
        let mut detected_on = Vec::new();
        for event in station.events() {
            match event {
                Event::RobotDetected { robot } => detected_on.push(robot.link),
                Event::RobotLost { .. } => panic!("it speaks each second"),
                _ => {}
            }
        }
        assert!(detected_on.contains(&LINK), "{round_first}");
        // A copy that is quicker cannot be distinguished from the original.
        assert_eq!(detected_on.contains(&NEAR), round_first);
    }
}

#[test]
fn an_echo_is_ignored_and_a_foreign_sender_under_our_address_is_reported() {
    let mut station = station_in_a_loop();
    station.pass_until(at(3_000));
    let echoes: Vec<Vec<u8>> = station.sent().map(|sent| sent.bytes.to_vec()).collect();
    assert!(echoes.len() > 9, "{}", echoes.len());
    let far = RemotePeer::new(STATION, FAR, 0);
    for frame in &echoes {
        assert_eq!(far.send_bytes(&mut station, at(3_000), frame), []);
    }
    let namesakes = |station: &TestStation| {
        let defect = ReceiveError::AddressConflict { message_id: ids::HEARTBEAT };
        station.count(|event| *event == Event::ReceiveError { link: FAR, defect })
    };
    assert_eq!(namesakes(&station), 0);
    let mut other = RemotePeer::new(STATION, FAR, 0);
    let first_output = station.outputs.len();
    for k in 0..5 {
        assert_eq!(other.send(&mut station, at(3_100 + k), &HEARTBEAT), []);
    }
    assert_eq!(namesakes(&station), 5);
    assert!(!station.events_since(first_output).any(|event| matches!(event, Event::RobotDetected { .. })));
    assert_eq!(station.later_health(FAR).address_conflicts, 5);
}
