//! A station between a brick, a camera and ground stations: who gets what, once.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]
#![expect(
    dead_code,
    reason = "the helpers are shared with tests of a single link, which need others of them"
)]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/network.rs"]
mod network;
#[path = "support/station.rs"]
mod station;

use std::collections::BTreeMap;

use brick::{BRICK, HEARTBEAT, ticks};
use network::{OnTheirWay, Speaker, passed_on};
use posebridge_pipeline::{OutputKind, PipelineConfig};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    CommandAck, CommandLong, Message, TimeSync, VisionFix, WireStamp,
};
use posebridge_protocol::routing::{Choice, Forward, LinkRules};
use posebridge_telemetry::{
    Address, Audience, Event, Heading, Input, LinkHealth, LinkId, LinkState, Meters, Output,
    PeerId, Priority, Span, SystemId,
};
use station::{LINK, STATION, Station, at, config, link, stream};

const CAMERA_LINK: LinkId = LinkId(4);
const GCS_LINK: LinkId = LinkId(5);
const CAMERA: Address = Address::new(2, 100);
const GCS: Address = Address::new(254, 190);
const OTHER_GCS: Address = Address::new(253, 190);

fn three_links() -> PipelineConfig {
    let mut config = config();
    config.links.push(link(CAMERA_LINK, vec![]));
    config.links.push(link(GCS_LINK, vec![]));
    config
}

/// A station that has heard a brick, a camera and two ground stations on one port.
struct Scene {
    station: Station,
    brick: Speaker,
    camera: Speaker,
    gcs: Speaker,
}

impl Scene {
    fn new(config: &PipelineConfig) -> Self {
        let mut scene = Self {
            station: Station::new(config),
            brick: Speaker::new(BRICK, LINK, 0),
            camera: Speaker::new(CAMERA, CAMERA_LINK, 0),
            gcs: Speaker::new(GCS, GCS_LINK, 5),
        };
        let station = &mut scene.station;
        scene.brick.say(station, at(10), &HEARTBEAT);
        scene.camera.say(station, at(11), &HEARTBEAT);
        scene.gcs.say(station, at(12), &HEARTBEAT);
        Speaker::new(OTHER_GCS, GCS_LINK, 6).say(station, at(13), &HEARTBEAT);
        scene
    }
}

fn command() -> Message {
    Message::Command(CommandLong {
        target: BRICK,
        command: 400,
        params: [1.0; 7],
    })
}

fn ack() -> Message {
    Message::CommandAck(CommandAck {
        command: 400,
        result: 0,
        target: Some(GCS),
    })
}

fn health(station: &mut Station, id: LinkId) -> LinkHealth {
    let until = station.outputs.last().map_or(at(0), |(now, _)| *now) + Span::from_millis(1_000);
    station.pass_until(until);
    let health = station.events().filter_map(|event| match event {
        Event::Health { link, health, .. } if *link == id => Some(*health),
        _ => None,
    });
    health.last().expect("a second has passed")
}

fn observed(station: &Station) -> usize {
    let is_observation = |event: &&Event| matches!(event, Event::Observed { .. });
    station.events().filter(is_observation).count()
}

#[test]
fn a_command_reaches_only_the_brick_and_its_answer_only_the_one_who_asked() {
    let mut scene = Scene::new(&three_links());
    let station = &mut scene.station;
    let (_, passed) = scene.gcs.say(station, at(100), &command());
    let to_brick = (LINK, Audience::Peer(PeerId(0)), Priority::Command);
    assert_eq!(passed, [to_brick]);
    let (_, passed) = scene.brick.say(station, at(130), &ack());
    let to_gcs = (GCS_LINK, Audience::Peer(PeerId(5)), Priority::Command);
    assert_eq!(passed, [to_gcs]);
    assert_eq!(health(station, GCS_LINK).forwarded, 3 + 1);
}

