//! Five hundred peers on one link, of which one is silent and one sends garbage: each has a framer of its own.
//!
//! In virtual time. The same with real sockets, and a link between, is a test of the program.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/station.rs"]
mod station;

use std::collections::BTreeSet;

use brick::{HEARTBEAT, ticks};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_telemetry::{
    Address, Event, HostClock, Input, LinkHealth, Observation, ObservationKind, PeerId, RobotId, SourceHealth,
    TimeDelta, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use station::{LINK, TestStation, at, config};

const ROBOTS: u32 = 498;
/// Has begun a frame once and says nothing more.
const SILENT: PeerId = PeerId(ROBOTS);
const BEGUN: [u8; 12] = [0xFD, 232, 0, 0, 0, 1, 1, 0x4B, 0x01, 0, 7, 7];
const MAD: PeerId = PeerId(ROBOTS + 1);
const ROUNDS: u32 = 20;
const PERIOD_MS: i64 = 50;
/// By so many frames the sequence numbers of two robots with one address differ.
const AHEAD: u32 = 60;
/// Bytes of garbage per robot and round.
const GARBAGE: usize = 40;

/// Two robots share each address: eight bits of system ids run out, and the link tells them apart.
fn address(robot: u32) -> Address {
    Address::new(1 + (robot % 249) as u8, 1)
}

/// Of two robots with one address the second has spoken elsewhere before: its sequence numbers are others.
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

/// Everybody speaks once per round, cut as the link does it: the second parts of all come after the first parts of all.
fn station_in_a_crowd(framing: TransportKind) -> TestStation {
    let mut config = config();
    config.links[0].framing = framing;
    let mut station = TestStation::new(&config);
    push_bytes(&mut station, at(900), SILENT, BEGUN.to_vec());
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
            push_bytes(&mut station, begin, PeerId(robot), first);
            let garbage: Vec<u8> = (0..GARBAGE).map(|_| rng.random()).collect();
            push_bytes(&mut station, begin, MAD, garbage);
        }
        let then = begin + TimeDelta::from_millis(10);
        station.pass_until(then);
        for (robot, second) in second_parts.into_iter().filter(|part| !part.1.is_empty()) {
            push_bytes(&mut station, then, PeerId(robot), second);
        }
    }
    station.pass_until(at(5_000));
    station
}

fn push_bytes(station: &mut TestStation, now: Timestamp<HostClock>, peer: PeerId, bytes: Vec<u8>) {
    let link = LINK;
    station.handle(now, Input::Bytes { link, peer, bytes });
}

fn health(station: &TestStation) -> (LinkHealth, &[SourceHealth]) {
    let told = station.events().filter_map(|event| match event {
        Event::Health { health, sources, .. } => Some((*health, sources.as_slice())),
        _ => None,
    });
    told.last().expect("once per second")
}

fn observations(station: &TestStation) -> Vec<(RobotId, Observation)> {
    let observations = station.events().filter_map(|event| match event {
        Event::ObservationAligned { robot, observation, .. } => Some((*robot, *observation)),
        _ => None,
    });
    observations.collect()
}

#[test]
fn of_five_hundred_peers_a_mad_and_a_silent_one_cost_nobody_a_frame() {
    for framing in [TransportKind::Datagram, TransportKind::Stream] {
        let mut station = station_in_a_crowd(framing);
        let (told, sources) = health(&station);
        assert_eq!(told.frames_in, u64::from(2 * ROBOTS * ROUNDS), "{framing:?}");
        assert_eq!(told.frames_lost, 0, "{framing:?}");
        let noise = u64::from(ROBOTS * ROUNDS) * GARBAGE as u64;
        let begun = BEGUN.len() as u64;
        // On a stream what the silent one has begun may still be completed.
        let garbage = match framing {
            TransportKind::Datagram => noise + begun,
            TransportKind::Stream => noise,
        };
        assert_eq!(told.garbage_bytes, garbage, "{framing:?}");
        let expected: Vec<_> = (0..249)
            .map(|robot| SourceHealth { source: address(robot), frames: u64::from(4 * ROUNDS), lost: 0 })
            .collect();
        assert_eq!(sources, expected, "{framing:?}");
        // Until he is forgotten.
        station.pass_until(at(60_000));
        let (told, _) = health(&station);
        assert_eq!(told.garbage_bytes, noise + begun, "{framing:?}");
    }
}

#[test]
fn in_a_crowd_every_robot_that_there_is_room_for_is_followed_by_its_own_counts() {
    let station = station_in_a_crowd(TransportKind::Stream);
    let tick_rad = config().robot.filter_config.geometry.tick.0;
    let mut followed = BTreeSet::new();
    for (robot, observation) in observations(&station) {
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
