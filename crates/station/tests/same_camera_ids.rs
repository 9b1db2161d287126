//! A room with robots behind one port, each with a camera that nobody has given an address: all cameras have the same ids.
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

use brick::{HEARTBEAT, frame, messages, ticks};
use posebridge_protocol::message::{Heartbeat, Message, TimeSync, VisionFix, WireStamp};
use posebridge_telemetry::{
    Address, Event, Heading, HostClock, Input, Meters, Output, PeerId, ReceiveError, Recipients, SensorId, TimeDelta,
    Timestamp,
};
use station::{LINK, TestStation, at, config};

const ROBOTS: u32 = 12;
const CAMERA: Address = Address::new(1, 100);

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

/// Where a robot stands: each a little further along the arena.
fn place_m(robot: u32) -> f64 {
    1e-3 * f64::from(robot)
}

fn send(station: &mut TestStation, now: Timestamp<HostClock>, robot: u32, from: Address, message: &Message) {
    station.handle(now, Input::Bytes { link: LINK, peer: PeerId(robot), bytes: frame(from, message) });
}

/// Robots and cameras answer the time requests of the last tenth of a second; the robots, which stand, tell their wheels.
fn tenth(station: &mut TestStation, k: i64) {
    let now = at(100 * k);
    let before = station.outputs.len();
    station.pass_until(now);
    let sent = station.outputs[before..].iter().filter_map(|(sent, output)| match output {
        Output::Transmit { bytes, .. } => Some((*sent, bytes.clone())),
        _ => None,
    });
    let requests = sent.flat_map(|(sent, bytes)| messages(&bytes).into_iter().map(move |message| (sent, message)));
    let requests: Vec<(Timestamp<HostClock>, i64)> = requests
        .filter_map(|(sent, message)| match message {
            Message::TimeSync(sync) if sync.answer_nanos == 0 => Some((sent, sync.request_nanos)),
            _ => None,
        })
        .collect();
    for (sent, request_nanos) in requests {
        for robot in 0..ROBOTS {
            for (from, ahead_ms) in [(robot_address(robot), robot_ahead_ms(robot)), (CAMERA, camera_ahead_ms(robot))] {
                let answered = sent + TimeDelta::from_millis(1);
                let answer_nanos = answered.as_nanos() + ahead_ms * 1_000_000;
                let sync = Message::TimeSync(TimeSync { answer_nanos, request_nanos, target: None });
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
        for from in [robot_address(robot), CAMERA] {
            send(&mut station, at(1), robot, from, &HEARTBEAT);
        }
    }
    for k in 1..=15 {
        tenth(&mut station, k);
    }
    let before = station.outputs.len();
    let exposed = at(1_480);
    for robot in 0..ROBOTS {
        let stamp = WireStamp::Micros64((exposed.as_micros() + camera_ahead_ms(robot) * 1_000) as u64);
        let fix = VisionFix {
            stamp,
            x: Meters(place_m(robot)),
            y: Meters(0.0),
            heading: Some(Heading::from_rad(0.0)),
            covariance: Some([1e-6, 0.0, 1e-6, 1e-4]),
            reset_counter: 0,
            tag: None,
        };
        send(&mut station, at(1_510), robot, CAMERA, &Message::VisionPosition(fix));
    }
    let mut observed = Vec::new();
    for (_, output) in &station.outputs[before..] {
        match output {
            Output::Event(Event::ObservationAligned { robot, observation, source: CAMERA, .. }) => {
                let index = u32::from(robot.address.system.0) - 1;
                let expected_ms = exposed.as_micros() / 1_000 + robot_ahead_ms(index);
                let off = observation.stamp - Timestamp::from_millis(expected_ms);
                assert!(off.as_millis_f64().abs() < 3.0, "robot {index} is off by {off:?}");
                observed.push((index, observation.sensor));
            }
            Output::Event(Event::ReceiveError { defect: ReceiveError::ClockNotAligned { source }, .. }) => {
                panic!("the clock of {source} is not known");
            }
            _ => {}
        }
    }
    assert_eq!(observed, (0..ROBOTS).map(|robot| (robot, SensorId::CAMERA)).collect::<Vec<_>>());
    for robot in station.engine.robots() {
        let latest = robot.latest_time().expect("it was observed");
        let x_m = robot.estimate_at(latest).expect("it was observed").pose.x.0;
        let expected_m = place_m(u32::from(robot.id().address.system.0) - 1);
        assert!((x_m - expected_m).abs() <= 0.1 * expected_m, "{x_m} {expected_m}");
    }
}

#[test]
fn what_a_robot_says_to_everybody_goes_to_the_ground_station_and_to_no_other_robot() {
    let mut station = TestStation::new(&config());
    let ground_station = PeerId(ROBOTS);
    let gcs_heartbeat = Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 });
    for robot in 0..ROBOTS {
        send(&mut station, at(1), robot, robot_address(robot), &HEARTBEAT);
        send(&mut station, at(2), robot, robot_address(robot), &ticks(1_000, 0, 0));
    }
    let heard_by = |station: &mut TestStation, from: u32, address, message: &Message, now| {
        let before = station.outputs.len();
        send(station, now, from, address, message);
        let bytes = frame(address, message);
        let sent = station.outputs[before..].iter().filter_map(|(_, output)| match output {
            // The sequence number is that of the first frame in both.
            Output::Transmit { to, bytes: sent, .. } if *sent == bytes => Some(*to),
            _ => None,
        });
        sent.collect::<Vec<Recipients>>()
    };
    let everybody_else = vec![Recipients::AllExcept(ground_station)];
    assert_eq!(heard_by(&mut station, ROBOTS, Address::new(254, 190), &gcs_heartbeat, at(3)), everybody_else);
    let of_robot = heard_by(&mut station, 4, robot_address(4), &ticks(1_050, 7, 8), at(50));
    assert_eq!(of_robot, [Recipients::Peer(ground_station)]);
}