#[test]
fn telemetry_reaches_all_others_as_it_came() {
    let mut scene = Scene::new(&three_links());
    let station = &mut scene.station;
    let (_, passed) = scene.brick.say(station, at(100), &ticks(5_000, 0, 0));
    let all = |link| (link, Audience::All, Priority::Forwarded);
    assert_eq!(passed, [all(CAMERA_LINK), all(GCS_LINK)]);
    let (_, passed) = scene.gcs.say(station, at(110), &HEARTBEAT);
    let others = (GCS_LINK, Audience::AllBut(PeerId(5)), Priority::Forwarded);
    assert_eq!(passed, [all(LINK), all(CAMERA_LINK), others]);
    assert_eq!(observed(station), 1);
}

#[test]
fn a_message_of_no_dialect_is_passed_on_byte_for_byte_and_teaches_nothing() {
    let mut scene = Scene::new(&three_links());
    let station = &mut scene.station;
    // Id 60000 from 77/1, whose checksum only its author knows.
    let mut unknown = vec![0xFD, 5, 0, 0, 9, 77, 1, 0x60, 0xEA, 0x00];
    unknown.extend_from_slice(&[1, 0, 254, 0, 9, 0xAB, 0xCD]);
    // It is believed when a verified frame begins where it ends.
    let bytes = [unknown.clone(), scene.brick.frame(&HEARTBEAT)].concat();
    let seen = station.outputs.len();
    scene.brick.give(station, at(100), &bytes);
    let all = |link| (link, Audience::All, Priority::Forwarded);
    assert_eq!(
        passed_on(station, seen, &unknown),
        [all(CAMERA_LINK), all(GCS_LINK)]
    );
    let to_stranger = Message::Command(CommandLong {
        target: Address::new(77, 1),
        command: 400,
        params: [0.0; 7],
    });
    assert_eq!(scene.gcs.say(station, at(110), &to_stranger).1, []);
}

#[test]
fn what_the_station_says_is_not_passed_on_when_it_comes_back() {
    let mut scene = Scene::new(&three_links());
    let station = &mut scene.station;
    let own = Speaker::new(STATION, CAMERA_LINK, 0).frame(&HEARTBEAT);
    let seen = station.outputs.len();
    scene.camera.give(station, at(100), &own);
    assert_eq!(passed_on(station, seen, &own), []);
    let commanded = Message::Command(CommandLong {
        target: STATION,
        command: 400,
        params: [0.0; 7],
    });
    assert_eq!(scene.gcs.say(station, at(110), &commanded).1, []);
}

#[test]
fn a_link_that_is_down_gets_nothing_and_its_routes_are_forgotten() {
    let mut scene = Scene::new(&three_links());
    let station = &mut scene.station;
    station.link(at(50), LINK, LinkState::Down);
    let (_, passed) = scene.gcs.say(station, at(100), &HEARTBEAT);
    assert!(passed.iter().all(|(link, ..)| *link != LINK), "{passed:?}");
    assert_eq!(health(station, LINK).drops_out, 1);
    station.link(at(1_200), LINK, LinkState::Up);
    assert_eq!(scene.gcs.say(station, at(1_210), &command()).1, []);
    scene.brick.say(station, at(1_220), &HEARTBEAT);
    assert_eq!(scene.gcs.say(station, at(1_230), &command()).1.len(), 1);
}

#[test]
fn a_fix_that_goes_round_a_loop_is_fused_once_and_the_robot_is_heard_on_its_own_link() {
    let mut scene = Scene::new(&three_links());
    let station = &mut scene.station;
    for k in 0..60_u32 {
        let now = at(100 + i64::from(k) * 50);
        let frame = scene.brick.frame(&ticks(5_000 + k * 50, 0, 0));
        // Once the direct way is known, another station is quicker.
        if k > 0 {
            scene.gcs.give(station, now, &frame);
        }
        scene.brick.give(station, now, &frame);
        let frame = scene.camera.frame(&fix_at(u64::from(9_000 + k * 50)));
        scene.camera.give(station, now, &frame);
        scene.gcs.give(station, now + Span::from_millis(10), &frame);
    }
    let used = |source: Address| {
        let events = station.events();
        let used = events
            .filter(|event| matches!(event, Event::Observed { source: s, .. } if *s == source));
        used.count()
    };
    assert_eq!(used(BRICK), 60);
    // Each fix is used, or told to come before its clock is known; but once.
    let is_defect = |event: &&Event| matches!(event, Event::Defect { .. });
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
    })
}

