//! Who gets a frame: targets against frames of a foreign encoder, and the decisions of a router between several links.

use posebridge_protocol::dialect::message_id_named;
use posebridge_protocol::message::{CommandAck, CommandLong, Message};
use posebridge_protocol::routing::{
    DuplicateStatus, Endpoint, ForwardPolicy, FrameRouter, LinkRules, MessageTarget, RouterConfig, RoutingDecision,
    SenderCheck, priority_of, target_of,
};
use posebridge_telemetry::{Address, LinkId, PeerId, Priority, Recipients, SystemId, TimeDelta};

use crate::support::{GCS, HEARTBEAT, ROBOT, STATION, at, framed, frames_by_name, with_frame};

const CAMERA: Address = Address::new(2, 100);

const BRICK_LINK: Endpoint = endpoint(0, 0);
const CAMERA_LINK: Endpoint = endpoint(1, 0);
const GCS_LINK: Endpoint = endpoint(2, 5);

const fn endpoint(link: u16, peer: u32) -> Endpoint {
    Endpoint { link: LinkId(link), peer: PeerId(peer) }
}

/// A router between three links, as the rules say.
struct Bench {
    router: FrameRouter,
    sequence: u8,
}

impl Bench {
    fn new(rules: [LinkRules; 3]) -> Self {
        let links = (0..).map(LinkId).zip(rules);
        Self {
            router: FrameRouter::new(RouterConfig {
                own: STATION,
                duplicate_window: TimeDelta::from_millis(1_000),
                links: links.collect(),
            }),
            sequence: 0,
        }
    }

    /// A sender sends a new frame.
    fn send(&mut self, now: i64, from: Endpoint, source: Address, message: &Message) -> RoutingDecision {
        self.sequence = self.sequence.wrapping_add(1);
        let bytes = framed(self.sequence, source, message);
        self.receive(now, from, &bytes)
    }

    fn receive(&mut self, now: i64, from: Endpoint, bytes: &[u8]) -> RoutingDecision {
        with_frame(bytes, |frame| self.router.route(at(now), from, frame, SenderCheck::Verified))
    }

    /// Every sender has sent a heartbeat.
    fn introduced(mut self) -> Self {
        for (endpoint, source) in [(BRICK_LINK, ROBOT), (CAMERA_LINK, CAMERA), (GCS_LINK, GCS)] {
            self.send(0, endpoint, source, &HEARTBEAT);
        }
        self
    }
}

fn command_to(target: Address) -> Message {
    Message::Command(CommandLong { target, command: 400, params: [1.0; 7] })
}

fn to(endpoint: Endpoint) -> (LinkId, Recipients) {
    (endpoint.link, Recipients::Peer(endpoint.peer))
}

#[test]
fn the_targets_of_every_message_are_found_in_the_frames_of_a_foreign_encoder() {
    let cases = frames_by_name(include_str!("../data/targets.json"));
    assert!(cases.len() > 130, "{}", cases.len());
    for (name, bytes) in cases {
        let message = name.trim_end_matches(" system");
        let has_component = !matches!(
            message,
            "MANUAL_CONTROL" | "SET_MODE" | "CHANGE_OPERATOR_CONTROL" | "SET_GPS_GLOBAL_ORIGIN" | "SET_HOME_POSITION"
        );
        let expected = if has_component && message == name {
            MessageTarget::Component(Address::new(42, 84))
        } else {
            MessageTarget::System(SystemId(42))
        };
        let (id, target) = with_frame(&bytes, |frame| (frame.message_id, target_of(frame.message_id, frame.payload)));
        assert_eq!(message_id_named(message), Some(id), "{name}");
        assert_eq!(target, expected, "{name}");
    }
}

#[test]
fn a_broadcast_goes_to_all_others_and_to_the_other_peers_of_its_link() {
    let mut bench = Bench::new(Default::default()).introduced();
    let routed = bench.send(10, GCS_LINK, GCS, &HEARTBEAT);
    assert_eq!(
        routed.to,
        [(LinkId(0), Recipients::All), (LinkId(1), Recipients::All), (LinkId(2), Recipients::AllExcept(GCS_LINK.peer)),]
    );
}

#[test]
fn a_command_goes_to_its_targets_endpoint_and_the_reply_to_the_senders() {
    let mut bench = Bench::new(Default::default()).introduced();
    let routed = bench.send(10, GCS_LINK, GCS, &command_to(ROBOT));
    assert_eq!(routed.to, [to(BRICK_LINK)]);
    let ack = Message::CommandAck(CommandAck { command: 400, result: 0, target: Some(GCS) });
    let routed = bench.send(20, BRICK_LINK, ROBOT, &ack);
    assert_eq!(routed.to, [to(GCS_LINK)]);
}

#[test]
fn known_destinations_only() {
    for (target, expected) in [
        (Address::new(9, 9), vec![]),
        // A component that was not received, of a system that was.
        (Address::new(2, 7), vec![to(CAMERA_LINK)]),
        // The same, of the station's own system.
        (Address::new(1, 7), vec![]),
        // The station, and all components of its system.
        (STATION, vec![]),
        (Address::new(1, 0), vec![to(BRICK_LINK)]),
        // The sender of the request.
        (GCS, vec![]),
    ] {
        let mut bench = Bench::new(Default::default()).introduced();
        let routed = bench.send(10, GCS_LINK, GCS, &command_to(target));
        assert_eq!(routed.to, expected, "{target}");
    }
}

