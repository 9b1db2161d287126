//! Vehicles of stock autopilots: their inertial units, satellite fixes and speeds of wheels move the filter.

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, link};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    GnssFix, Heartbeat, ImuMessage, LandmarkSighting, Message, PlanarImu, SetGlobalOrigin, WireStamp,
};
use posebridge_station::{AnnouncedAs, LinkConfig, RpmMeaning, StationConfig};
use posebridge_telemetry::{
    Address, GeodeticOrigin, GeodeticPoint, LandmarkId, LinkId, Meters, MetersPerSecond, ObservationKind, Point2,
    Radians, RadiansPerSecond, SensorId, SystemId, TimeDelta,
};

/// ArduPilot on a ground rover.
const ROVER: Message = Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 3, base_mode: 0, system_status: 4 });

fn origin() -> GeodeticOrigin {
    let degrees = |degrees: f64| Radians(degrees.to_radians());
    let point = GeodeticPoint { latitude: degrees(52.0), longitude: degrees(4.3) };
    GeodeticOrigin::new(point, Meters(3.0)).expect("in Holland")
}

fn with_origin() -> StationConfig {
    StationConfig { origin: Some(origin()), ..config() }
}

fn imu(message: ImuMessage, millis: i64, rate: f64) -> Message {
    let stamp = match message {
        ImuMessage::Highres | ImuMessage::Raw => WireStamp::Micros64(millis as u64 * 1_000),
        ImuMessage::Scaled | ImuMessage::Scaled2 | ImuMessage::Scaled3 => WireStamp::Millis32(millis as u32),
    };
    Message::Imu(PlanarImu { message, stamp, turn_rate: Some(RadiansPerSecond(rate)), forward_acceleration: None })
}

fn satellites(millis: i64, x_m: f64, y_m: f64) -> Message {
    let point = Point2::new(Meters(x_m), Meters(y_m));
    Message::GnssFix(GnssFix {
        stamp: WireStamp::Micros64(millis as u64 * 1_000),
        position: origin().to_geodetic(point),
        sigma: Some(Meters(0.5)),
        ground_speed: None,
    })
}

#[test]
fn without_wheels_satellites_place_the_robot_and_one_of_its_units_turns_it() {
    let mut station = TestStation::new(&with_origin());
    let mut rover = RemotePeer::new(BRICK, LINK, 0);
    for millis in (0..20_000).step_by(50) {
        let now = at(millis + 5);
        if millis % 1_000 == 0 {
            rover.send(&mut station, now, &ROVER);
        }
        // The second unit is broken, and says so by another rate.
        rover.send(&mut station, now, &imu(ImuMessage::Raw, millis, 0.1));
        rover.send(&mut station, now, &imu(ImuMessage::Scaled2, millis, -0.7));
        if millis % 200 == 0 {
            rover.send(&mut station, now, &satellites(millis, 12.0, -7.0));
        }
    }
    let aligned = station.aligned();
    let of = |sensor| aligned.iter().filter(|one| one.observation.sensor == sensor).collect::<Vec<_>>();
    let rates = of(SensorId::GYRO);
    assert_eq!(rates.len(), 400, "one for each of the first unit's");
    let is_right = |kind| matches!(kind, ObservationKind::TurnRate(rate) if (rate.0 - 0.1).abs() < 1e-3);
    assert!(rates.iter().all(|one| is_right(one.observation.measurement)));
    assert_eq!(of(SensorId::GNSS).len(), 100);
    let estimate = station.last_estimate();
    assert!(estimate.validity.position);
    assert!((estimate.pose.x.0 - 12.0).hypot(estimate.pose.y.0 + 7.0) < 0.3, "{:?}", estimate.pose);
    assert!((estimate.turn_rate.0 - 0.1).abs() < 0.02, "{:?}", estimate.turn_rate);
    let is_about_wheels = |text: &&&str| text.starts_with("1/1: heard RAW_IMU, SCALED_IMU2, GPS_RAW_INT");
    assert_eq!(station.texts().iter().filter(is_about_wheels).count(), 1, "{:?}", station.texts());
}

/// A rover that drives east at 1 m/s; wheels are heard from the twentieth second on.
#[test]
fn the_speed_of_a_satellite_receiver_stands_in_for_wheels_and_makes_way_for_them() {
    let mut config = with_origin();
    config.robot.filter_config.start = None;
    let mut station = TestStation::new(&config);
    let mut rover = RemotePeer::new(BRICK, LINK, 0);
    for millis in (0..25_000).step_by(50) {
        let now = at(millis + 5);
        if millis % 1_000 == 0 {
            rover.send(&mut station, now, &ROVER);
        }
        rover.send(&mut station, now, &imu(ImuMessage::Raw, millis, 0.0));
        if millis % 200 == 0 {
            let Message::GnssFix(fix) = satellites(millis, millis as f64 * 1e-3, 0.0) else { unreachable!() };
            let moving = GnssFix { ground_speed: Some(MetersPerSecond(1.0)), ..fix };
            rover.send(&mut station, now, &Message::GnssFix(moving));
        }
        if millis >= 20_000 {
            let travel = Meters((millis - 20_000) as f64 * 1e-3);
            let wheels = Message::WheelDistance {
                stamp: WireStamp::Micros64(millis as u64 * 1_000),
                left: travel,
                right: travel,
            };
            rover.send(&mut station, now, &wheels);
        }
        if millis == 19_900 {
            let estimate = station.last_estimate();
            assert!(estimate.validity.heading && estimate.pose.heading.rad().abs() < 0.1, "{estimate:?}");
            assert!((estimate.pose.x.0 - 19.8).hypot(estimate.pose.y.0) < 0.5, "{:?}", estimate.pose);
        }
    }
    let aligned = station.aligned();
    let is_speed = |kind| matches!(kind, ObservationKind::BodyVelocity { .. });
    let speeds = aligned.iter().filter(|one| is_speed(one.observation.measurement));
    assert_eq!(speeds.count(), 101, "none after the first of the wheels");
}

