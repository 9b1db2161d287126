//! The brick and the camera as a station meets them: over bytes.
#![expect(clippy::unwrap_used, reason = "test code stops at the first surprise")]

use posebridge_protocol::dialect::{self, Encoder, ids};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{
    Message, PlanarPose, PoseFlags, SetMessageInterval, TimeSync, WheelTicks, WireStamp,
};
use posebridge_sim::scenario::Wire;
use posebridge_sim::{BRICK, CAMERA, Scenario, Simulation, Steering, TruthSample};
use posebridge_telemetry::{
    Address, Arena, Heading, HostClock, Meters, MetersPerSecond, Pose, RadiansPerSecond, TimeDelta, Timestamp,
};
use proptest::prelude::*;

const STATION: Address = Address::new(255, 190);

#[test]
fn brick_and_camera_introduce_themselves() {
    let mut world = BrickSession::new(Scenario::default());
    let heard = world.run(1_500);
    let types: Vec<(Address, u8)> = heard
        .iter()
        .filter_map(|(from, message)| {
            let Message::Heartbeat(beat) = message else {
                return None;
            };
            Some((*from, beat.vehicle_type))
        })
        .collect();
    for expected in [(BRICK, 10), (CAMERA, 30)] {
        assert_eq!(types.iter().filter(|t| **t == expected).count(), 2);
    }
    let described =
        heard.iter().any(|(from, message)| *from == BRICK && matches!(message, Message::RobotDescription(_)));
    assert!(described);
}

#[test]
fn wheels_and_inertial_come_at_twenty_hertz_with_equal_stamps() {
    let heard = BrickSession::new(Scenario::default()).run(1_990);
    let wheels = stamps(&heard, |m| Some(wheel_ticks(m)?.stamp));
    let inertial = stamps(&heard, |m| {
        let Message::Inertial(inertial) = m else {
            return None;
        };
        Some(inertial.stamp)
    });
    assert_eq!(wheels.len(), 40);
    assert_eq!(wheels, inertial);
}

#[test]
fn the_standard_wire_uses_standard_messages_only() {
    let mut scenario = Scenario::default();
    scenario.brick.wire = Wire::Standard;
    let heard = BrickSession::new(scenario).run(1_990);
    let count = |wanted: fn(&Message) -> bool| heard.iter().filter(|(_, m)| wanted(m)).count();
    assert_eq!(count(|m| matches!(m, Message::WheelDistance { .. })), 40);
    assert_eq!(count(|m| matches!(m, Message::ScaledImu(_))), 40);
    assert_eq!(count(|m| matches!(m, Message::WheelTicks(_) | Message::Inertial(_))), 0);
}

#[test]
fn each_answers_timesync_with_its_own_clock() {
    let mut scenario = Scenario::default();
    // The register wraps half a second after the beginning.
    scenario.brick.clock_start_micros = (1 << 32) - 500_000;
    scenario.brick.clock_skew_ppm = 0.0;
    scenario.brick.clock_tick_micros = 1;
    scenario.camera.clock_start_micros = 9_000_000;
    scenario.camera.clock_skew_ppm = 0.0;
    let mut world = BrickSession::new(scenario);
    world.run(1_234);
    world.send(&Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 77, target: None }));
    let answers: Vec<(Address, TimeSync)> = world
        .run(1)
        .into_iter()
        .filter_map(|(from, message)| {
            let Message::TimeSync(sync) = message else {
                return None;
            };
            (sync.answer_nanos != 0).then_some((from, sync))
        })
        .collect();
    let answer = |who| answers.iter().find(|(from, _)| *from == who).unwrap().1;
    assert_eq!(answer(BRICK).answer_nanos, 734_000_000);
    assert_eq!(answer(BRICK).request_nanos, 77);
    assert_eq!(answer(CAMERA).answer_nanos, 10_234_000_000);
}

#[test]
fn a_station_can_change_stop_and_restore_intervals() {
    let mut world = BrickSession::new(Scenario::default());
    world.run(1_000);
    let mut count_after = |interval| {
        world.send(&Message::SetMessageInterval(SetMessageInterval {
            target: BRICK,
            message_id: ids::PB_WHEEL_TICKS,
            interval,
        }));
        let heard = world.run(990);
        let ticks = heard.iter().filter(|(_, m)| matches!(m, Message::WheelTicks(_)));
        (ticks.count(), heard.iter().any(|(_, m)| matches!(m, Message::CommandAck(_))))
    };
    assert_eq!(count_after(Some(TimeDelta::from_millis(10))), (100, true));
    assert_eq!(count_after(None), (0, true));
    assert_eq!(count_after(Some(TimeDelta::ZERO)), (20, true));
}

#[test]
fn a_station_can_slow_the_camera_down() {
    let mut world = BrickSession::new(Scenario::default());
    world.send(&Message::SetMessageInterval(SetMessageInterval {
        target: CAMERA,
        message_id: ids::VISION_POSITION_ESTIMATE,
        interval: Some(TimeDelta::from_millis(500)),
    }));
    world.run(10_000);
    let fixes = world.simulation.camera_fixes().len();
    assert!((15..=21).contains(&fixes), "{fixes}");
}