/// One of two stations in a ring, and a link of it.
type End = (usize, LinkId);

/// Two stations joined by two links of unequal delay; the first has a brick, the second a listener.
struct Ring {
    stations: [Station; 2],
    on_their_way: OnTheirWay<End>,
    seen: [usize; 2],
    /// How often each frame crossed between the stations, and how often it reached the listener.
    crossings: BTreeMap<Vec<u8>, u32>,
    listened: BTreeMap<Vec<u8>, u32>,
    frames: u64,
}

const NEAR: LinkId = LinkId(1);
const FAR: LinkId = LinkId(2);

impl Ring {
    fn new() -> Self {
        let station = |system| {
            let mut config = config();
            config.own = Address::new(system, 197);
            config.links[0].id = LinkId(0);
            let pose = || vec![stream(OutputKind::PlanarPose, 100)];
            config.links.push(link(NEAR, pose()));
            config.links.push(link(FAR, pose()));
            Station::new(&config)
        };
        Self {
            stations: [station(1), station(2)],
            on_their_way: OnTheirWay::default(),
            seen: [0, 0],
            crossings: BTreeMap::new(),
            listened: BTreeMap::new(),
            frames: 0,
        }
    }

    /// One millisecond.
    fn step(&mut self, now: i64) {
        while let Some(((index, link), bytes)) = self.on_their_way.take_due(at(now)) {
            let peer = PeerId::default();
            self.stations[index].give(at(now), Input::Bytes { link, peer, bytes });
        }
        for index in 0..2 {
            self.stations[index].pass_until(at(now));
            let station = &self.stations[index];
            for (_, output) in &station.outputs[self.seen[index]..] {
                let Output::Transmit {
                    link, bytes, to, ..
                } = output
                else {
                    continue;
                };
                let delay = match *link {
                    NEAR => 3,
                    FAR => 40,
                    _ => {
                        *self.listened.entry(bytes.clone()).or_default() += 1;
                        continue;
                    }
                };
                if to.includes(PeerId::default()) {
                    self.frames += 1;
                    *self.crossings.entry(bytes.clone()).or_default() += 1;
                    let end = (1 - index, *link);
                    self.on_their_way.send(at(now + delay), end, bytes.clone());
                }
            }
            self.seen[index] = station.outputs.len();
        }
    }
}

#[test]
fn two_stations_joined_by_two_links_do_not_let_frames_circle() {
    let mut ring = Ring::new();
    let mut brick = Speaker::new(Address::new(3, 1), LinkId(0), 0);
    let mut said = Vec::new();
    let mut per_minute = Vec::new();
    for minute in 0..3_i64 {
        let before = ring.frames;
        for k in 0..60_000 {
            let now = minute * 60_000 + k;
            if now % 50 == 0 {
                let stamp = u32::try_from(now).expect("three minutes");
                let frame = brick.frame(&ticks(5_000 + stamp, 0, 0));
                brick.give(&mut ring.stations[0], at(now), &frame);
                said.push(frame);
            }
            ring.step(now);
        }
        per_minute.push(ring.frames - before);
    }
    for frame in &said[..said.len() - 2] {
        assert_eq!(
            ring.listened.get(frame),
            Some(&1),
            "reaches the listener once"
        );
        // Out by both links, and back by the slower one from the station that had it by the quicker one.
        assert_eq!(ring.crossings.get(frame), Some(&3));
    }
    println!("frames between the stations per minute: {per_minute:?}");
    // Whatever it is, it crosses no more often. Messages without stamp may repeat byte for byte when the counter has wrapped.
    let unstamped = [ids::HEARTBEAT, ids::COMMAND_LONG, ids::COMMAND_ACK];
    for (frame, count) in &ring.crossings {
        let id = u32::from_le_bytes([frame[7], frame[8], frame[9], 0]);
        assert!(
            *count <= 3 || unstamped.contains(&id),
            "message {id}: {count}"
        );
    }
    assert!(per_minute[2].abs_diff(per_minute[1]) < 20, "{per_minute:?}");
}

