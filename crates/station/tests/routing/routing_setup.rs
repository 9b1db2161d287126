//! One station with three links: whom it passes a frame on to, and that it is fused once.

use crate::brick::{BRICK, HEARTBEAT, ticks};
use crate::events::{self, observed};
use crate::network::{RemotePeer, passed_on};
use crate::station::{LINK, STATION, TestStation, at, config, link};
use posebridge_protocol::message::{CommandAck, CommandLong, Message, VisionFix, WireStamp};
use posebridge_station::StationConfig;
use posebridge_telemetry::{
    Address, Event, Heading, LinkHealth, LinkId, LinkState, Meters, PeerId, Priority, Recipients, TimeDelta,
};

const CAMERA_LINK: LinkId = LinkId(4);
pub(crate) const GCS_LINK: LinkId = LinkId(5);
const CAMERA: Address = Address::new(2, 100);
const GCS: Address = Address::new(254, 190);
const OTHER_GCS: Address = Address::new(253, 190);

pub(crate) fn three_links() -> StationConfig {
    let mut config = config();
    config.links.push(link(CAMERA_LINK, vec![]));
    config.links.push(link(GCS_LINK, vec![]));
    config
}

/// A station that has heard a brick, a camera and two ground stations on one port.
pub(crate) struct RoutingSetup {
    pub(crate) station: TestStation,
    pub(crate) brick: RemotePeer,
    pub(crate) camera: RemotePeer,
    pub(crate) gcs: RemotePeer,
}

impl RoutingSetup {
    pub(crate) fn new(config: &StationConfig) -> Self {
        let mut setup = Self {
            station: TestStation::new(config),
            brick: RemotePeer::new(BRICK, LINK, 0),
            camera: RemotePeer::new(CAMERA, CAMERA_LINK, 0),
            gcs: RemotePeer::new(GCS, GCS_LINK, 5),
        };
        let station = &mut setup.station;
        setup.brick.send(station, at(10), &HEARTBEAT);
        setup.camera.send(station, at(11), &HEARTBEAT);
        setup.gcs.send(station, at(12), &HEARTBEAT);
        RemotePeer::new(OTHER_GCS, GCS_LINK, 6).send(station, at(13), &HEARTBEAT);
        setup
    }
}

pub(crate) fn command() -> Message {
    Message::Command(CommandLong { target: BRICK, command: 400, params: [1.0; 7] })
}

fn ack() -> Message {
    Message::CommandAck(CommandAck { command: 400, result: 0, target: Some(GCS) })
}

/// What a link has carried, a second after the last output.
pub(crate) fn health(station: &mut TestStation, id: LinkId) -> LinkHealth {
    let until = station.outputs.last().map_or(at(0), |(now, _)| *now) + TimeDelta::from_millis(1_000);
    station.pass_until(until);
    events::health(station, id).0
}

#[test]
fn a_command_reaches_only_the_brick_and_its_answer_only_the_one_who_asked() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    let (_, passed) = setup.gcs.send(station, at(100), &command());
    let to_brick = (LINK, Recipients::Peer(PeerId(0)), Priority::Command);
    assert_eq!(passed, [to_brick]);
    let (_, passed) = setup.brick.send(station, at(130), &ack());
    let to_gcs = (GCS_LINK, Recipients::Peer(PeerId(5)), Priority::Command);
    assert_eq!(passed, [to_gcs]);
    assert_eq!(health(station, GCS_LINK).forwarded, 3 + 1);
}

#[test]
fn telemetry_reaches_all_others_as_it_came() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    let (_, passed) = setup.brick.send(station, at(100), &ticks(5_000, 0, 0));
    let all = |link| (link, Recipients::All, Priority::Forwarded);
    assert_eq!(passed, [all(CAMERA_LINK), all(GCS_LINK)]);
    let (_, passed) = setup.gcs.send(station, at(110), &HEARTBEAT);
    let others = (GCS_LINK, Recipients::AllExcept(PeerId(5)), Priority::Forwarded);
    assert_eq!(passed, [all(LINK), all(CAMERA_LINK), others]);
    assert_eq!(observed(station), 1);
}

