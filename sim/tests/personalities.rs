//! The LEGO bricks as a station meets them: over bytes, with the camera on a link of its own.
#![expect(clippy::unwrap_used, reason = "test code stops at the first surprise")]

use posebridge_protocol::dialect::{self, Encoder, ids};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Message, SetMessageInterval};
use posebridge_sim::scenario::{BrickProgram, Personality};
use posebridge_sim::{CAMERA, Scenario, Simulation, Steering};
use posebridge_telemetry::{Address, TimeDelta, Timestamp};
use proptest::prelude::*;

const LEGO: [Personality; 3] = [Personality::Nxt, Personality::NxtPush, Personality::Ev3];
/// The square takes half a minute.
const LONGEST_LAP: TimeDelta = TimeDelta::from_millis(60_000);
/// GETBATTERYLEVEL of the NXT, TIMER_READ_US of the EV3.
const BATTERY: [u8; 4] = [2, 0, 0x00, 0x0B];
const CLOCK: [u8; 9] = [7, 0, 1, 0, 0, 4, 0, 0x8F, 0x60];
/// MESSAGEWRITE to inbox 0: tick 6000 ms, 1.5 m, -0.5 m, 0.25 rad, flags 3.
const ESTIMATE: [u8; 31] = [
    29, 0, 0x80, 0x09, 0, 25, 0x70, 0x17, 0, 0, 0, 0, 0xC0, 0x3F, 0, 0, 0, 0xBF, 0, 0, 0x80, 0x3E, 0, 0, 0, 0x3C, 3, 0,
    1, 0, 0,
];

fn world(personality: Personality, program: BrickProgram) -> Simulation {
    let mut scenario = Scenario::default().with_personality(personality);
    scenario.brick.program = program;
    Simulation::new(scenario)
}

/// What both links carry within `millis`: of the brick in pieces as they come, of the camera as a whole.
fn listen(simulation: &mut Simulation, millis: usize) -> (Vec<Vec<u8>>, Vec<u8>) {
    let (mut brick, mut camera) = (Vec::new(), Vec::new());
    for _ in 0..millis {
        simulation.step();
        brick.extend(std::iter::from_fn(|| simulation.poll()));
        camera.extend(std::iter::from_fn(|| simulation.poll_camera()).flatten());
    }
    (brick, camera)
}

/// The messages in these bytes; nothing may be left over.
fn messages(bytes: &[u8]) -> Vec<(Address, Message)> {
    let mut framer = Framer::new(FramerConfig::default());
    let mut found = Vec::new();
    framer.push(Timestamp::ZERO, bytes, &mut |scanned| match scanned {
        FramerOutput::Frame(frame) => {
            found.push((frame.source, dialect::decode(&frame).unwrap().unwrap()));
        }
        other @ (FramerOutput::UnknownFrame(_) | FramerOutput::Error(_)) => panic!("{other:?}"),
    });
    found
}

#[test]
fn an_nxt_and_an_ev3_never_speak_first() {
    for personality in [Personality::Nxt, Personality::Ev3] {
        let (brick, _) = listen(&mut world(personality, BrickProgram::Path), 3_000);
        assert!(brick.is_empty(), "{personality:?}");
    }
}

#[test]
fn the_camera_of_a_lego_brick_has_a_link_of_its_own() {
    for personality in LEGO {
        let mut simulation = world(personality, BrickProgram::Path);
        let (_, camera) = listen(&mut simulation, 3_000);
        let heard = messages(&camera);
        assert!(heard.iter().all(|(from, _)| *from == CAMERA));
        let fixes = |heard: &[(Address, Message)]| {
            let is_fix = |(_, message): &&(Address, Message)| matches!(message, Message::VisionPosition(_));
            heard.iter().filter(is_fix).count()
        };
        assert!((25..=30).contains(&fixes(&heard)), "{personality:?}");

        let mut bytes = Vec::new();
        let wish = Message::SetMessageInterval(SetMessageInterval {
            target: CAMERA,
            message_id: ids::VISION_POSITION_ESTIMATE,
            interval: Some(TimeDelta::from_millis(500)),
        });
        Encoder::new(WireVersion::V2).encode(Address::new(255, 190), &wish, &mut bytes);
        simulation.receive_camera(&bytes);
        let (_, camera) = listen(&mut simulation, 3_000);
        assert!((5..=8).contains(&fixes(&messages(&camera))), "{personality:?}");
    }
}

#[test]
fn a_mavlink_brick_shares_its_link_with_the_camera() {
    let (brick, camera) = listen(&mut world(Personality::Mavlink, BrickProgram::Path), 1_500);
    assert!(camera.is_empty());
    let heard = messages(&brick.concat());
    assert!(heard.iter().any(|(from, _)| *from == CAMERA));
}