/// A brick that says everything on two links, which delay and lose for themselves, and answers time requests on each.
struct Redundant {
    station: Station,
    speakers: [Speaker; 2],
    on_their_way: OnTheirWay<usize>,
    seen: usize,
    /// Which messages came over which link, by their stamps in ms of brick time.
    arrived: [Vec<u32>; 2],
}

const LINKS: [LinkId; 2] = [LinkId(6), LinkId(7)];
const DELAYS_MS: [i64; 2] = [5, 45];
/// Brick time minus host time.
const AHEAD_MS: i64 = 5_000;

impl Redundant {
    fn new() -> Self {
        let mut config = config();
        config.links = LINKS
            .map(|id| {
                let mut link = link(id, vec![stream(OutputKind::PlanarPose, 0)]);
                link.rules.group = Some(0);
                link
            })
            .to_vec();
        Self {
            station: Station::new(&config),
            speakers: LINKS.map(|id| Speaker::new(BRICK, id, 0)),
            on_their_way: OnTheirWay::default(),
            seen: 0,
            arrived: [vec![], vec![]],
        }
    }

    fn send(&mut self, now: i64, index: usize, message: &Message) {
        let frame = self.speakers[index].frame(message);
        let arrival = at(now + DELAYS_MS[index]);
        self.on_their_way.send(arrival, index, frame);
    }

    /// One millisecond; telemetry each 50 ms, of which `loses` decides what never arrives.
    fn step(&mut self, now: i64, is_up: [bool; 2], loses: impl Fn(usize) -> bool) {
        let brick_ms = u32::try_from(now + AHEAD_MS).expect("a short run");
        for index in 0..2 {
            if now % 1_000 == 0 && is_up[index] {
                self.send(now, index, &HEARTBEAT);
            }
            if now % 50 == 0 {
                let counts = now / 50;
                let message = ticks(brick_ms, counts, counts);
                let frame = self.speakers[index].frame(&message);
                if is_up[index] && !loses(index) {
                    self.on_their_way
                        .send(at(now + DELAYS_MS[index]), index, frame);
                    self.arrived[index].push(brick_ms);
                }
            }
        }
        while let Some((index, bytes)) = self.on_their_way.take_due(at(now)) {
            self.speakers[index].give(&mut self.station, at(now), &bytes);
        }
        self.station.pass_until(at(now));
        self.answer(now, is_up);
    }

    fn answer(&mut self, now: i64, is_up: [bool; 2]) {
        let mut requests = Vec::new();
        for (_, output) in &self.station.outputs[self.seen..] {
            let Output::Transmit { link, bytes, .. } = output else {
                continue;
            };
            let index = usize::from(link.0 - LINKS[0].0);
            for message in brick::messages(bytes) {
                if let (Message::TimeSync(sync), true) = (message, is_up[index])
                    && sync.answer_nanos == 0
                {
                    requests.push((index, sync.request_nanos));
                }
            }
        }
        self.seen = self.station.outputs.len();
        for (index, request_nanos) in requests {
            let heard = now + DELAYS_MS[index];
            let answer = Message::TimeSync(TimeSync {
                answer_nanos: (heard + AHEAD_MS) * 1_000_000,
                request_nanos,
                target: Some(STATION),
            });
            self.send(heard, index, &answer);
        }
    }

    /// Brick times in ms of which an observation spoke, in the order in which they were used.
    fn observed(&self) -> Vec<u32> {
        let stamps = self.station.events().filter_map(|event| match event {
            Event::Observed {
                robot, observation, ..
            } => {
                assert_eq!((robot.link, robot.address), (LINKS[0], BRICK));
                u32::try_from(observation.stamp.as_nanos() / 1_000_000).ok()
            }
            _ => None,
        });
        stamps.collect()
    }
}

fn sorted(mut stamps: Vec<u32>) -> Vec<u32> {
    stamps.sort_unstable();
    stamps
}

