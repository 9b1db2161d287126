//! Many peers on one link: robots of which one is silent and one sends garbage, and invented senders.

use std::collections::BTreeSet;

use crate::support::network::RemotePeer;
use crate::support::{AlignedObservation, BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, messages, ticks};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_protocol::message::{CommandLong, Heartbeat, Message, TimeSync};
use posebridge_telemetry::{Address, Input, ObservationKind, PeerId, Recipients, SourceHealth, TimeDelta};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const ROBOTS: u32 = 498;
/// Has begun a frame once and sends nothing more.
const SILENT: PeerId = PeerId(ROBOTS);
const BEGUN: [u8; 12] = [0xFD, 232, 0, 0, 0, 1, 1, 0x4B, 0x01, 0, 7, 7];
const NOISY: PeerId = PeerId(ROBOTS + 1);
const ROUNDS: u32 = 20;
const PERIOD_MS: i64 = 50;
/// By so many frames the sequence numbers of two robots with one address differ.
const AHEAD: u32 = 60;
/// Bytes of garbage per robot and round.
const GARBAGE: usize = 40;

/// Two robots share each address: eight bits of system ids run out, and the link distinguishes them.
fn address(robot: u32) -> Address {
    Address::new(1 + (robot % 249) as u8, 1)
}

/// Of two robots with one address the second has sent elsewhere before: its sequence numbers are others.
fn encoder_of(robot: u32) -> Encoder {
    let mut encoder = Encoder::new(WireVersion::V2);
    for _ in 0..AHEAD * (robot / 249) {
        encoder.encode(address(robot), &HEARTBEAT, &mut Vec::new());
    }
    encoder
}

/// The bytes of a robot's round: a heartbeat and its wheels, which no other robot has turned so far.
fn round_of(encoder: &mut Encoder, robot: u32, round: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let left = i64::from(robot) * 1_000 + i64::from(round);
    encoder.encode(address(robot), &HEARTBEAT, &mut bytes);
    let wheels = ticks(10_000 + round * PERIOD_MS as u32, left, -left);
    encoder.encode(address(robot), &wheels, &mut bytes);
    bytes
}

/// Every robot sends once per round, cut as the link does it: the second parts of all come after the first parts of all.
fn station_with_many_peers(framing: TransportKind) -> TestStation {
    let mut config = config();
    config.links[0].framing = framing;
    let mut station = TestStation::new(&config);
    station.bytes_from(at(900), LINK, SILENT, &BEGUN);
    let mut rng = Pcg64::seed_from_u64(5);
    let mut encoders: Vec<Encoder> = (0..ROBOTS).map(encoder_of).collect();
    for round in 0..ROUNDS {
        let begin = at(1_000 + i64::from(round) * PERIOD_MS);
        station.pass_until(begin);
        let mut second_parts = Vec::new();
        for (robot, encoder) in (0..ROBOTS).zip(&mut encoders) {
            let mut first = round_of(encoder, robot, round);
            let cut = match framing {
                TransportKind::Datagram => first.len(),
                TransportKind::Stream => rng.random_range(1..first.len()),
            };
            second_parts.push((robot, first.split_off(cut)));
            station.bytes_from(begin, LINK, PeerId(robot), &first);
            let garbage: Vec<u8> = (0..GARBAGE).map(|_| rng.random()).collect();
            station.bytes_from(begin, LINK, NOISY, &garbage);
        }
        let then = begin + TimeDelta::from_millis(10);
        station.pass_until(then);
        for (robot, second) in second_parts.into_iter().filter(|part| !part.1.is_empty()) {
            station.bytes_from(then, LINK, PeerId(robot), &second);
        }
    }
    station.pass_until(at(5_000));
    station
}

#[test]
fn of_five_hundred_peers_a_noisy_and_a_silent_one_cost_no_frame_of_others() {
    for framing in [TransportKind::Datagram, TransportKind::Stream] {
        let mut station = station_with_many_peers(framing);
        let (health, sources) = station.health(LINK);
        assert_eq!(health.frames_in, u64::from(2 * ROBOTS * ROUNDS), "{framing:?}");
        assert_eq!(health.frames_lost, 0, "{framing:?}");
        let noise = u64::from(ROBOTS * ROUNDS) * GARBAGE as u64;
        let begun = BEGUN.len() as u64;
        // On a stream what the silent one has begun may still be completed.
        let garbage = match framing {
            TransportKind::Datagram => noise + begun,
            TransportKind::Stream => noise,
        };
        assert_eq!(health.garbage_bytes, garbage, "{framing:?}");
        let expected: Vec<_> = (0..249)
            .map(|robot| SourceHealth { source: address(robot), frames: u64::from(4 * ROUNDS), lost: 0 })
            .collect();
        assert_eq!(sources, expected, "{framing:?}");
        // Until the peer is forgotten.
        station.pass_until(at(60_000));
        let (health, _) = station.health(LINK);
        assert_eq!(health.garbage_bytes, noise + begun, "{framing:?}");
    }
}

