//! Brick and camera as a station meets them: over bytes.

use crate::support::{bundled, count, last, messages, run};
use posebridge_protocol::dialect::{Encoder, ids};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{
    Battery, Message, PlanarPose, PoseFlags, SetMessageInterval, TimeSync, WheelTicks, WireStamp,
};
use posebridge_sim::scenario::{BrickProgram, Personality, Wire};
use posebridge_sim::{BRICK, CAMERA, Scenario, Simulation, Steering};
use posebridge_telemetry::{Address, Arena, Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond, TimeDelta};
use proptest::prelude::*;

const STATION: Address = Address::new(255, 190);
const LEGO: [Personality; 3] = [Personality::Nxt, Personality::NxtPush, Personality::Ev3];
/// GETBATTERYLEVEL of the NXT, TIMER_READ_US of the EV3.
const BATTERY: [u8; 4] = [2, 0, 0x00, 0x0B];
const CLOCK: [u8; 9] = [7, 0, 1, 0, 0, 4, 0, 0x8F, 0x60];
const VALID: PoseFlags = PoseFlags {
    position_valid: true,
    heading_valid: true,
    speeds_valid: true,
    dead_reckoning: false,
    predicted: false,
};
const TIME_REQUEST: Message = Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 77, target: None });

fn encoded(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode(STATION, message, &mut bytes);
    bytes
}

/// What a MAVLink link carries within `millis`.
fn listen(simulation: &mut Simulation, millis: u32) -> Vec<(Address, Message)> {
    messages(&run(simulation, millis).concat())
}

const fn wheel_ticks(message: &Message) -> Option<WheelTicks> {
    if let Message::WheelTicks(ticks) = message { Some(*ticks) } else { None }
}

fn request_interval(target: Address, message_id: u32, interval: Option<TimeDelta>) -> Vec<u8> {
    encoded(&Message::SetMessageInterval(SetMessageInterval { target, message_id, interval }))
}

#[test]
fn brick_and_camera_introduce_themselves_and_readings_come_at_twenty_hertz_with_equal_stamps() {
    let received = listen(&mut Simulation::new(Scenario::default()), 1_990);
    for (address, vehicle_type) in [(BRICK, 10), (CAMERA, 30)] {
        let is_beat = |(from, message): &&(Address, Message)| {
            *from == address && matches!(message, Message::Heartbeat(beat) if beat.vehicle_type == vehicle_type)
        };
        assert_eq!(received.iter().filter(is_beat).count(), 2);
    }
    assert_eq!(count(&received, |message| matches!(message, Message::RobotDescription(_))), 1);
    let stamps = |pick: fn(&Message) -> Option<WireStamp>| -> Vec<WireStamp> {
        received.iter().filter_map(|(_, message)| pick(message)).collect()
    };
    let wheels = stamps(|message| Some(wheel_ticks(message)?.stamp));
    assert_eq!(wheels.len(), 40);
    assert_eq!(
        wheels,
        stamps(|message| if let Message::Inertial(inertial) = message { Some(inertial.stamp) } else { None })
    );
}

#[test]
fn the_standard_wire_uses_standard_messages_only() {
    let mut scenario = Scenario::default();
    scenario.brick.wire = Wire::Standard;
    let received = listen(&mut Simulation::new(scenario), 1_990);
    assert_eq!(count(&received, |message| matches!(message, Message::WheelDistance { .. })), 40);
    assert_eq!(count(&received, |message| matches!(message, Message::Imu(_))), 40);
    assert_eq!(count(&received, |message| matches!(message, Message::WheelTicks(_) | Message::Inertial(_))), 0);
}

