//! Commands for one robot of several.

use super::{ACCEPTED, LOGGING_START, PREFLIGHT_STORAGE, SET_POSE, UNSUPPORTED};
use crate::support::ground::{GCS, Ground};
use crate::support::{BRICK, LINK, at, frame, ticks};
use posebridge_protocol::message::{CommandAck, CommandLong, Message};
use posebridge_station::AnnouncedAs;
use posebridge_telemetry::{
    Address, Command, Heading, Input, Meters, ParameterStorage, Pose, Request, RobotId, SensorId, SensorSwitch,
    SimulatorCommand, SteeringSource,
};

/// Its component is none of a vehicle: towards ground stations the station sends for it.
const OTHER: Address = Address::new(2, 7);
const OTHER_ROBOT: RobotId = RobotId { link: LINK, address: OTHER };

/// Two robots at rest at the arena's origin.
fn two_robots() -> Ground {
    let mut ground = Ground::new(|config| config.links[1].announced_as = AnnouncedAs::StationAndVehicle);
    for millis in [100_u32, 150, 200] {
        for address in [BRICK, OTHER] {
            ground.station.bytes(at(i64::from(millis)), &frame(address, &ticks(millis, 0, 0)));
        }
    }
    assert_eq!(ground.station.engine.robots().len(), 2);
    ground
}

fn set_pose(x_m: f64) -> Command {
    let pose = Pose::new(Meters(x_m), Meters(0.0), Heading::from_rad(0.0));
    Command::SetPose { pose, position_sigma_m: 0.01, heading_sigma_rad: 0.1 }
}

/// Where the robots are, and how many of their sensors are switched off.
fn positions(ground: &Ground) -> Vec<(f64, usize)> {
    let robots = ground.station.engine.robots().iter().map(|robot| {
        let estimate = robot.latest_time().and_then(|latest| robot.estimate_at(latest));
        let x_m = estimate.map_or(f64::NAN, |estimate| estimate.pose.x.0);
        ((x_m * 1e3).round() / 1e3, robot.switched_off().count())
    });
    robots.collect()
}

#[test]
fn a_command_for_one_robot_leaves_the_others_alone_and_names_it() {
    let mut ground = two_robots();
    let switch = Command::SwitchSource { sensor: SensorId::GYRO, to: SensorSwitch::Off };
    for (millis, command) in [(300, set_pose(1.5)), (310, switch)] {
        ground.station.handle(at(millis), Input::RobotCommand { robot: OTHER_ROBOT, command });
    }
    assert_eq!(positions(&ground), [(0.0, 0), (1.5, 1)]);
    assert_eq!(ground.station.texts()[0], "robot link 3 2/7: pose set to x 1.500 m, y 0.000 m, 0.0 deg");
    ground.station.handle(at(320), Input::RobotCommand { robot: OTHER_ROBOT, command: Command::ResetPose });
    assert_eq!(positions(&ground), [(0.0, 0), (0.0, 1)]);
    // Without a robot the pose is the first one's and a switch is for all.
    for (millis, command) in [(330, set_pose(-0.5)), (340, switch)] {
        ground.station.handle(at(millis), Input::Command(command));
    }
    assert_eq!(positions(&ground), [(-0.5, 1), (0.0, 1)]);
}

#[test]
fn commands_for_the_station_and_for_an_unknown_robot_are_distinguished() {
    let mut ground = two_robots();
    let steer = SimulatorCommand::Steering(SteeringSource::Estimate);
    for command in [Command::Parameters(ParameterStorage::Default), Command::Simulator(steer)] {
        ground.station.handle(at(300), Input::RobotCommand { robot: OTHER_ROBOT, command });
    }
    ground.station.handle(at(310), Input::Command(Command::Simulator(steer)));
    let for_robots = [Some(OTHER_ROBOT), None].map(|robot| Request::Simulator { robot, command: steer });
    assert_eq!(ground.requests(), for_robots.iter().collect::<Vec<_>>());
    assert_eq!(ground.station.texts()[0], "parameters set to their defaults");
    let robot = RobotId { link: LINK, address: Address::new(9, 1) };
    ground.station.handle(at(320), Input::RobotCommand { robot, command: set_pose(3.0) });
    assert_eq!(positions(&ground), [(0.0, 0), (0.0, 0)]);
    assert_eq!(ground.station.texts().last().copied(), Some("no robot link 3 9/1"));
}

#[test]
fn a_ground_station_that_commands_a_vehicle_reaches_that_robot() {
    let mut ground = two_robots();
    let vehicle = Address::new(OTHER.system.0, 1);
    let mut result = |millis, command, params: [f32; 7]| {
        let answers = ground.send(millis, &Message::Command(CommandLong { target: vehicle, command, params }));
        let answers: Vec<u8> = answers
            .iter()
            .filter_map(|answer| match answer {
                Message::CommandAck(CommandAck { result, target: Some(GCS), .. }) => Some(*result),
                _ => None,
            })
            .collect();
        (answers, positions(&ground))
    };
    let set_pose = result(300, SET_POSE, [0.0, 0.7, 0.0, 0.01, 0.1, 0.0, 0.0]);
    assert_eq!(set_pose, (vec![ACCEPTED], vec![(0.0, 0), (0.7, 0)]));
    // The parameters are shown at each vehicle, a recording is the station's.
    assert_eq!(result(310, PREFLIGHT_STORAGE, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).0, [ACCEPTED]);
    assert_eq!(result(320, LOGGING_START, [0.0; 7]).0, [UNSUPPORTED]);
}
