//! What ground stations show of a vehicle: its place on the Earth, its sensors, its battery.

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, link, messages, stream, ticks, vision_fix};
use posebridge_protocol::message::{Battery, Message, SetGlobalOrigin};
use posebridge_protocol::routing::ForwardedDialects;
use posebridge_station::{AnnouncedAs, OutputKind, StationConfig};
use posebridge_telemetry::{GeodeticOrigin, GeodeticPoint, Meters, Radians, SystemId};

const GYRO: u32 = 1;
const MOTORS: u32 = 1 << 15;
const VISION: u32 = 1 << 7;

fn delft() -> GeodeticPoint {
    GeodeticPoint { latitude: Radians(52.0_f64.to_radians()), longitude: Radians(4.3_f64.to_radians()) }
}

fn two_links() -> StationConfig {
    let mut config = config();
    config.robot.filter_config.start = None;
    config.origin = GeodeticOrigin::new(delft(), Meters(3.0));
    let mut gcs = link(GCS_LINK, vec![stream(OutputKind::GlobalPosition, 200), stream(OutputKind::HeadUpDisplay, 200)]);
    gcs.announced_as = AnnouncedAs::StationAndVehicle;
    gcs.rules.dialects = ForwardedDialects::Stock;
    config.links.push(gcs);
    config
}

/// The robot stands at x 1.2 m, and is seen there.
fn drive(station: &mut TestStation, brick: &mut RemotePeer, until_ms: u32) {
    for millis in (0..until_ms).step_by(50) {
        let now = at(i64::from(millis) + 5);
        station.pass_until(now);
        if millis % 1_000 == 0 {
            brick.send(station, now, &HEARTBEAT);
        }
        brick.send(station, now, &ticks(millis, 0, 0));
        if millis % 200 == 0 {
            brick.send(station, now, &Message::VisionPosition(vision_fix(i64::from(millis), 1.2)));
        }
    }
}

/// What the ground station's link got, by its kind.
fn shown<T>(station: &TestStation, pick: impl Fn(&Message) -> Option<T>) -> Vec<T> {
    let sent = station.sent().filter(|sent| sent.link == GCS_LINK);
    sent.flat_map(|sent| messages(sent.bytes)).filter_map(|message| pick(&message)).collect()
}

fn positions(station: &TestStation) -> Vec<GeodeticPoint> {
    shown(station, |message| if let Message::GlobalPosition(global) = message { Some(global.position) } else { None })
}

/// Sensors present and healthy, and the battery.
fn statuses(station: &TestStation) -> Vec<(u32, u32, Battery)> {
    shown(station, |message| match message {
        Message::SystemStatus(status) => Some((status.sensors_present, status.sensors_healthy, status.battery)),
        _ => None,
    })
}

#[test]
fn the_map_shows_the_robot_east_of_home() {
    let mut station = TestStation::new(&two_links());
    drive(&mut station, &mut RemotePeer::new(BRICK, LINK, 0), 3_000);
    let home = shown(&station, |message| if let Message::HomePosition(home) = message { Some(*home) } else { None });
    assert!(home.len() >= 2, "with each heartbeat");
    assert_eq!(home[0].altitude, Meters(3.0));
    let shown = positions(&station);
    let last = shown.last().expect("it is placed");
    // Degrees E7 are 7 mm here.
    let arena = two_links().origin.expect("it has one").to_arena(*last);
    assert!((arena.x.0 - 1.2).abs() < 0.03 && arena.y.0.abs() < 0.03, "{arena:?}");
}

#[test]
fn no_map_without_an_origin_until_a_ground_station_sets_one() {
    let mut station = TestStation::new(&StationConfig { origin: None, ..two_links() });
    drive(&mut station, &mut RemotePeer::new(BRICK, LINK, 0), 2_000);
    assert_eq!(positions(&station), []);
    let mut gcs = RemotePeer::new(GCS, GCS_LINK, 0);
    let request = |system, latitude: f64| {
        let position = GeodeticPoint { latitude: Radians(latitude.to_radians()), ..delft() };
        Message::SetGlobalOrigin(SetGlobalOrigin { system: SystemId(system), position, altitude: Meters(3.0) })
    };
    let origins = |station: &TestStation| {
        shown(station, |message| if let Message::GlobalOrigin(origin) = message { Some(origin.position) } else { None })
    };
    // Another vehicle's, and no place on the Earth.
    gcs.send(&mut station, at(2_010), &request(9, 52.0));
    gcs.send(&mut station, at(2_020), &request(1, 90.0));
    // A peer on the link of a robot may not set it.
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    brick.send(&mut station, at(2_025), &request(1, 52.0));
    assert_eq!(origins(&station), []);
    gcs.send(&mut station, at(2_030), &request(1, 52.0));
    let answered = origins(&station);
    assert!((answered[0].latitude.0 - delft().latitude.0).abs() < 1e-8, "{answered:?}");
    brick.send(&mut station, at(2_050), &ticks(2_050, 0, 0));
    assert_eq!(positions(&station).len(), 1);
    // One that asks without end gets as many answers as for any other request, and the text is about a change.
    let before = origins(&station).len();
    for millis in 2_100..3_100 {
        gcs.send(&mut station, at(millis), &request(0, 52.0));
    }
    assert!((590..620).contains(&(origins(&station).len() - before)), "{}", origins(&station).len() - before);
    assert_eq!(station.texts().iter().filter(|text| text.starts_with("origin set")).count(), 1);
}

#[test]
fn sensors_that_are_heard_and_used_are_healthy_and_a_robots_own_status_stands_for_itself() {
    let mut station = TestStation::new(&two_links());
    let mut brick = RemotePeer::new(BRICK, LINK, 0);
    drive(&mut station, &mut brick, 3_000);
    let (present, healthy, battery) = *statuses(&station).last().expect("one with each heartbeat");
    assert_eq!(present & (MOTORS | VISION | GYRO), MOTORS | VISION);
    assert_eq!(healthy & (MOTORS | VISION | GYRO), MOTORS | VISION);
    assert_eq!(battery, Battery::default());
    // Wheels and camera fall silent, the robot lives.
    for millis in (3_000..9_000).step_by(500) {
        station.pass_until(at(millis));
        brick.send(&mut station, at(millis), &HEARTBEAT);
    }
    let (present, healthy, _) = *statuses(&station).last().expect("one with each heartbeat");
    assert_eq!((present & (MOTORS | VISION), healthy & (MOTORS | VISION)), (MOTORS | VISION, 0));
    // Its own BATTERY_STATUS is forwarded, and not sent again by the station.
    let pack = Battery { voltage_v: Some(7.9), current_a: None, remaining: None };
    brick.send(&mut station, at(9_000), &Message::BatteryStatus(pack));
    station.pass_until(at(13_000));
    let packs = shown(&station, |message| matches!(message, Message::BatteryStatus(_)).then_some(()));
    assert_eq!(packs.len(), 1);
    assert_eq!(statuses(&station).last().expect("still one with each heartbeat").2, pack);
}

#[test]
fn our_own_messages_are_not_forwarded_to_who_knows_the_stock_dialects_alone() {
    for (dialects, expected) in [(ForwardedDialects::Stock, 0), (ForwardedDialects::All, 20)] {
        let mut config = two_links();
        config.links[1].rules.dialects = dialects;
        let mut station = TestStation::new(&config);
        drive(&mut station, &mut RemotePeer::new(BRICK, LINK, 0), 1_000);
        let forwarded = shown(&station, |message| matches!(message, Message::WheelTicks(_)).then_some(()));
        assert_eq!(forwarded.len(), expected, "{dialects:?}");
    }
}
