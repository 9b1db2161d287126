//! Which robots there are: every sender of odometry is one, the station's own echo is not.

use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, link, ticks};
use posebridge_protocol::message::{Message, RobotDescription};
use posebridge_station::{AnnouncedAs, DescriptionPolicy, LinkConfig, RobotBlock, RobotConfig, RobotMatch};
use posebridge_telemetry::{Address, Event, LinkId, Meters, RadiansPerSecond, RobotId, SystemId};

const NEIGHBOUR: Address = Address::new(2, 1);

fn robot(address: Address) -> RobotId {
    RobotId { link: LINK, address }
}

/// The robots that observations were assigned to.
fn observers(station: &TestStation) -> Vec<RobotId> {
    station.aligned().iter().map(|aligned| aligned.robot).collect()
}

#[test]
fn every_sender_of_odometry_is_a_robot_with_a_clock_of_its_own() {
    let mut station = TestStation::new(&config());
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    station.bytes(at(110), &frame(NEIGHBOUR, &HEARTBEAT));
    station.bytes(at(120), &frame(NEIGHBOUR, &ticks(900_000, 500, 900)));
    station.bytes(at(150), &frame(BRICK, &ticks(5_050, 4, 4)));
    station.pass_until(at(3_000));
    assert_eq!(observers(&station), [robot(BRICK), robot(NEIGHBOUR), robot(BRICK)]);
    assert_eq!(station.restarts(), []);
}

#[test]
fn a_robot_with_a_name_is_named_once_and_another_is_not() {
    let mut config = config();
    let ada = RobotConfig { name: Some("ada".to_owned()), ..config.robot.clone() };
    let matches = RobotMatch { system: Some(NEIGHBOUR.system), ..RobotMatch::default() };
    config.robots = vec![RobotBlock { matches, robot: ada }];
    config.links.push(LinkConfig { announced_as: AnnouncedAs::StationAndVehicle, ..link(LinkId(9), vec![]) });
    let mut station = TestStation::new(&config);
    for k in 0..3_u32 {
        let now = at(100 + i64::from(k) * 50);
        station.bytes(now, &frame(BRICK, &ticks(5_000 + k * 50, 0, 0)));
        station.bytes(now, &frame(NEIGHBOUR, &ticks(900_000 + k * 50, 0, 0)));
    }
    let named = |event: &&Event| matches!(event, Event::RobotNamed { .. });
    let named: Vec<Event> = station.events().filter(named).cloned().collect();
    assert_eq!(named, [Event::RobotNamed { robot: robot(NEIGHBOUR), name: "ada".to_owned() }]);
    let reports = station
        .messages_since(0, LinkId(9))
        .into_iter()
        .filter(|message| matches!(message, Message::StatusText { text, .. } if text == "robot 3/2/1 is ada"));
    assert_eq!(reports.count(), 1);
}

#[test]
fn a_configured_robot_is_waited_for() {
    let mut config = config();
    config.robot_system = Some(SystemId(2));
    let mut station = TestStation::new(&config);
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    station.bytes(at(120), &frame(NEIGHBOUR, &ticks(900_000, 0, 0)));
    assert_eq!(observers(&station), [robot(NEIGHBOUR)]);
}

/// A robot's own words, with a track of this width and encoders of 360 counts per turn.
fn description(track_width_m: f64, ticks_per_turn: f64) -> Message {
    Message::RobotDescription(RobotDescription {
        name: "tester".to_owned(),
        left_wheel_radius: Meters(0.028),
        right_wheel_radius: Meters(0.028),
        track_width: Meters(track_width_m),
        ticks_per_turn,
        gyro_sigma: RadiansPerSecond(0.01),
        gyro_resolution: RadiansPerSecond(0.0),
    })
}

/// The heading after the right wheel alone has turned by 90 counts, in radians.
fn heading_after_a_quarter(station: &mut TestStation) -> f64 {
    for k in 0..=20_u32 {
        let counts = i64::from(k) * 90 / 20;
        let now = at(1_000 + i64::from(k) * 50);
        station.bytes(now, &frame(BRICK, &ticks(5_000 + k * 50, 0, counts)));
    }
    let robot = station.engine.first_robot();
    let estimate = robot.latest_time().and_then(|latest| robot.estimate_at(latest));
    estimate.expect("it was observed").pose.heading.rad()
}

#[test]
fn a_robots_own_description_replaces_the_geometry_where_it_is_adopted() {
    let quarter_m = 0.028 * std::f64::consts::FRAC_PI_2;
    for (policy, source, described, expected_width_m) in [
        (DescriptionPolicy::Adopt, BRICK, vec![description(0.2, 360.0)], 0.2),
        (DescriptionPolicy::Ignore, BRICK, vec![description(0.2, 360.0)], 0.112),
        (DescriptionPolicy::Adopt, NEIGHBOUR, vec![description(0.2, 360.0)], 0.112),
        (DescriptionPolicy::Adopt, BRICK, vec![description(-0.2, 360.0)], 0.112),
        (DescriptionPolicy::Adopt, BRICK, vec![description(0.2, 0.0)], 0.112),
        // One that makes no sense leaves room for a sensible one.
        (DescriptionPolicy::Adopt, BRICK, vec![description(0.0, 360.0), description(0.2, 360.0)], 0.2),
    ] {
        let mut config = config();
        config.robot.description = policy;
        config.robot_system = Some(BRICK.system);
        let mut station = TestStation::new(&config);
        for message in described {
            station.bytes(at(500), &frame(source, &message));
        }
        let heading_rad = heading_after_a_quarter(&mut station);
        let expected_rad = quarter_m / expected_width_m;
        assert!(
            (heading_rad - expected_rad).abs() < 1e-6,
            "{policy:?} {source}: {heading_rad} instead of {expected_rad}"
        );
        let used_m = station.engine.first_robot().geometry().track_width.0;
        assert!((used_m - expected_width_m).abs() < 1e-6, "{used_m}");
    }
}

#[test]
fn a_description_does_not_set_the_pose() {
    let mut config = config();
    config.robot.description = DescriptionPolicy::Adopt;
    config.robot.filter_config.start = None;
    let mut station = TestStation::new(&config);
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    station.bytes(at(150), &frame(BRICK, &description(0.2, 360.0)));
    station.bytes(at(200), &frame(BRICK, &ticks(5_100, 0, 0)));
    let validity = station.last_estimate().validity;
    assert!(!validity.position && !validity.heading);
    assert_eq!(observers(&station).len(), 2);
}