#[test]
fn two_links_to_one_robot_lose_only_what_both_lose_and_use_nothing_twice() {
    let mut run = Redundant::new();
    for now in 0..20_000 {
        let slot = now / 50;
        // Each loses a fifth, at other times, and now and then both.
        run.step(now, [true; 2], |index| match index {
            0 => slot % 5 == 0,
            _ => slot % 5 == 1 || slot % 20 == 0,
        });
    }
    let [first, second] = run.arrived.clone();
    let mut either: Vec<u32> = [first.clone(), second.clone()].concat();
    either.sort_unstable();
    either.dedup();
    // The last one may still be on its way.
    let observed = sorted(run.observed());
    assert_eq!(observed, either[..observed.len()]);
    assert!(either.len() - observed.len() <= 1 && either.len() == 380);
    let both = first.iter().filter(|stamp| second.contains(stamp)).count() as u64;
    let counted: u64 = LINKS
        .map(|id| health(&mut run.station, id).duplicates)
        .iter()
        .sum();
    assert!(both.abs_diff(counted) <= 1, "{both} {counted}");
}

#[test]
fn when_one_of_two_links_goes_down_only_what_was_on_its_way_is_lost() {
    let mut run = Redundant::new();
    for now in 0..12_000 {
        let is_up = match now {
            0..4_000 => [true, true],
            4_000..7_980 => [false, true],
            _ => [true, false],
        };
        match now {
            4_000 => {
                run.station.link(at(now), LINKS[0], LinkState::Down);
                run.on_their_way.lose(|index| *index == 0);
            }
            7_980 => {
                run.station.link(at(now), LINKS[1], LinkState::Down);
                run.on_their_way.lose(|index| *index == 1);
                run.station.link(at(now), LINKS[0], LinkState::Up);
            }
            _ => {}
        }
        run.step(now, is_up, |_| false);
    }
    let observed = sorted(run.observed());
    let all: Vec<u32> = (0..240).map(|k| 5_000 + k * 50).collect();
    let missing: Vec<&u32> = all
        .iter()
        .filter(|stamp| !observed.contains(stamp))
        .collect();
    // One message of brick time 12950 was on the slow link alone when that went down.
    assert_eq!(missing, [&12_950]);
    assert!(observed.windows(2).all(|pair| pair[0] < pair[1]));
}

#[test]
fn both_links_bound_the_one_clock_and_both_carry_the_estimate() {
    let mut run = Redundant::new();
    for now in 0..20_000 {
        run.step(now, [true; 2], |_| false);
    }
    let aligned: Vec<(Span, Span)> = run
        .station
        .events()
        .filter_map(|event| match event {
            Event::BrickClockAligned {
                robot,
                offset,
                uncertainty,
                ..
            } => {
                assert_eq!(robot.link, LINKS[0]);
                Some((*offset, *uncertainty))
            }
            _ => None,
        })
        .collect();
    let (offset, uncertainty) = aligned.last().copied().expect("it answers");
    let error_ms = offset.as_millis_f64() - AHEAD_MS as f64;
    println!(
        "{} alignments, {error_ms:+.3} ms, ± {:.3} ms",
        aligned.len(),
        uncertainty.as_millis_f64()
    );
    assert!(error_ms.abs() <= uncertainty.as_millis_f64() + 0.001);
    // The bounds of the quicker link: half a round trip of 10 ms, and the step of the counter.
    assert!(uncertainty.as_millis_f64() < 10.0);
    // Twice as many as one link gives, which asks each half second after ten quick ones.
    assert!(aligned.len() > 60, "{}", aligned.len());
    let poses = LINKS.map(|id| {
        let sent = run.station.outputs.iter().filter(|(_, output)| {
            matches!(output, Output::Transmit { link, priority: Priority::Estimate { .. }, .. }
                if *link == id)
        });
        sent.count()
    });
    assert_eq!(poses[0], poses[1]);
    assert!(poses[0] > 390, "{poses:?}");
    for id in LINKS {
        let health = health(&mut run.station, id);
        assert!(health.clock_uncertainty.is_some() && health.round_trip.is_some());
        assert_eq!(health.forwarded, 0, "redundant links are not joined");
    }
}