#[test]
fn a_wrapping_register_keeps_its_pace() {
    let mut scenario = Scenario::default();
    scenario.brick.clock_start_micros = (1 << 32) - 1_000_000;
    scenario.brick.clock_skew_ppm = -2_021.0;
    let heard = BrickSession::new(scenario).run(3_000);
    let stamps = stamps(&heard, |m| Some(wheel_ticks(m)?.stamp));
    let registers: Vec<u32> = stamps
        .iter()
        .map(|stamp| match stamp {
            WireStamp::Micros32(micros) => *micros,
            WireStamp::Millis32(_) | WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => 0,
        })
        .collect();
    assert_eq!(registers.windows(2).filter(|w| w[1] < w[0]).count(), 1);
    for pair in registers.windows(2).skip(1) {
        assert_eq!(pair[1].wrapping_sub(pair[0]), 50_000);
    }
}

#[test]
fn telemetry_agrees_with_the_truth_at_its_stamp() {
    let mut scenario = Scenario::bundled("straight").unwrap();
    scenario.brick.clock_skew_ppm = 0.0;
    scenario.robot.backlash_deg = 0.0;
    let mut world = BrickSession::new(scenario);
    let ticks: Vec<WheelTicks> =
        world.run(6_000).into_iter().filter_map(|(_, message)| wheel_ticks(&message)).collect();
    let samples = world.simulation.truth();
    let mut compared = 0;
    for tick in ticks {
        let same = |t: &&TruthSample| tick.stamp == WireStamp::Micros32(t.brick_time.as_micros() as u32);
        let Some(sample) = samples.iter().find(same) else {
            continue;
        };
        let counted_m = 0.5 * (tick.left.0 + tick.right.0) as f64 * 0.028_f64 * 1.0_f64.to_radians();
        let driven_m = sample.pose.origin().distance(world.simulation.start_pose().origin()).0;
        // A count is 0.49 mm; slip of 0.6 mm per root metre comes on top.
        assert!((counted_m - driven_m).abs() < 0.004, "{counted_m} against {driven_m}");
        compared += 1;
    }
    assert!(compared > 100, "{compared}");
}

#[test]
fn a_restarted_brick_counts_from_zero_and_drives_on() {
    let mut world = BrickSession::new(Scenario::bundled("square").unwrap());
    world.run(5_000);
    let progress = world.simulation.progress();
    world.simulation.restart_brick();
    let first = world.run(100).into_iter().find_map(|(_, message)| wheel_ticks(&message)).unwrap();
    assert!(matches!(first.stamp, WireStamp::Micros32(micros) if micros < 60_000));
    assert!(first.left.0.abs() < 50 && first.right.0.abs() < 50);
    assert!(progress > 0.1 && world.simulation.progress() >= progress);
    while !world.simulation.is_finished() && world.simulation.elapsed().as_secs_f64() < 60.0 {
        world.run(100);
    }
    assert!(world.simulation.is_finished());
}

#[test]
fn estimates_that_come_back_keep_the_robot_on_its_path() {
    let by_odometry = worst_cross_track_m(Steering::Odometry);
    let by_estimate = worst_cross_track_m(Steering::Estimate);
    assert!(by_odometry > 0.05, "{by_odometry} m");
    assert!(by_estimate < 0.02, "{by_estimate} m");
}

#[test]
fn without_fresh_estimates_the_brick_steers_by_odometry_again() {
    let mut world = BrickSession::new(Scenario::bundled("square").unwrap());
    for _ in 0..100 {
        world.run(50);
        world.send_truth_of(60, VALID);
    }
    assert_eq!(world.last_truth().steering, Steering::Estimate);
    world.run(700);
    assert_eq!(world.last_truth().steering, Steering::Odometry);
}

#[test]
fn estimates_flagged_invalid_are_ignored() {
    let mut world = BrickSession::new(Scenario::bundled("square").unwrap());
    for _ in 0..20 {
        world.run(50);
        world.send_truth_of(60, PoseFlags::default());
    }
    assert_eq!(world.last_truth().steering, Steering::Odometry);
}

