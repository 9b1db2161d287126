//! Strangers on an open port, who use the ids of a robot or its camera or invent some: what a robot that drives and is seen by a camera
//! loses to them. It is driven twice, with and without the stranger.

use std::net::Ipv4Addr;

use crate::support::network::RemotePeer;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, ticks, vision_fix};
use posebridge_protocol::framing::TransportKind;
use posebridge_protocol::message::{Message, TimeSync, VisionFix, WireStamp};
use posebridge_station::{PinPolicy, StationConfig};
use posebridge_telemetry::{
    Address, Estimate, Event, FusionOutcome, Input, LinkState, Meters, PeerId, RobotId, SensorId, TimeDelta,
};

const CAMERA: Address = Address::new(1, 100);
/// What the camera's clock shows at host zero, and the stranger's.
const CAMERA_AHEAD_MS: i64 = 500_000;
const STRANGER_AHEAD_MS: i64 = 9_000_000;
const PERIOD_MS: i64 = 50;
const FIX_EVERY: i64 = 4;
/// When the stranger begins, and the end of the drive.
const BEGINS_AT_MS: i64 = 3_000;
const ENDS_AT_MS: i64 = 15_000;

/// A robot that drives straight on at 0.2 m/s, a camera that sees it five times a second, and a stranger, each at a peer of its own.
struct Scene {
    station: TestStation,
    robot: RemotePeer,
    camera: RemotePeer,
    stranger: RemotePeer,
    now_ms: i64,
    answered: usize,
}

/// What the stranger does in each period.
type Attack<'a> = &'a dyn Fn(&mut Scene);

fn true_x_m(now_ms: i64) -> f64 {
    0.2e-3 * now_ms as f64
}

fn open_port() -> StationConfig {
    let mut config = config();
    config.links[0].framing = TransportKind::Datagram;
    config
}

impl Scene {
    fn new(config: &StationConfig, stranger: Address) -> Self {
        Self {
            station: TestStation::new(config),
            robot: RemotePeer::new(BRICK, LINK, 0),
            camera: RemotePeer::new(CAMERA, LINK, 1),
            stranger: RemotePeer::new(stranger, LINK, 9),
            now_ms: 0,
            answered: 0,
        }
    }

    /// Drives until the end; the stranger attacks from [`BEGINS_AT_MS`] on.
    fn drive(mut self, attack: Option<Attack<'_>>) -> Self {
        self.robot.send(&mut self.station, at(1), &HEARTBEAT);
        while self.now_ms < ENDS_AT_MS {
            self.now_ms += PERIOD_MS;
            self.station.pass_until(at(self.now_ms));
            self.answer_time_requests();
            if let Some(attack) = attack.filter(|_| self.now_ms >= BEGINS_AT_MS) {
                attack(&mut self);
            }
            let counts = self.now_ms * 360 / 880;
            let wheels = ticks(self.now_ms as u32, counts, counts);
            self.robot.send(&mut self.station, at(self.now_ms + 5), &wheels);
            if (self.now_ms / PERIOD_MS) % FIX_EVERY == 0 {
                let fix = vision_fix(self.now_ms + CAMERA_AHEAD_MS, true_x_m(self.now_ms));
                self.camera.send(&mut self.station, at(self.now_ms + 20), &Message::VisionPosition(fix));
            }
        }
        self
    }

    /// Robot and camera answer a millisecond after the request.
    fn answer_time_requests(&mut self) {
        let requests = self.station.time_requests(self.answered);
        self.answered = self.station.outputs.len();
        for request in requests {
            let answered = request.sent + TimeDelta::from_millis(1);
            for (peer, ahead_ms) in [(&mut self.robot, 0), (&mut self.camera, CAMERA_AHEAD_MS)] {
                let answer_nanos = answered.as_nanos() + ahead_ms * 1_000_000;
                let answer = TimeSync { answer_nanos, request_nanos: request.nanos, target: None };
                peer.send(&mut self.station, answered + TimeDelta::from_millis(1), &Message::TimeSync(answer));
            }
        }
    }