#[test]
fn the_battery_is_told_each_second_until_another_interval_is_asked_for() {
    let mut scenario = Scenario::default();
    (scenario.robot.battery_v, scenario.robot.battery_drop_v_per_min) = (7.4, 60.0);
    let mut simulation = Simulation::new(scenario);
    let told = |received: &[(Address, Message)]| -> Vec<Battery> {
        let batteries = received.iter().filter_map(|(from, message)| {
            if let Message::BatteryStatus(battery) = message { Some((*from, *battery)) } else { None }
        });
        batteries.map(|(from, battery)| if from == BRICK { battery } else { panic!("{from:?}") }).collect()
    };
    // A volt in each second, from 7.4 V; two lithium cells are empty at 6.4 and full at 8.4 V.
    let batteries = told(&listen(&mut simulation, 1_990));
    let expected = [(7.4, 0.5), (6.4, 0.0)];
    assert_eq!(batteries.len(), expected.len());
    for (battery, (volts, share)) in batteries.iter().zip(expected) {
        assert!((battery.voltage_v.unwrap() - volts).abs() < 2e-3, "{battery:?}");
        assert!((battery.remaining.unwrap() - share).abs() < 1e-9 && battery.current_a.is_none(), "{battery:?}");
    }
    simulation.receive(&request_interval(BRICK, ids::BATTERY_STATUS, None));
    assert_eq!(told(&listen(&mut simulation, 2_000)), []);
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
    let mut simulation = Simulation::new(scenario);
    run(&mut simulation, 1_234);
    simulation.receive(&encoded(&TIME_REQUEST));
    let received = listen(&mut simulation, 1);
    for (address, answer_nanos) in [(BRICK, 734_000_000), (CAMERA, 10_234_000_000)] {
        let is_answer = |(from, message): &(Address, Message)| {
            let Message::TimeSync(sync) = message else { return false };
            *from == address && (sync.answer_nanos, sync.request_nanos) == (answer_nanos, 77)
        };
        assert!(received.iter().any(is_answer), "{address:?}: {received:?}");
    }
}

#[test]
fn a_station_can_change_stop_and_restore_intervals() {
    let mut simulation = Simulation::new(Scenario::default());
    run(&mut simulation, 1_000);
    // At most one in each step of a millisecond; other messages keep their interval.
    for (micros, expected) in [(Some(10_000), 100), (None, 0), (Some(0), 20), (Some(1), 990), (Some(100_000), 10)] {
        let interval = micros.map(TimeDelta::from_micros);
        simulation.receive(&request_interval(BRICK, ids::PB_WHEEL_TICKS, interval));
        let received = listen(&mut simulation, 990);
        assert_eq!(count(&received, |message| matches!(message, Message::WheelTicks(_))), expected, "{micros:?}");
        assert!((19..=20).contains(&count(&received, |message| matches!(message, Message::Inertial(_)))));
        assert_eq!(count(&received, |message| matches!(message, Message::CommandAck(_))), 1);
    }
    simulation.receive(&request_interval(CAMERA, ids::VISION_POSITION_ESTIMATE, Some(TimeDelta::from_millis(500))));
    let fixes = count(&listen(&mut simulation, 10_000), |message| matches!(message, Message::VisionPosition(_)));
    assert!((15..=22).contains(&fixes), "{fixes}");
}

#[test]
fn a_wrapping_register_keeps_its_pace() {
    let mut scenario = Scenario::default();
    scenario.brick.clock_start_micros = (1 << 32) - 1_000_000;
    scenario.brick.clock_skew_ppm = -2_021.0;
    let received = listen(&mut Simulation::new(scenario), 3_000);
    let register = |(_, message): &(Address, Message)| match wheel_ticks(message)?.stamp {
        WireStamp::Micros32(micros) => Some(micros),
        WireStamp::Millis32(_) | WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => None,
    };
    let registers: Vec<u32> = received.iter().filter_map(register).collect();
    assert_eq!(registers.windows(2).filter(|pair| pair[1] < pair[0]).count(), 1);
    assert!(registers.windows(2).skip(1).all(|pair| pair[1].wrapping_sub(pair[0]) == 50_000));
}