#[test]
fn what_a_filter_keeps_out_is_neither_believed_nor_passed_on() {
    let mut config = three_links();
    config.links[0].rules.inward.messages = Choice {
        allow: vec![],
        block: vec![ids::PB_WHEEL_TICKS],
    };
    config.links[2].rules.outward.systems = Choice {
        allow: vec![SystemId(2)],
        block: vec![],
    };
    let mut scene = Scene::new(&config);
    let station = &mut scene.station;
    let (_, passed) = scene.brick.say(station, at(100), &ticks(5_000, 0, 0));
    assert_eq!((passed, observed(station)), (vec![], 0));
    let (_, passed) = scene.brick.say(station, at(110), &HEARTBEAT);
    assert_eq!(passed.len(), 1, "the camera's link only: {passed:?}");
    let (_, passed) = scene.camera.say(station, at(120), &HEARTBEAT);
    assert_eq!(passed.len(), 2);
    assert_eq!(health(station, LINK).filtered, 1);
}

#[test]
fn a_link_may_take_only_what_is_meant_for_it() {
    let mut config = three_links();
    config.links[0].rules.forward = Forward::Targeted;
    config.links[1].rules.forward = Forward::Nothing;
    let mut scene = Scene::new(&config);
    let station = &mut scene.station;
    let (_, passed) = scene.gcs.say(station, at(100), &HEARTBEAT);
    assert_eq!(
        passed,
        [(GCS_LINK, Audience::AllBut(PeerId(5)), Priority::Forwarded)]
    );
    assert_eq!(scene.gcs.say(station, at(110), &command()).1.len(), 1);
    assert_eq!(scene.camera.say(station, at(120), &HEARTBEAT).1, []);
}

#[test]
fn rates_thin_telemetry_and_estimates_but_never_commands() {
    let mut config = three_links();
    let thin = |rules: &mut LinkRules| {
        rules.limits.bytes_per_s = Some(200);
        let interval = Span::from_millis(200);
        rules.limits.least_intervals = BTreeMap::from([(ids::PB_WHEEL_TICKS, interval)]);
    };
    // Estimates of 64 bytes each leave to the brick, ticks of 25 bytes to the ground station.
    thin(&mut config.links[0].rules);
    thin(&mut config.links[2].rules);
    let mut scene = Scene::new(&config);
    let mut ticks_passed = 0;
    for k in 0..200_u32 {
        let station = &mut scene.station;
        let now = at(100 + i64::from(k) * 50);
        let message = ticks(5_000 + k * 50, 0, 0);
        let (_, passed) = scene.brick.say(station, now, &message);
        ticks_passed += passed.iter().filter(|(link, ..)| *link == GCS_LINK).count();
        if k % 10 == 0 {
            let (_, passed) = scene.gcs.say(station, now, &command());
            assert_eq!(passed.len(), 1, "commands pass");
        }
    }
    assert_eq!(ticks_passed, 50, "one of four, for ten seconds");
    let station = &mut scene.station;
    let estimates = station.outputs.iter().filter(|(_, output)| {
        matches!(
            output,
            Output::Transmit {
                link: LINK,
                priority: Priority::Estimate { .. },
                ..
            }
        )
    });
    let estimates = estimates.count();
    // 200 B/s for ten seconds, of which twenty commands of 45 bytes have taken their part; one bucket more at the start.
    assert!((15..=25).contains(&estimates), "{estimates}");
    let (brick, gcs) = (health(station, LINK), health(station, GCS_LINK));
    assert_eq!(brick.thinned + estimates as u64, 200);
    assert_eq!(gcs.thinned, 150);
}

#[test]
fn the_same_inputs_give_the_same_outputs_with_many_links_too() {
    let mut run = Redundant::new();
    for now in 0..5_000 {
        run.step(now, [true; 2], |index| now % 3 == index as i64);
    }
    let fresh = Redundant::new().station;
    let mut again = Station {
        pipeline: fresh.pipeline,
        inputs: vec![],
        outputs: fresh.outputs,
    };
    // The first inputs are those that brought the links up.
    for (now, input) in &run.station.inputs[LINKS.len()..] {
        again.give(*now, input.clone());
    }
    assert!(run.station.outputs.len() > 500);
    assert!(format!("{:?}", run.station.outputs) == format!("{:?}", again.outputs));
}