    /// The stranger sends a message now.
    fn strange(&mut self, message: &Message) {
        self.stranger.send(&mut self.station, at(self.now_ms + 2), message);
    }

    /// A fix by the stranger's clock, far from where the robot is.
    fn strange_fix(&self, reset_counter: u8) -> VisionFix {
        VisionFix { y: Meters(60.0), reset_counter, ..vision_fix(self.now_ms + STRANGER_AHEAD_MS, 50.0) }
    }

    /// The estimates of the first robot.
    fn estimates(&self) -> Vec<Estimate> {
        let own = RobotId { link: LINK, address: BRICK };
        self.station.select(|event| match event {
            Event::EstimateUpdated { robot, estimate } if *robot == own => Some(*estimate),
            _ => None,
        })
    }
}

/// Asserts that a stranger with these ids costs the robot no estimate and moves none.
fn assert_harmless(config: &StationConfig, stranger: Address, attack: Attack<'_>) -> Scene {
    let undisturbed = Scene::new(config, stranger).drive(None);
    let attacked = Scene::new(config, stranger).drive(Some(attack));
    let (expected, estimates) = (undisturbed.estimates(), attacked.estimates());
    assert!(expected.len() as i64 > ENDS_AT_MS / PERIOD_MS, "{}", expected.len());
    for (one, other) in expected.iter().zip(&estimates) {
        let moved_m = one.pose.origin().distance(other.pose.origin()).0;
        assert!(moved_m < 1e-3, "{moved_m} m at {:?}\n{:#?}", one.stamp, attacked.station.texts());
        assert_eq!((one.stamp, one.reset_counter), (other.stamp, other.reset_counter));
    }
    assert_eq!(estimates.len(), expected.len());
    attacked
}

#[test]
fn a_reset_counter_with_the_ids_of_the_camera_moves_no_estimate() {
    assert_harmless(&open_port(), CAMERA, &|scene| {
        let fix = scene.strange_fix((scene.now_ms / 500) as u8);
        scene.strange(&Message::VisionPosition(fix));
    });
}

#[test]
fn a_reset_counter_with_the_ids_of_the_robot_moves_no_estimate() {
    assert_harmless(&open_port(), BRICK, &|scene| {
        let fix = scene.strange_fix((scene.now_ms / 500) as u8);
        scene.strange(&Message::VisionPosition(fix));
    });
}

#[test]
fn a_reset_counter_with_invented_ids_moves_no_estimate() {
    assert_harmless(&open_port(), Address::new(7, 7), &|scene| {
        let fix = scene.strange_fix((scene.now_ms / 500) as u8);
        scene.strange(&Message::VisionPosition(fix));
    });
}

#[test]
fn steady_fixes_of_another_place_move_no_estimate_while_a_camera_sees_the_robot() {
    assert_harmless(&open_port(), Address::new(7, 7), &|scene| {
        for _ in 0..4 {
            let fix = scene.strange_fix(0);
            scene.strange(&Message::VisionPosition(fix));
        }
    });
}

#[test]
fn a_heartbeat_and_a_system_time_with_the_ids_of_the_robot_restart_no_clock() {
    assert_harmless(&open_port(), BRICK, &|scene| {
        scene.strange(&HEARTBEAT);
        let since_boot = WireStamp::Millis32((scene.now_ms % 1_000) as u32);
        scene.strange(&Message::SystemTime { unix_micros: 0, since_boot });
    });
}

#[test]
fn answers_to_time_requests_with_the_ids_of_robot_or_camera_move_no_clock() {
    for ids in [BRICK, CAMERA] {
        assert_harmless(&open_port(), ids, &|scene| {
            let requests = scene.station.time_requests(0);
            let newest = requests.last().expect("the station asks");
            let answer_nanos = newest.sent.as_nanos() + STRANGER_AHEAD_MS * 1_000_000;
            let answer = TimeSync { answer_nanos, request_nanos: newest.nanos, target: None };
            scene.strange(&Message::TimeSync(answer));
        });
    }
}