#[test]
fn of_many_peers_every_robot_up_to_the_limit_is_tracked_by_its_own_counts() {
    let station = station_with_many_peers(TransportKind::Stream);
    let tick_rad = config().robot.filter_config.geometry.tick.0;
    let mut followed = BTreeSet::new();
    for AlignedObservation { robot, observation, .. } in station.aligned() {
        let ObservationKind::WheelAngles { left, right } = observation.measurement else {
            panic!("nobody sends anything else");
        };
        let counts = (left.0 / tick_rad).round() as i64;
        assert_eq!((right.0 / tick_rad).round() as i64, -counts);
        assert_eq!(address((counts / 1_000) as u32), robot.address, "robot {robot} was given somebody else's counts");
        followed.insert(robot);
    }
    assert_eq!(followed.len(), 64, "the limit of robots");
}

#[test]
fn invented_peers_are_many_and_stay_cheap() {
    let mut station = TestStation::new(&config());
    let begun = &frame(BRICK, &ticks(5_000, 0, 0))[..12];
    for peer in 0..100_000_u32 {
        let input = Input::Bytes { link: LINK, peer: PeerId(peer), bytes: begun.to_vec() };
        station.engine.handle(at(i64::from(peer) / 20), &input);
        while station.engine.poll().is_some() {}
    }
    // Twenty in a millisecond: fewer than may wait at a time. Each is given up when its time has come.
    station.pass_until(at(6_000));
    assert_eq!(station.later_health(LINK).timeouts, 100_000);
}

/// Datagrams that a station sends to a crowd of this many robots in two seconds, as their transport would count them, and how many of them
/// are estimates. Each robot says that it is there, asks for the time, and sends its wheels.
fn datagrams_to_crowd(robots: u32) -> (usize, usize) {
    let mut config = config();
    config.links[0].framing = TransportKind::Datagram;
    config.max_robots = 1_000;
    let mut station = TestStation::new(&config);
    let mut peers: Vec<RemotePeer> = (0..robots).map(|robot| RemotePeer::new(address(robot), LINK, robot)).collect();
    let request = Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 77, target: None });
    for round in 0..40_u32 {
        let begin = at(i64::from(round) * PERIOD_MS);
        station.pass_until(begin);
        for (number, peer) in (0_i64..).zip(&mut peers) {
            let wheels = ticks(10_000 + round * PERIOD_MS as u32, number * 1_000 + i64::from(round), 0);
            for message in [&HEARTBEAT, &request, &wheels] {
                peer.send(&mut station, begin, message);
            }
        }
    }
    let mut datagrams = 0;
    let mut estimates = 0;
    for sent in station.sent() {
        datagrams += match sent.to {
            Recipients::All => robots as usize,
            Recipients::AllExcept(_) => robots as usize - 1,
            Recipients::Peer(_) => 1,
        };
        estimates += messages(sent.bytes).iter().filter(|message| matches!(message, Message::PlanarPose(_))).count();
    }
    (datagrams, estimates)
}

#[test]
fn a_crowd_costs_each_robot_no_more_than_a_few_and_every_estimate_is_sent_to_its_robot_alone() {
    let (few, _) = datagrams_to_crowd(20);
    let (many, estimates) = datagrams_to_crowd(200);
    assert_eq!(estimates, 200 * 40);
    // Per robot: an estimate and an answer for each round, and some requests and signs of life of the station.
    let [few, many] = [few / 20, many / 200];
    assert!(many <= few + few / 10 && many < 150, "{few} datagrams for each of 20 robots, {many} for each of 200");
}

#[test]
fn a_peer_that_calls_itself_a_ground_station_makes_no_flood_of_its_broadcasts() {
    let mut config = config();
    config.links[0].framing = TransportKind::Datagram;
    let mut station = TestStation::new(&config);
    let mut peers: Vec<RemotePeer> = (0..100).map(|robot| RemotePeer::new(address(robot), LINK, robot)).collect();
    for peer in &mut peers {
        peer.send(&mut station, at(0), &HEARTBEAT);
    }
    let gcs = Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 });
    let mut claimant = RemotePeer::new(Address::new(254, 190), LINK, 1_000);
    let forwarded = (0..10_000).map(|k| claimant.send(&mut station, at(10 + k / 10), &gcs).len()).sum::<usize>();
    // A hundred peers, of ten thousand copies a second.
    assert!((100..=210).contains(&forwarded), "{forwarded}");
    assert!(station.later_health(LINK).rate_limited > 9_000);
    // A command to one robot is one copy, however many robots there are.
    let before = station.outputs.len();
    let steer = |k: u16| Message::Command(CommandLong { target: address(7), command: k, params: [0.0; 7] });
    for k in 0..2_000 {
        claimant.send(&mut station, at(10_000 + i64::from(k) / 2), &steer(30_000 + k));
    }
    let steered = station.sent_since(before).filter(|sent| sent.to == Recipients::Peer(PeerId(7)));
    assert!(steered.count() >= 2_000);
}