#[test]
fn telemetry_agrees_with_the_truth_at_its_stamp() {
    let mut scenario = bundled("straight");
    scenario.brick.clock_skew_ppm = 0.0;
    scenario.robot.backlash_deg = 0.0;
    let mut simulation = Simulation::new(scenario);
    let received = listen(&mut simulation, 6_000);
    let mut compared = 0;
    for tick in received.iter().filter_map(|(_, message)| wheel_ticks(message)) {
        let stamp = |micros: i64| WireStamp::Micros32(micros as u32);
        let mut samples = simulation.truth().iter();
        let Some(sample) = samples.find(|sample| stamp(sample.brick_time.as_micros()) == tick.stamp) else {
            continue;
        };
        let counted_m = 0.5 * (tick.left.0 + tick.right.0) as f64 * 0.028_f64 * 1.0_f64.to_radians();
        let driven_m = sample.pose.origin().distance(simulation.start_pose().origin()).0;
        // A count is 0.49 mm; slip of 0.6 mm per root metre comes on top.
        assert!((counted_m - driven_m).abs() < 0.004, "{counted_m} against {driven_m}");
        compared += 1;
    }
    assert!(compared > 100, "{compared}");
}

#[test]
fn a_restarted_brick_counts_from_zero_and_drives_on() {
    let mut simulation = Simulation::new(bundled("square"));
    run(&mut simulation, 5_000);
    let progress = simulation.progress();
    simulation.restart_brick();
    let first = listen(&mut simulation, 100).iter().find_map(|(_, message)| wheel_ticks(message)).unwrap();
    assert!(matches!(first.stamp, WireStamp::Micros32(micros) if micros < 60_000));
    assert!(first.left.0.abs() < 50 && first.right.0.abs() < 50);
    assert!(progress > 0.1 && simulation.progress() >= progress);
    run(&mut simulation, 55_000);
    assert!(simulation.is_finished());
}

fn planar_pose(micros: u32, pose: Pose<Arena>, flags: PoseFlags) -> Vec<u8> {
    planar_pose_of_epoch(0, micros, pose, flags)
}

fn planar_pose_of_epoch(epoch: u32, micros: u32, pose: Pose<Arena>, flags: PoseFlags) -> Vec<u8> {
    encoded(&Message::PlanarPose(PlanarPose {
        stamp: WireStamp::Micros32(micros),
        pose,
        forward_speed: MetersPerSecond(0.0),
        turn_rate: RadiansPerSecond(0.0),
        covariance: [0.0; 6],
        fix_age: None,
        reset_counter: 0,
        flags,
        epoch,
    }))
}

#[test]
fn a_brick_drops_the_estimates_of_a_station_that_owned_it_before() {
    let mut simulation = Simulation::new(bundled("square"));
    run(&mut simulation, 1_000);
    let flags = PoseFlags { position_valid: true, heading_valid: true, ..PoseFlags::default() };
    let used = [0, 3, 2, 3, 0, 4].map(|epoch| {
        let before = simulation.received_estimates().len();
        simulation.receive(&planar_pose_of_epoch(epoch, 900_000, Pose::default(), flags));
        run(&mut simulation, 10);
        simulation.received_estimates().len() - before
    });
    assert_eq!((used, simulation.outdated_estimates()), ([1, 1, 0, 1, 0, 1], 2));
    // After a power cycle it knows none.
    simulation.restart_brick();
    run(&mut simulation, 1_000);
    simulation.receive(&planar_pose_of_epoch(1, 900_000, Pose::default(), flags));
    assert_eq!(simulation.outdated_estimates(), 2);
}

/// Drives the square with a perfect estimate that arrives 60 ms late, 20 times per second.
fn steered(steering: Steering, flags: PoseFlags, secs: u32) -> Simulation {
    let mut simulation = Simulation::new(bundled("square").with_steering(steering));
    for _ in 0..20 * secs {
        run(&mut simulation, 50);
        let limit = simulation.elapsed() - TimeDelta::from_millis(60);
        let sample = simulation.truth().iter().rev().find(|sample| sample.sim_time <= limit).copied();
        if let Some(sample) = sample.filter(|_| !simulation.is_finished()) {
            simulation.receive(&planar_pose(sample.brick_time.as_micros() as u32, sample.pose, flags));
        }
    }
    simulation
}

