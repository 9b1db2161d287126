//! Other peers of a link: replaced and invented ones, and what they may cost the others.

use std::collections::BTreeMap;

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, link, ticks};
use posebridge_protocol::dialect::{Encoder, ids};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::Message;
use posebridge_telemetry::{Address, HostClock, Input, LinkCounts, PeerId, Priority, Recipients, TimeDelta, Timestamp};

/// Estimates that were sent to the robot's link.
fn estimates(station: &TestStation) -> usize {
    station.sent().filter(|sent| sent.link == LINK && matches!(sent.priority, Priority::Estimate { .. })).count()
}

/// Ten seconds of telemetry and much beside it by a connection that has replaced one of `before`; the port tells of so many peers.
fn by_a_new_connection(before: Timestamp<HostClock>, peers: u32) -> TestStation {
    let mut config = config();
    config.links[0].rules.limits.bytes_per_s = Some(2_500);
    let mut station = TestStation::new(&config);
    RemotePeer::new(BRICK, LINK, 0).send(&mut station, before, &HEARTBEAT);
    let counts = LinkCounts { peers, ..LinkCounts::default() };
    station.handle(at(59_000), Input::Port { link: LINK, counts });
    let mut again = RemotePeer::new(BRICK, LINK, 1);
    for k in 0..200_u32 {
        let now = at(60_000 + i64::from(k) * 50);
        assert_eq!(again.send(&mut station, now, &ticks(5_000 + k * 50, 0, 0)), [], "message {k}");
        // Others on the same link would get as much again.
        for _ in 0..3 {
            assert_eq!(again.send(&mut station, now, &HEARTBEAT), []);
        }
    }
    station
}

#[test]
fn a_replaced_connection_gets_nothing_and_costs_nothing() {
    // Long ago, as far as is known; and lately, but the port knows that the peer has closed.
    for (before, peers) in [(at(10), 0), (at(57_000), 1)] {
        let mut station = by_a_new_connection(before, peers);
        assert_eq!(station.later_health(LINK).forwarded, 0);
        assert_eq!(estimates(&station), 200);
    }
}

#[test]
fn a_peer_with_mavlink_1_is_named_once_whatever_others_send() {
    let mut station = TestStation::new(&config());
    let mut old = Encoder::new(WireVersion::V1);
    let mut current = RemotePeer::new(BRICK, LINK, 1);
    let texts = |station: &TestStation| station.texts().iter().filter(|text| text.contains("MAVLink 1")).count();
    for step in 0..20 {
        current.send(&mut station, at(10 * step), &HEARTBEAT);
        let mut frame = Vec::new();
        old.encode(Address::new(2, 1), &HEARTBEAT, &mut frame);
        // In two pieces, with frames of the other between them.
        let (first, second) = frame.split_at(7);
        station.bytes_from(at(10 * step + 1), LINK, PeerId(2), first);
        current.send(&mut station, at(10 * step + 2), &HEARTBEAT);
        station.bytes_from(at(10 * step + 3), LINK, PeerId(2), second);
        assert_eq!(texts(&station), usize::from(step >= 2), "{step}");
    }
}

#[test]
fn two_peers_of_one_link_receive_each_other() {
    for peers in [0, 1, 2] {
        let mut station = TestStation::new(&config());
        let counts = LinkCounts { peers, ..LinkCounts::default() };
        station.handle(at(5), Input::Port { link: LINK, counts });
        RemotePeer::new(BRICK, LINK, 0).send(&mut station, at(10), &HEARTBEAT);
        let passed = RemotePeer::new(GCS, LINK, 1).send(&mut station, at(20), &HEARTBEAT);
        let to_the_other = (LINK, Recipients::AllExcept(PeerId(1)), Priority::Forwarded);
        assert_eq!(passed, [to_the_other], "{peers}");
    }
}

#[test]
fn a_limit_is_charged_once_for_a_frame_and_not_for_each_recipient() {
    let mut config = config();
    config.links.push(link(GCS_LINK, vec![]));
    let interval = TimeDelta::from_millis(200);
    config.links[0].rules.limits.min_intervals = BTreeMap::from([(ids::PARAM_SET, interval)]);
    let mut station = TestStation::new(&config);
    // The robot has reconnected: it was received from two peers of its link.
    for peer in 0..2 {
        RemotePeer::new(BRICK, LINK, peer).send(&mut station, at(10), &HEARTBEAT);
    }
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    let set = Message::ParamSet { target: BRICK, name: "GAIN".to_owned(), value: 1.0 };
    let to_both = [0, 1].map(|peer| (LINK, Recipients::Peer(PeerId(peer)), Priority::Forwarded));
    assert_eq!(gcs.send(&mut station, at(100), &set), to_both);
    assert_eq!(gcs.send(&mut station, at(299), &set), []);
    assert_eq!(gcs.send(&mut station, at(300), &set), to_both);
    assert_eq!(station.later_health(LINK).rate_limited, 1);
}

#[test]
fn commands_of_the_station_pay_from_the_budget_as_those_of_others_do() {
    let estimates_beside = |intervals: Vec<(u32, TimeDelta)>| {
        let mut config = config();
        config.brick_message_intervals = intervals;
        config.links[0].rules.limits.bytes_per_s = Some(200);
        let mut station = TestStation::new(&config);
        // It answers no request, so that each is sent five times.
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
fn datagrams_that_the_system_drops_are_told_once_with_the_cure() {
    let mut station = TestStation::new(&config());
    for second in 1..=40_u32 {
        let counts = LinkCounts { kernel_drops: u64::from(second) * 3, ..LinkCounts::default() };
        station.handle(at(i64::from(second) * 1_000), Input::Port { link: LINK, counts });
        station.pass_until(at(i64::from(second) * 1_000 + 500));
    }
    assert_eq!(station.health(LINK).0.port.kernel_drops, 120);
    let told = |text: &&&str| text.contains(" datagrams in the system") && text.contains("net.core.rmem_max");
    assert_eq!(station.texts().iter().filter(told).count(), 2, "again after half a minute");
}

#[test]
fn what_is_sent_while_nobody_is_there_counts_as_dropped() {
    let mut station = TestStation::new(&config());
    let port = |peers| Input::Port { link: LINK, counts: LinkCounts { peers, ..LinkCounts::default() } };
    // A link that listens is up, whoever is there.
    station.handle(at(500), port(0));
    station.pass_until(at(5_000));
    let alone = station.later_health(LINK);
    station.pass_until(at(9_000));
    let later = station.later_health(LINK);
    assert_eq!((later.frames_out, later.bytes_out), (alone.frames_out, alone.bytes_out));
    assert!(later.drops_out >= alone.drops_out + 3, "{later:?}");
    // A peer is there as soon as it is heard, or as its transport says so.
    RemotePeer::new(GCS, LINK, 0).send(&mut station, at(10_500), &HEARTBEAT);
    station.handle(at(10_600), port(1));
    station.pass_until(at(15_000));
    let heard = station.later_health(LINK);
    assert!(heard.frames_out >= later.frames_out + 4 && heard.bytes_out > later.bytes_out + 80, "{heard:?}");
    assert!(heard.drops_out <= later.drops_out + 1, "{heard:?}");
    station.handle(at(16_500), port(0));
    station.pass_until(at(20_000));
    assert!(station.later_health(LINK).drops_out >= heard.drops_out + 3);
}