#[test]
fn wheel_counts_with_the_ids_of_the_robot_move_no_estimate_and_the_second_robot_is_announced() {
    let attacked = assert_harmless(&open_port(), BRICK, &|scene| {
        let wild = scene.now_ms * 7_919 % 100_000;
        scene.strange(&ticks((scene.now_ms + 700) as u32, wild, -wild));
    });
    assert_eq!(attacked.station.engine.robots().len(), 2);
    let texts = attacked.station.texts();
    assert!(texts.iter().any(|text| text.contains("is taken: it is announced as")), "{texts:?}");
}

#[test]
fn a_stranger_who_invents_a_robot_in_each_frame_costs_the_first_nothing() {
    assert_harmless(&open_port(), BRICK, &|scene| {
        for number in 0..20 {
            let invented = Address::new((scene.now_ms / PERIOD_MS % 250) as u8, number);
            scene.stranger = RemotePeer::new(invented, LINK, 9);
            scene.strange(&ticks(scene.now_ms as u32, 1_000, 0));
        }
    });
}

#[test]
fn a_thousand_peers_of_one_byte_cost_the_robot_nothing() {
    assert_harmless(&open_port(), BRICK, &|scene| {
        for peer in 0..20 {
            let number = 1_000 + (scene.now_ms / PERIOD_MS * 20 + peer) as u32;
            RemotePeer::new(BRICK, LINK, number).send_bytes(&mut scene.station, at(scene.now_ms + 2), &[0xFD]);
        }
    });
}

#[test]
fn a_second_camera_that_agrees_is_used_and_one_that_stops_agreeing_is_not() {
    let drive = |off_m: fn(i64) -> f64| {
        Scene::new(&open_port(), Address::new(7, 7)).drive(Some(&|scene: &mut Scene| {
            let x_m = true_x_m(scene.now_ms) + off_m(scene.now_ms);
            let fix = vision_fix(scene.now_ms + STRANGER_AHEAD_MS, x_m);
            scene.strange(&Message::VisionPosition(fix));
        }))
    };
    let count = |scene: &Scene, outcome: FusionOutcome| {
        scene.station.count(|event| {
            matches!(event, Event::ObservationFused { record, .. }
                if record.sensor == SensorId::camera(1) && record.outcome == outcome)
        })
    };
    let honest = drive(|_| 0.0);
    // Two of them come before the first wheel counts of their instant.
    assert!(count(&honest, FusionOutcome::Unused) <= 6 && count(&honest, FusionOutcome::Accepted) > 200);
    let liar = drive(|now_ms| if now_ms < 8_000 { 0.0 } else { 30.0 });
    assert!(count(&liar, FusionOutcome::Gated) <= 3, "{}", count(&liar, FusionOutcome::Gated));
    assert!(count(&liar, FusionOutcome::Unused) > 100);
    let named = liar.station.texts().iter().filter(|text| text.contains("not used until it agrees")).count();
    assert_eq!(named, 1);
    let off_m = liar.estimates().last().map(|estimate| (estimate.pose.x.0 - true_x_m(ENDS_AT_MS)).abs());
    assert!(off_m.is_some_and(|off_m| off_m < 0.02), "{off_m:?}");
}

fn pinned(policy: PinPolicy) -> StationConfig {
    let mut config = open_port();
    config.links[0].pin = Some(policy);
    config
}

/// Counts that the robot never had, while it is silent.
fn take_over(scene: &mut Scene) {
    scene.strange(&ticks(scene.now_ms as u32 + 3, 5_000, 5_000));
}