#[test]
fn estimates_that_come_back_keep_the_robot_on_its_path() {
    let worst_m = |steering| {
        let simulation = steered(steering, VALID, 60);
        assert!(simulation.is_finished());
        simulation.truth().iter().map(|sample| sample.cross_track_m).fold(0.0, f64::max)
    };
    let (by_odometry, by_estimate) = (worst_m(Steering::Odometry), worst_m(Steering::Estimate));
    assert!(by_odometry > 0.05 && by_estimate < 0.02, "{by_odometry} m, {by_estimate} m");
}

#[test]
fn without_fresh_and_valid_estimates_the_brick_steers_by_odometry() {
    let mut simulation = steered(Steering::Estimate, VALID, 5);
    assert_eq!(last(&simulation).steering, Steering::Estimate);
    run(&mut simulation, 700);
    assert_eq!(last(&simulation).steering, Steering::Odometry);
    let invalid = steered(Steering::Estimate, PoseFlags { heading_valid: false, ..VALID }, 2);
    assert_eq!(last(&invalid).steering, Steering::Odometry);
}

fn lego(personality: Personality, program: BrickProgram) -> Simulation {
    let mut scenario = Scenario::default().with_personality(personality);
    scenario.brick.program = program;
    Simulation::new(scenario)
}

/// The fixes on the camera's own link within `millis`; nobody else speaks there.
fn fixes(simulation: &mut Simulation, millis: u32) -> usize {
    let mut bytes = Vec::new();
    for _ in 0..millis {
        simulation.step();
        bytes.extend(std::iter::from_fn(|| simulation.poll_camera()).flatten());
    }
    let received = messages(&bytes);
    assert!(received.iter().all(|(from, _)| *from == CAMERA));
    count(&received, |message| matches!(message, Message::VisionPosition(_)))
}

#[test]
fn the_camera_of_a_lego_brick_has_a_link_of_its_own_and_only_a_pushing_program_speaks_first() {
    for personality in LEGO {
        let mut simulation = lego(personality, BrickProgram::Path);
        assert!((25..=30).contains(&fixes(&mut simulation, 3_000)), "{personality:?}");
        assert_eq!(simulation.poll().is_some(), personality == Personality::NxtPush, "{personality:?}");
        let slower = request_interval(CAMERA, ids::VISION_POSITION_ESTIMATE, Some(TimeDelta::from_millis(500)));
        simulation.receive_camera(&slower);
        assert!((5..=8).contains(&fixes(&mut simulation, 3_000)), "{personality:?}");
    }
    assert_eq!(fixes(&mut Simulation::new(Scenario::default()), 1_500), 0);
    assert!(run(&mut lego(Personality::NxtPush, BrickProgram::None), 2_000).is_empty());
}

#[test]
fn a_pushing_program_sends_one_frame_in_each_telegram_and_its_firmware_answers_between() {
    let mut simulation = lego(Personality::NxtPush, BrickProgram::Path);
    let mut frames = Vec::new();
    for telegram in run(&mut simulation, 2_000) {
        let (length, frame) = telegram.split_at(2);
        assert_eq!(length, (frame.len() as u16).to_le_bytes());
        // Magic, and a payload that fills the telegram: one frame.
        assert_eq!((frame[0], frame.len()), (0xFD, usize::from(frame[1]) + 12));
        frames.extend_from_slice(frame);
    }
    let received = messages(&frames);
    assert!((38..=40).contains(&count(&received, |message| matches!(message, Message::WheelTicks(_)))));
    assert!((38..=40).contains(&count(&received, |message| matches!(message, Message::Inertial(_)))));
    assert_eq!(count(&received, |message| matches!(message, Message::Heartbeat(_))), 2);
    assert_eq!(count(&received, |message| matches!(message, Message::RobotDescription(_))), 1);
    simulation.receive(&BATTERY);
    let is_answer = |telegram: &&Vec<u8>| telegram[2..4] == [0x02, 0x0B];
    assert_eq!(run(&mut simulation, 200).iter().filter(is_answer).count(), 1);
}