#[test]
fn a_route_is_forgotten_with_its_link_and_after_a_silence() {
    let mut bench = Bench::new(Default::default()).introduced();
    bench.router.forget_link(LinkId(0));
    assert_eq!(bench.send(10, GCS_LINK, GCS, &command_to(ROBOT)).to, []);
    let routed = bench.send(30_000, GCS_LINK, GCS, &command_to(CAMERA));
    assert_eq!(routed.to, [to(CAMERA_LINK)]);
    assert_eq!(bench.send(30_001, GCS_LINK, GCS, &command_to(CAMERA)).to, []);
}

#[test]
fn the_stations_own_frames_are_not_routed_and_add_no_route() {
    let mut bench = Bench::new(Default::default()).introduced();
    assert_eq!(bench.send(10, CAMERA_LINK, STATION, &HEARTBEAT).to, []);
    assert_eq!(bench.send(20, GCS_LINK, GCS, &command_to(STATION)).to, []);
}

#[test]
fn a_frame_of_another_station_is_no_echo() {
    let mut bench = Bench::new(Default::default()).introduced();
    let bytes = framed(77, STATION, &HEARTBEAT);
    bench.router.record_sent(&bytes);
    assert_eq!(bench.receive(10, GCS_LINK, &bytes).duplicate_status, DuplicateStatus::Echo);
    let other_station = Address::new(9, STATION.component.0);
    let routed = bench.send(20, GCS_LINK, other_station, &HEARTBEAT);
    assert_eq!((routed.duplicate_status, routed.to.len()), (DuplicateStatus::New, 3));
}

#[test]
fn a_copy_by_another_endpoint_is_a_duplicate_and_adds_no_route() {
    let mut bench = Bench::new(Default::default()).introduced();
    let bytes = framed(77, ROBOT, &HEARTBEAT);
    assert_eq!(bench.receive(10, BRICK_LINK, &bytes).duplicate_status, DuplicateStatus::New);
    let back = bench.receive(30, GCS_LINK, &bytes);
    assert_eq!(back.duplicate_status, DuplicateStatus::Loop);
    assert_eq!(back.to, []);
    let routed = bench.send(40, CAMERA_LINK, CAMERA, &command_to(ROBOT));
    assert_eq!(routed.to, [to(BRICK_LINK)], "the detour is no route");
    // A sender that never counts sends the same bytes again.
    let again = bench.receive(50, BRICK_LINK, &bytes);
    assert_eq!((again.duplicate_status, again.to.len()), (DuplicateStatus::New, 3));
}

#[test]
fn redundant_links_lead_to_one_robot() {
    let redundant = LinkRules { group: Some(3), ..LinkRules::default() };
    let mut bench = Bench::new([redundant.clone(), redundant, LinkRules::default()]);
    bench.send(0, GCS_LINK, GCS, &HEARTBEAT);
    let bytes = framed(9, ROBOT, &HEARTBEAT);
    let first = bench.receive(10, BRICK_LINK, &bytes);
    assert_eq!(first.to, [(LinkId(0), Recipients::AllExcept(PeerId(0))), (LinkId(2), Recipients::All)]);
    assert_eq!(bench.receive(20, CAMERA_LINK, &bytes).duplicate_status, DuplicateStatus::Duplicate);
    let routed = bench.send(30, GCS_LINK, GCS, &command_to(ROBOT));
    assert_eq!(routed.to, [to(BRICK_LINK), to(CAMERA_LINK)]);
    assert_eq!(bench.router.first_of_group(LinkId(1)), LinkId(0));
    assert_eq!(bench.router.first_of_group(LinkId(2)), LinkId(2));
    assert!(!bench.router.are_redundant(LinkId(1), LinkId(2)));
}

#[test]
fn a_link_forwards_all_or_only_targeted_frames_or_none() {
    let rules = |forward| LinkRules { forward, ..LinkRules::default() };
    let mut bench =
        Bench::new([rules(ForwardPolicy::Targeted), rules(ForwardPolicy::Disabled), rules(ForwardPolicy::All)])
            .introduced();
    let broadcast = bench.send(10, GCS_LINK, GCS, &HEARTBEAT);
    assert_eq!(broadcast.to, [(LinkId(2), Recipients::AllExcept(GCS_LINK.peer))]);
    let targeted = bench.send(20, GCS_LINK, GCS, &command_to(ROBOT));
    assert_eq!(targeted.to, [to(BRICK_LINK)]);
    assert_eq!(bench.send(30, GCS_LINK, GCS, &command_to(CAMERA)).to, []);
    assert_eq!(bench.send(40, CAMERA_LINK, CAMERA, &HEARTBEAT).to, []);
}

#[test]
fn commands_to_one_recipient_and_their_replies_outrank_telemetry() {
    for (message, expected) in [
        (command_to(ROBOT), Priority::Command),
        (command_to(Address::new(0, 0)), Priority::Forwarded),
        (HEARTBEAT, Priority::Forwarded),
    ] {
        let bytes = framed(0, GCS, &message);
        assert_eq!(with_frame(&bytes, priority_of), expected, "{message:?}");
    }
}