#[test]
fn a_pinned_robot_that_is_silent_for_a_second_is_not_taken_over() {
    for policy in [PinPolicy::First, PinPolicy::Address] {
        let mut scene = Scene::new(&pinned(policy), BRICK).drive(None);
        let before = scene.estimates().len();
        for _ in 0..20 {
            scene.now_ms += PERIOD_MS;
            take_over(&mut scene);
        }
        assert_eq!(scene.estimates().len(), before, "{policy:?}");
        let counts = scene.now_ms * 360 / 880;
        scene.robot.send(&mut scene.station, at(scene.now_ms + 5), &ticks(scene.now_ms as u32, counts, counts));
        assert_eq!(scene.estimates().len(), before + 1, "{policy:?}");
        assert_eq!(scene.station.engine.robots().len(), 1);
        let refused = scene.station.texts().iter().filter(|text| text.ends_with("is refused (pin)")).count();
        assert_eq!(refused, 1, "{policy:?}");
        assert_eq!(scene.station.later_health(LINK).rejected_frames, 20);
    }
}

#[test]
fn a_pinned_address_lets_its_robot_come_back_from_another_port_and_no_other_host() {
    for (policy, host, is_admitted) in
        [(PinPolicy::Address, 7, true), (PinPolicy::Address, 8, false), (PinPolicy::First, 7, false)]
    {
        let mut scene = Scene::new(&pinned(policy), BRICK);
        for (peer, last) in [(0, 7), (9, host)] {
            let host = Ipv4Addr::new(192, 168, 4, last).into();
            scene.station.handle(at(0), Input::PeerAddress { link: LINK, peer: PeerId(peer), host });
        }
        let mut scene = scene.drive(None);
        let before = scene.estimates().len();
        for _ in 0..20 {
            scene.now_ms += PERIOD_MS;
            take_over(&mut scene);
        }
        assert_eq!(scene.estimates().len() > before, is_admitted, "{policy:?} {host}");
        let names_both =
            scene.station.texts().iter().any(|text| text.contains("1/1 is 192.168.4.7: what 192.168.4.8 sends"));
        assert_eq!(names_both, host == 8);
    }
}

#[test]
fn a_pinned_robot_has_one_camera_even_if_another_follows_the_estimate() {
    let attack: Attack<'_> = &|scene| {
        let off_m = if scene.now_ms < 8_000 { 0.0 } else { 0.02 };
        let fix = vision_fix(scene.now_ms + STRANGER_AHEAD_MS, true_x_m(scene.now_ms) + off_m);
        scene.strange(&Message::VisionPosition(fix));
    };
    assert_harmless(&pinned(PinPolicy::First), Address::new(7, 7), attack);
}

#[test]
fn with_a_pinned_key_nothing_unsigned_speaks_for_a_robot() {
    // No frame of this scene is signed, so that all of them are a stranger's.
    let mut scene = Scene::new(&pinned(PinPolicy::Key), BRICK).drive(None);
    assert_eq!(scene.estimates().len(), 0);
    assert!(scene.station.later_health(LINK).rejected_frames > 300);
}

#[test]
fn after_the_link_was_lost_a_pin_goes_by_the_address_and_by_no_old_number_of_a_peer() {
    for (policy, host, is_admitted) in
        [(PinPolicy::Address, 7, true), (PinPolicy::Address, 8, false), (PinPolicy::First, 8, true)]
    {
        let mut scene = Scene::new(&pinned(policy), BRICK);
        let connect = |scene: &mut Scene, last: u8| {
            let host = Ipv4Addr::new(192, 168, 4, last).into();
            let now = at(scene.now_ms);
            scene.station.handle(now, Input::PeerAddress { link: LINK, peer: PeerId(0), host });
        };
        connect(&mut scene, 7);
        let mut scene = scene.drive(None);
        for state in [LinkState::Down, LinkState::Up] {
            scene.station.link(at(scene.now_ms), LINK, state);
        }
        connect(&mut scene, host);
        let before = scene.estimates().len();
        scene.now_ms += PERIOD_MS;
        let counts = scene.now_ms * 360 / 880;
        scene.robot.send(&mut scene.station, at(scene.now_ms + 5), &ticks(scene.now_ms as u32, counts, counts));
        assert_eq!(scene.estimates().len() > before, is_admitted, "{policy:?} {host}");
    }
}