#[test]
fn a_pushing_program_sends_one_frame_in_each_telegram() {
    let mut simulation = world(Personality::NxtPush, BrickProgram::Path);
    let (telegrams, _) = listen(&mut simulation, 2_000);
    let mut frames = Vec::new();
    for telegram in &telegrams {
        let (length, frame) = telegram.split_at(2);
        assert_eq!(length, (frame.len() as u16).to_le_bytes());
        // Magic, and a payload that fills the telegram: one frame.
        assert_eq!((frame[0], frame.len()), (0xFD, usize::from(frame[1]) + 12));
        frames.extend(frame);
    }
    let heard = messages(&frames);
    let count = |wanted: fn(&Message) -> bool| heard.iter().filter(|(_, m)| wanted(m)).count();
    assert!((38..=40).contains(&count(|m| matches!(m, Message::WheelTicks(_)))));
    assert!((38..=40).contains(&count(|m| matches!(m, Message::Inertial(_)))));
    assert_eq!(count(|m| matches!(m, Message::Heartbeat(_))), 2);
    assert_eq!(count(|m| matches!(m, Message::RobotDescription(_))), 1);
}

#[test]
fn a_pushing_program_takes_estimates_and_its_firmware_answers_between() {
    let mut simulation = world(Personality::NxtPush, BrickProgram::Path);
    listen(&mut simulation, 1_000);
    simulation.receive(&ESTIMATE);
    listen(&mut simulation, 100);
    assert_eq!(simulation.received_estimates().len(), 1);
    assert_eq!(simulation.truth().last().unwrap().onboard_estimate.x.0, 1.5);
    simulation.receive(&BATTERY);
    let (telegrams, _) = listen(&mut simulation, 200);
    let is_answer = |telegram: &&Vec<u8>| telegram[2..4] == [0x02, 0x0B];
    assert_eq!(telegrams.iter().filter(is_answer).count(), 1);
}

#[test]
fn without_a_program_nothing_is_pushed() {
    let (telegrams, _) = listen(&mut world(Personality::NxtPush, BrickProgram::None), 2_000);
    assert!(telegrams.is_empty());
}

#[test]
fn the_same_program_drives_the_same_way_whatever_the_brick_speaks() {
    let driven = |personality| {
        let scenario = Scenario::bundled("square").unwrap().with_personality(personality);
        let mut simulation = Simulation::new(scenario.with_steering(Steering::Odometry));
        // The program of an NXT that is polled waits for the first telegram of whoever looks.
        simulation.receive(&BATTERY);
        while !simulation.is_finished() {
            listen(&mut simulation, 100);
            assert!(simulation.elapsed() < LONGEST_LAP, "{personality:?}");
        }
        let poses = simulation.truth().iter().map(|sample| (sample.pose, sample.onboard_estimate));
        poses.collect::<Vec<_>>()
    };
    let expected = driven(Personality::Mavlink);
    assert!(expected.len() > 400);
    for personality in LEGO {
        assert!(driven(personality) == expected, "{personality:?}");
    }
}

#[test]
fn a_restarted_brick_begins_at_zero_and_answers_again() {
    for personality in LEGO {
        let mut simulation = world(personality, BrickProgram::Path);
        listen(&mut simulation, 4_000);
        simulation.restart_brick();
        // EV3: the counter of motor B. NXT: the tick of the Command module.
        let request: &[u8] = if personality == Personality::Ev3 {
            &[9, 0, 1, 0, 0, 4, 0, 0xB3, 0, 1, 0x60]
        } else {
            &[10, 0, 1, 0x94, 1, 0, 1, 0, 20, 0, 4, 0]
        };
        simulation.receive(request);
        let (telegrams, _) = listen(&mut simulation, 80);
        let answer = telegrams.last().unwrap();
        let value = i32::from_le_bytes(*answer.last_chunk().unwrap());
        if personality != Personality::NxtPush {
            assert!((-10..=10).contains(&value), "{personality:?}: {value}");
        }
    }
}

proptest! {
    /// Whatever came before: after a pause, a question is answered.
    #[test]
    fn no_bytes_confuse_a_brick_for_good(
        bytes in proptest::collection::vec(any::<u8>(), 0..400),
        chunk in 1_usize..50,
        is_ev3 in any::<bool>(),
    ) {
        let personality = if is_ev3 { Personality::Ev3 } else { Personality::Nxt };
        let mut simulation = world(personality, BrickProgram::None);
        for piece in bytes.chunks(chunk) {
            simulation.receive(piece);
            listen(&mut simulation, 1);
        }
        listen(&mut simulation, 500);
        simulation.reopen_link();
        let question: &[u8] = if is_ev3 { &CLOCK } else { &BATTERY };
        simulation.receive(question);
        let (telegrams, _) = listen(&mut simulation, 200);
        let expected = if is_ev3 { 9 } else { 7 };
        prop_assert_eq!(telegrams.iter().map(Vec::len).collect::<Vec<_>>(), vec![expected]);
    }

    /// How the bytes of one instant are cut says nothing; only a socket's writes do, and those begin with 98.
    #[test]
    fn chunks_say_nothing(
        body in proptest::collection::vec(any::<u8>(), 0..40),
        chunk in 1_usize..50,
        is_ev3 in any::<bool>(),
    ) {
        let personality = if is_ev3 { Personality::Ev3 } else { Personality::Nxt };
        let answers = |size: usize| {
            let mut simulation = world(personality, BrickProgram::None);
            let question: &[u8] = if is_ev3 { &CLOCK } else { &BATTERY };
            // A whole request, then something whose length is right.
            let length = (body.len() as u16).to_le_bytes();
            let bytes = [question, &length, &body].concat();
            bytes.chunks(size).for_each(|piece| simulation.receive(piece));
            listen(&mut simulation, 300).0
        };
        prop_assert_eq!(answers(chunk), answers(usize::MAX));
    }
}