#[test]
fn a_message_of_no_dialect_is_passed_on_byte_for_byte_and_teaches_nothing() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    // Id 60000 from 77/1, whose checksum only its author knows.
    let mut unknown = vec![0xFD, 5, 0, 0, 9, 77, 1, 0x60, 0xEA, 0x00];
    unknown.extend_from_slice(&[1, 0, 254, 0, 9, 0xAB, 0xCD]);
    // It is believed when a verified frame begins where it ends.
    let bytes = [unknown.clone(), setup.brick.frame(&HEARTBEAT)].concat();
    let seen = station.outputs.len();
    setup.brick.send_bytes(station, at(100), &bytes);
    let all = |link| (link, Recipients::All, Priority::Forwarded);
    assert_eq!(passed_on(station, seen, &unknown), [all(CAMERA_LINK), all(GCS_LINK)]);
    let to_stranger = Message::Command(CommandLong { target: Address::new(77, 1), command: 400, params: [0.0; 7] });
    assert_eq!(setup.gcs.send(station, at(110), &to_stranger).1, []);
}

#[test]
fn what_the_station_says_is_not_passed_on_when_it_comes_back() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    let own = RemotePeer::new(STATION, CAMERA_LINK, 0).frame(&HEARTBEAT);
    let seen = station.outputs.len();
    setup.camera.send_bytes(station, at(100), &own);
    assert_eq!(passed_on(station, seen, &own), []);
    let commanded = Message::Command(CommandLong { target: STATION, command: 400, params: [0.0; 7] });
    assert_eq!(setup.gcs.send(station, at(110), &commanded).1, []);
}

#[test]
fn a_link_that_is_down_gets_nothing_and_its_routes_are_forgotten() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    station.link(at(50), LINK, LinkState::Down);
    let (_, passed) = setup.gcs.send(station, at(100), &HEARTBEAT);
    assert!(passed.iter().all(|(link, ..)| *link != LINK), "{passed:?}");
    assert_eq!(health(station, LINK).drops_out, 1);
    station.link(at(1_200), LINK, LinkState::Up);
    assert_eq!(setup.gcs.send(station, at(1_210), &command()).1, []);
    setup.brick.send(station, at(1_220), &HEARTBEAT);
    assert_eq!(setup.gcs.send(station, at(1_230), &command()).1.len(), 1);
}

#[test]
fn a_fix_that_goes_round_a_loop_is_fused_once_and_the_robot_is_heard_on_its_own_link() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    for k in 0..60_u32 {
        let now = at(100 + i64::from(k) * 50);
        let frame = setup.brick.frame(&ticks(5_000 + k * 50, 0, 0));
        // Once the direct way is known, another station is quicker.
        if k > 0 {
            setup.gcs.send_bytes(station, now, &frame);
        }
        setup.brick.send_bytes(station, now, &frame);
        let frame = setup.camera.frame(&fix_at(u64::from(9_000 + k * 50)));
        setup.camera.send_bytes(station, now, &frame);
        setup.gcs.send_bytes(station, now + TimeDelta::from_millis(10), &frame);
    }
    let used = |source: Address| {
        let events = station.events();
        let used = events.filter(|event| matches!(event, Event::ObservationAligned { source: s, .. } if *s == source));
        used.count()
    };
    assert_eq!(used(BRICK), 60);
    // Each fix is used, or told to come before its clock is known; but once.
    let is_defect = |event: &&Event| matches!(event, Event::ReceiveError { .. });
    let unaligned = station.events().filter(is_defect).count();
    assert!(used(CAMERA) > 20, "{}", used(CAMERA));
    assert_eq!(used(CAMERA) + unaligned, 60);
    assert_eq!(health(station, LINK).duplicates, 59);
    assert_eq!(health(station, GCS_LINK).duplicates, 60);
}

/// The robot seen at the origin, by the camera's clock.
fn fix_at(camera_ms: u64) -> Message {
    Message::VisionPosition(VisionFix {
        stamp: WireStamp::Micros64(camera_ms * 1_000),
        x: Meters(0.0),
        y: Meters(0.0),
        heading: Some(Heading::from_rad(0.0)),
        covariance: None,
        reset_counter: 0,
        tag: None,
    })
}