#[test]
fn the_same_program_drives_the_same_way_whatever_the_brick_speaks() {
    let driven = |personality| {
        let scenario = bundled("square").with_personality(personality).with_steering(Steering::Odometry);
        let mut simulation = Simulation::new(scenario);
        // The program of an NXT that is polled waits for the first telegram of whoever looks.
        simulation.receive(&BATTERY);
        run(&mut simulation, 60_000);
        assert!(simulation.is_finished(), "{personality:?}");
        let poses = simulation.truth().iter().map(|sample| (sample.pose, sample.onboard_estimate));
        poses.collect::<Vec<_>>()
    };
    let expected = driven(Personality::Mavlink);
    for personality in LEGO {
        assert!(driven(personality) == expected, "{personality:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever came before: after a pause, a question is answered.
    #[test]
    fn no_bytes_confuse_a_brick_for_good(
        bytes in prop::collection::vec(any::<u8>(), 0..400),
        chunk in 1_usize..50,
        personality in prop::sample::select(vec![Personality::Mavlink, Personality::Nxt, Personality::Ev3, Personality::Line]),
    ) {
        let mut simulation = lego(personality, BrickProgram::None);
        for chunk_bytes in bytes.chunks(chunk) {
            simulation.receive(chunk_bytes);
            run(&mut simulation, 1);
        }
        run(&mut simulation, 500);
        simulation.reopen_link();
        let (request, is_answer): (_, fn(&[u8]) -> bool) = match personality {
            Personality::Mavlink => (encoded(&TIME_REQUEST), |bytes| {
                count(&messages(bytes), |message| matches!(message, Message::TimeSync(sync) if sync.request_nanos == 77)) == 2
            }),
            Personality::Nxt | Personality::NxtPush => (BATTERY.to_vec(), |bytes| bytes.len() == 7),
            Personality::Ev3 => (CLOCK.to_vec(), |bytes| bytes.len() == 9),
            Personality::Line => (Vec::new(), |bytes| bytes.starts_with(b"5")),
        };
        simulation.receive(&request);
        prop_assert!(is_answer(&run(&mut simulation, 200).concat()));
    }

    /// How the bytes of one instant are cut says nothing; only a socket's writes to an NXT do, and those begin with 98.
    #[test]
    fn chunks_say_nothing(
        body in prop::collection::vec(any::<u8>(), 0..40),
        chunk in 1_usize..50,
        personality in prop::sample::select(vec![Personality::Mavlink, Personality::Nxt, Personality::Ev3]),
    ) {
        let answers = |size: usize| {
            let mut simulation = lego(personality, BrickProgram::None);
            let request = match personality {
                Personality::Mavlink => encoded(&TIME_REQUEST).repeat(3),
                Personality::Nxt | Personality::NxtPush => BATTERY.to_vec(),
                Personality::Ev3 => CLOCK.to_vec(),
                Personality::Line => Vec::new(),
            };
            // A whole request, then something whose length is right.
            let bytes = [&request[..], &(body.len() as u16).to_le_bytes(), &body].concat();
            bytes.chunks(size).for_each(|chunk_bytes| simulation.receive(chunk_bytes));
            let received = run(&mut simulation, 300).concat();
            match personality {
                // In which order brick and camera answer depends on the pieces.
                Personality::Mavlink => vec![count(&messages(&received), |message| matches!(message, Message::TimeSync(_))) as u8],
                Personality::Nxt | Personality::NxtPush | Personality::Ev3 | Personality::Line => received,
            }
        };
        let whole = answers(usize::MAX);
        prop_assert!(!whole.is_empty() && (personality != Personality::Mavlink || whole == [6]));
        prop_assert_eq!(answers(chunk), whole);
    }

    #[test]
    fn any_estimate_is_survived(x in any::<f64>(), heading in any::<f64>(), micros in any::<u32>()) {
        let mut simulation = Simulation::new(bundled("square"));
        run(&mut simulation, 3_000);
        let near = last(&simulation).brick_time.as_micros() as u32;
        for stamp in [micros, near] {
            let pose = Pose::new(Meters(x), Meters(0.0), Heading::from_rad(heading));
            simulation.receive(&planar_pose(stamp, pose, VALID));
        }
        run(&mut simulation, 2_000);
        let pose = last(&simulation).pose;
        prop_assert!(pose.x.0.is_finite() && pose.heading.rad().is_finite());
    }
}