/// The largest distance from the path over a lap, with a perfect estimate that arrives 60 ms late, 20 times per second.
fn worst_cross_track_m(steering: Steering) -> f64 {
    let scenario = Scenario::bundled("square").unwrap().with_steering(steering);
    let mut world = BrickSession::new(scenario);
    while !world.simulation.is_finished() && world.simulation.elapsed().as_secs_f64() < 60.0 {
        world.run(50);
        world.send_truth_of(60, VALID);
    }
    assert!(world.simulation.is_finished());
    let samples = world.simulation.truth();
    samples.iter().map(|t| t.cross_track_m).fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_bytes_are_survived(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 0..20)) {
        let mut simulation = Simulation::new(Scenario::default());
        for chunk in chunks {
            simulation.receive(&chunk);
            simulation.step();
        }
    }

    #[test]
    fn any_estimate_is_survived(x in any::<f64>(), heading in any::<f64>(), micros in any::<u32>()) {
        let mut world = BrickSession::new(Scenario::bundled("square").unwrap());
        world.run(3_000);
        let near = world.last_truth().brick_time.as_micros() as u32;
        for stamp in [micros, near] {
            world.send(&planar_pose(stamp, Pose::new(
                Meters(x),
                Meters(0.0),
                Heading::from_rad(heading),
            ), VALID));
        }
        world.run(2_000);
        let pose = world.last_truth().pose;
        prop_assert!(pose.x.0.is_finite() && pose.heading.rad().is_finite());
    }

    #[test]
    fn pieces_of_any_size_give_the_same_answers(size in 1_usize..40) {
        let ask = Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 5, target: None });
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(WireVersion::V2);
        for _ in 0..3 {
            encoder.encode(STATION, &ask, &mut bytes);
        }
        let mut simulation = Simulation::new(Scenario::default());
        for piece in bytes.chunks(size) {
            simulation.receive(piece);
        }
        let mut answered = Vec::new();
        while let Some(chunk) = simulation.poll() {
            answered.extend(chunk);
        }
        let mut whole = Simulation::new(Scenario::default());
        whole.receive(&bytes);
        let answers = messages(&answered).len();
        prop_assert_eq!(answers, messages(&whole_output(&mut whole)).len());
        prop_assert_eq!(answers, 6);
    }
}

const VALID: PoseFlags = PoseFlags {
    position_valid: true,
    heading_valid: true,
    speeds_valid: true,
    dead_reckoning: false,
    predicted: false,
};

/// A simulation and a station that knows how to speak.
struct BrickSession {
    simulation: Simulation,
    encoder: Encoder,
}

impl BrickSession {
    fn new(scenario: Scenario) -> Self {
        Self { simulation: Simulation::new(scenario), encoder: Encoder::new(WireVersion::V2) }
    }

    /// Lets milliseconds pass and returns what was heard.
    fn run(&mut self, millis: u32) -> Vec<(Address, Message)> {
        let mut bytes = whole_output(&mut self.simulation);
        for _ in 0..millis {
            self.simulation.step();
            bytes.extend(whole_output(&mut self.simulation));
        }
        messages(&bytes)
    }

    fn send(&mut self, message: &Message) {
        let mut bytes = Vec::new();
        self.encoder.encode(STATION, message, &mut bytes);
        self.simulation.receive(&bytes);
    }

    /// Sends the newest truth that is at least `age_ms` old as an estimate.
    fn send_truth_of(&mut self, age_ms: i64, flags: PoseFlags) {
        let limit = self.simulation.elapsed() - TimeDelta::from_millis(age_ms);
        let sample = self.simulation.truth().iter().rev().find(|t| t.sim_time <= limit);
        if let Some(sample) = sample.copied() {
            let stamp = sample.brick_time.as_micros() as u32;
            self.send(&planar_pose(stamp, sample.pose, flags));
        }
    }

    fn last_truth(&self) -> &TruthSample {
        self.simulation.truth().last().unwrap()
    }
}

fn planar_pose(micros: u32, pose: Pose<Arena>, flags: PoseFlags) -> Message {
    Message::PlanarPose(PlanarPose {
        stamp: WireStamp::Micros32(micros),
        pose,
        forward_speed: MetersPerSecond(0.0),
        turn_rate: RadiansPerSecond(0.0),
        covariance: [0.0; 6],
        fix_age: None,
        reset_counter: 0,
        flags,
    })
}

fn whole_output(simulation: &mut Simulation) -> Vec<u8> {
    std::iter::from_fn(|| simulation.poll()).flatten().collect()
}

fn messages(bytes: &[u8]) -> Vec<(Address, Message)> {
    let mut heard = Vec::new();
    Framer::new(FramerConfig::default()).push(Timestamp::<HostClock>::ZERO, bytes, &mut |scanned: FramerOutput<'_>| {
        match scanned {
            FramerOutput::Frame(frame) => {
                heard.extend(dialect::decode(&frame).unwrap().map(|m| (frame.source, m)));
            }
            other @ (FramerOutput::UnknownFrame(_) | FramerOutput::Error(_)) => {
                panic!("the simulation sent {other:?}")
            }
        }
    });
    heard
}

const fn wheel_ticks(message: &Message) -> Option<WheelTicks> {
    if let Message::WheelTicks(ticks) = message { Some(*ticks) } else { None }
}

fn stamps(heard: &[(Address, Message)], pick: impl Fn(&Message) -> Option<WireStamp>) -> Vec<WireStamp> {
    heard.iter().filter_map(|(_, m)| pick(m)).collect()
}
