//! Speeds from a program: to a robot that takes goals, and to no other.

use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, ticks};
use posebridge_protocol::message::{Message, PositionTarget, Setpoint};
use posebridge_station::{GoalPolicy, OwnershipPolicy, StationConfig};
use posebridge_telemetry::{Command, Input, MetersPerSecond, Ownership, PeerId, RadiansPerSecond, RobotId};

const ROBOT: RobotId = RobotId { link: LINK, address: BRICK };

fn drive(forward_m_per_s: f64) -> Input {
    let command = Command::Drive { forward: MetersPerSecond(forward_m_per_s), turn: RadiansPerSecond(-0.5) };
    Input::RobotCommand { robot: ROBOT, command }
}

fn station(goals: GoalPolicy, ownership: OwnershipPolicy) -> TestStation {
    let mut config = StationConfig { ownership, ..config() };
    config.robot.goals = goals;
    let mut station = TestStation::new(&config);
    for (millis, message) in [(1, HEARTBEAT), (2, ticks(100, 0, 0)), (52, ticks(150, 0, 0))] {
        station.bytes_from(at(millis), LINK, PeerId::default(), &frame(BRICK, &message));
    }
    station
}

/// The speeds that the robot is sent because of an input.
fn sent(station: &mut TestStation, millis: i64, input: Input) -> Vec<Setpoint> {
    let before = station.outputs.len();
    station.handle(at(millis), input);
    let messages = station.messages_since(before, LINK);
    let targets = messages.into_iter().filter_map(|message| match message {
        Message::PositionTarget(PositionTarget { target: BRICK, setpoint }) => Some(setpoint),
        _ => None,
    });
    targets.collect()
}

#[test]
fn speeds_reach_a_robot_that_takes_goals_and_a_stream_of_them_is_one_line() {
    let mut station = station(GoalPolicy::Accept, OwnershipPolicy::Unmanaged);
    for (millis, speed) in [(100, 0.25), (150, 0.5), (200, 0.5)] {
        let setpoint = Setpoint::BodyVelocity { forward: MetersPerSecond(speed), turn: RadiansPerSecond(-0.5) };
        assert_eq!(sent(&mut station, millis, drive(speed)), [setpoint]);
    }
    let lines = station.texts().iter().filter(|text| text.contains("driven by a program")).count();
    assert_eq!(lines, 1);
    assert_eq!(sent(&mut station, 250, drive(f64::NAN)), []);
    assert!(station.texts().iter().any(|text| text.contains("not finite")));
}

#[test]
fn a_robot_that_takes_none_and_one_of_another_station_are_sent_nothing_which_is_said() {
    let mut refusing = station(GoalPolicy::Refuse, OwnershipPolicy::Unmanaged);
    assert_eq!(sent(&mut refusing, 100, drive(0.1)), []);
    assert!(refusing.texts().iter().any(|text| text.contains("`robot.accepts_goals`")));
    let mut standby = station(GoalPolicy::Accept, OwnershipPolicy::Fleet);
    assert_eq!(sent(&mut standby, 100, drive(0.1)), []);
    assert!(standby.texts().iter().any(|text| text.contains("another station owns the robot")));
    standby.handle(at(110), Input::Ownership { robot: ROBOT, ownership: Ownership::Owner { epoch: 1, state: None } });
    assert_eq!(sent(&mut standby, 120, drive(0.1)).len(), 1);
}
