//! Many peers on one link: robots of which one is silent and one sends garbage, and invented senders.

use std::collections::BTreeSet;

use crate::support::{AlignedObservation, BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, ticks};
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::{TransportKind, WireVersion};
use posebridge_telemetry::{Address, Input, ObservationKind, PeerId, SourceHealth, TimeDelta};
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