/// All of its positions are gated by the pose in the arena as it lay before, unless that is forgotten.
#[test]
fn a_robot_that_satellites_have_placed_begins_anew_where_the_arena_moves() {
    let mut config = with_origin();
    config.robot.filter_config.start = None;
    config.links.push(LinkConfig { announced_as: AnnouncedAs::StationAndVehicle, ..link(GCS_LINK, vec![]) });
    let mut station = TestStation::new(&config);
    let mut rover = RemotePeer::new(BRICK, LINK, 0);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    let moved = origin().to_geodetic(Point2::new(Meters(200.0), Meters(0.0)));
    for millis in (0..10_000).step_by(50) {
        let now = at(millis + 5);
        rover.send(&mut station, now, &imu(ImuMessage::Raw, millis, 0.0));
        if millis % 200 == 0 {
            rover.send(&mut station, now, &satellites(millis, 12.0, -7.0));
        }
        if millis == 6_000 {
            let request = SetGlobalOrigin { system: SystemId(0), position: moved, altitude: Meters(3.0) };
            gcs.send(&mut station, now, &Message::SetGlobalOrigin(request));
        }
        if millis == 7_000 {
            let x_m = station.last_estimate().pose.x.0;
            assert!((x_m + 188.0).abs() < 0.5, "{x_m}");
        }
    }
    let answers = station.messages_since(0, GCS_LINK);
    assert!(answers.iter().any(|answer| matches!(answer, Message::GlobalOrigin(_))), "the station answers for itself");
}

#[test]
fn speeds_of_wheels_and_sightings_of_known_targets_move_it() {
    let mut config = config();
    config.robot.rpm = RpmMeaning::Wheels;
    let mut map = (*config.robot.filter_config.arena_map).clone();
    map.landmarks = [(LandmarkId(7), Point2::new(Meters(3.0), Meters(0.0)))].into();
    config.robot.filter_config.arena_map = std::sync::Arc::new(map);
    let mut station = TestStation::new(&config);
    let mut rover = RemotePeer::new(BRICK, LINK, 0);
    // 20 rad/s of wheels of 28 mm.
    let turning = RadiansPerSecond(20.0);
    for millis in (0..5_000).step_by(50) {
        let now = at(millis + 5);
        if millis % 1_000 == 0 {
            rover.send(&mut station, now, &ROVER);
        }
        rover.send(&mut station, now, &imu(ImuMessage::Scaled, millis, 0.0));
        rover.send(&mut station, now, &Message::WheelSpeeds { left: turning, right: turning });
        if millis == 3_000 {
            let sighting = LandmarkSighting {
                stamp: WireStamp::Micros64(3_000_000),
                landmark: LandmarkId(7),
                forward: Meters(1.5),
                left: Meters(0.0),
            };
            rover.send(&mut station, now, &Message::LandmarkSighting(sighting));
        }
    }
    let aligned = station.aligned();
    let speeds: Vec<_> = aligned.iter().filter(|one| one.observation.sensor == SensorId::WHEELS).collect();
    let radius_m = config.robot.filter_config.geometry.left_wheel_radius.0;
    // The first ones come before the clocks are aligned, and have no stamp of their own.
    assert!(speeds.len() > 60, "{}", speeds.len());
    for one in &speeds {
        let ObservationKind::BodyVelocity { forward, turn } = one.observation.measurement else {
            panic!("{:?}", one.observation.measurement);
        };
        assert!((forward.0 - 20.0 * radius_m).abs() < 1e-4 && turn.0.abs() < 1e-9);
    }
    let speed = station.last_estimate().forward_speed.0;
    assert!((speed - 20.0 * radius_m).abs() < 0.02, "{speed}");
    let sighting = aligned.iter().find(|one| one.observation.sensor == SensorId::LANDMARKS).expect("it was used");
    let ObservationKind::Landmark { id, range, bearing } = sighting.observation.measurement else {
        panic!("{:?}", sighting.observation.measurement);
    };
    assert_eq!((id, range, bearing), (LandmarkId(7), Meters(1.5), Radians(0.0)));
}

#[test]
fn an_autopilot_is_asked_for_what_moves_a_filter_and_a_brick_for_our_own_messages() {
    let mut config = config();
    let interval = TimeDelta::from_millis(50);
    config.autopilot_message_intervals = vec![(ids::WHEEL_DISTANCE, interval), (ids::RAW_IMU, interval)];
    config.links.push(link(LinkId(1), vec![]));
    let mut station = TestStation::new(&config);
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    let mut rover = RemotePeer::new(Address::new(2, 1), LinkId(1), 0);
    for millis in (0..20_000).step_by(1_000) {
        station.pass_until(at(millis));
        brick.send(&mut station, at(millis), &HEARTBEAT);
        rover.send(&mut station, at(millis), &ROVER);
    }
    let asked = |of: u8| {
        let requests = station.sent().flat_map(|sent| crate::support::messages(sent.bytes));
        let mut ids: Vec<u32> = requests
            .filter_map(|message| match message {
                Message::SetMessageInterval(request) if request.target.system.0 == of => Some(request.message_id),
                _ => None,
            })
            .collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    };
    assert_eq!(asked(1), [ids::PB_WHEEL_TICKS, ids::PB_INERTIAL]);
    assert_eq!(asked(2), [ids::RAW_IMU, ids::WHEEL_DISTANCE]);
}
