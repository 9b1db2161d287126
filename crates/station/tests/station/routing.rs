//! One station with three links: where it forwards a frame, and that it is fused once.

use std::collections::BTreeMap;

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, STATION, TestStation, at, config, link, ticks, vision_fix};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{CommandAck, CommandLong, Message};
use posebridge_protocol::routing::{AllowBlockList, LinkRules};
use posebridge_station::StationConfig;
use posebridge_telemetry::{Address, Event, LinkId, LinkState, PeerId, Priority, Recipients, SystemId, TimeDelta};

const CAMERA_LINK: LinkId = LinkId(4);
const CAMERA: Address = Address::new(2, 100);
const OTHER_GCS: Address = Address::new(253, 190);

fn three_links() -> StationConfig {
    let mut config = config();
    config.links.push(link(CAMERA_LINK, vec![]));
    config.links.push(link(GCS_LINK, vec![]));
    config
}

/// A station that has received a brick, a camera and two ground stations on one port.
struct RoutingSetup {
    station: TestStation,
    brick: RemotePeer,
    camera: RemotePeer,
    gcs: RemotePeer,
}

impl RoutingSetup {
    fn new(config: &StationConfig) -> Self {
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

fn command() -> Message {
    Message::Command(CommandLong { target: BRICK, command: 400, params: [1.0; 7] })
}

#[test]
fn a_command_reaches_the_brick_its_reply_the_requester_and_telemetry_all_others() {
    let mut setup = RoutingSetup::new(&three_links());
    let station = &mut setup.station;
    let to_brick = (LINK, Recipients::Peer(PeerId(0)), Priority::Command);
    assert_eq!(setup.gcs.send(station, at(100), &command()), [to_brick]);
    let answer = Message::CommandAck(CommandAck { command: 400, result: 0, target: Some(GCS) });
    let to_gcs = (GCS_LINK, Recipients::Peer(PeerId(5)), Priority::Command);
    assert_eq!(setup.brick.send(station, at(130), &answer), [to_gcs]);
    let all = |link| (link, Recipients::All, Priority::Forwarded);
    assert_eq!(setup.brick.send(station, at(140), &ticks(5_000, 0, 0)), [all(CAMERA_LINK), all(GCS_LINK)]);
    let other_peers = (GCS_LINK, Recipients::AllExcept(PeerId(5)), Priority::Forwarded);
    assert_eq!(setup.gcs.send(station, at(150), &HEARTBEAT), [all(LINK), all(CAMERA_LINK), other_peers]);
    assert_eq!(station.aligned().len(), 1);
    assert_eq!(station.later_health(GCS_LINK).forwarded, 3 + 3);
    // A command for the station ends here.
    let for_us = Message::Command(CommandLong { target: STATION, command: 400, params: [0.0; 7] });
    assert_eq!(setup.gcs.send(station, at(1_600), &for_us), []);
    // A link that goes down loses its routes.
    station.link(at(1_700), LINK, LinkState::Down);
    station.link(at(1_800), LINK, LinkState::Up);
    assert_eq!(setup.gcs.send(station, at(1_810), &command()), []);
    setup.brick.send(station, at(1_820), &HEARTBEAT);
    assert_eq!(setup.gcs.send(station, at(1_830), &command()), [to_brick]);
}

#[test]
fn a_fix_that_goes_round_a_loop_is_fused_once_and_the_robot_stays_on_its_own_link() {
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
        let frame = setup.camera.frame(&Message::VisionPosition(vision_fix(i64::from(9_000 + k * 50), 0.0)));
        setup.camera.send_bytes(station, now, &frame);
        setup.gcs.send_bytes(station, now + TimeDelta::from_millis(10), &frame);
    }
    let used = |source: Address| station.aligned().iter().filter(|aligned| aligned.source == source).count();
    assert_eq!(used(BRICK), 60);
    // Each fix is used, or reported as before its clock is known; but once.
    let unaligned = station.count(|event| matches!(event, Event::ReceiveError { .. }));
    assert!(used(CAMERA) > 20, "{}", used(CAMERA));
    assert_eq!(used(CAMERA) + unaligned, 60);
    assert_eq!(station.later_health(LINK).duplicates, 59);
    assert_eq!(station.later_health(GCS_LINK).duplicates, 60);
}

#[test]
fn a_filtered_message_is_neither_used_nor_forwarded() {
    let mut config = three_links();
    config.links[0].rules.inward.messages = AllowBlockList { allow: vec![], block: vec![ids::PB_WHEEL_TICKS] };
    config.links[2].rules.outward.systems = AllowBlockList { allow: vec![SystemId(2)], block: vec![] };
    let mut setup = RoutingSetup::new(&config);
    let station = &mut setup.station;
    let passed = setup.brick.send(station, at(100), &ticks(5_000, 0, 0));
    assert_eq!((passed, station.aligned().len()), (vec![], 0));
    let passed = setup.brick.send(station, at(110), &HEARTBEAT);
    assert_eq!(passed.len(), 1, "the camera's link only: {passed:?}");
    let passed = setup.camera.send(station, at(120), &HEARTBEAT);
    assert_eq!(passed.len(), 2);
    assert_eq!(station.later_health(LINK).filtered, 1);
}

#[test]
fn rates_limit_telemetry_and_estimates_but_never_commands() {
    let mut config = three_links();
    let limit = |rules: &mut LinkRules| {
        rules.limits.bytes_per_s = Some(200);
        let interval = TimeDelta::from_millis(200);
        rules.limits.min_intervals = BTreeMap::from([(ids::PB_WHEEL_TICKS, interval)]);
    };
    // Estimates of 64 bytes each leave to the brick, ticks of 25 bytes to the ground station.
    limit(&mut config.links[0].rules);
    limit(&mut config.links[2].rules);
    let mut setup = RoutingSetup::new(&config);
    let mut ticks_passed = 0;
    for k in 0..200_u32 {
        let station = &mut setup.station;
        let now = at(100 + i64::from(k) * 50);
        let message = ticks(5_000 + k * 50, 0, 0);
        let passed = setup.brick.send(station, now, &message);
        ticks_passed += passed.iter().filter(|(link, ..)| *link == GCS_LINK).count();
        if k % 10 == 0 {
            let passed = setup.gcs.send(station, now, &command());
            assert_eq!(passed.len(), 1, "commands pass");
        }
    }
    assert_eq!(ticks_passed, 50, "one of four, for ten seconds");
    let station = &mut setup.station;
    let to_brick = station.sent().filter(|sent| sent.link == LINK);
    let estimates = to_brick.filter(|sent| matches!(sent.priority, Priority::Estimate { .. })).count();
    // 200 B/s for ten seconds, of which twenty commands of 45 bytes have taken their part; one bucket more at the start.
    assert!((15..=25).contains(&estimates), "{estimates}");
    let (brick, gcs) = (station.later_health(LINK), station.later_health(GCS_LINK));
    assert_eq!(brick.rate_limited + estimates as u64, 200);
    assert_eq!(gcs.rate_limited, 150);
}
