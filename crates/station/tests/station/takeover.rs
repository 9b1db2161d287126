//! Robots that move from one station to another: their state, their owner, and what a stand-by station does not do.

use posebridge_estimator::{EstimatedQuantity, FILTERS, find_filter};
use posebridge_protocol::message::{
    Battery, CommandLong, Heartbeat, ImuMessage, Inertial, Message, PlanarImu, VisionFix, WheelTicks, WireStamp,
};
use posebridge_station::{AnnouncedAs, DescriptionPolicy, OwnershipStatus, StationConfig};
use posebridge_telemetry::{
    Address, Celsius, ChannelName, Command, EncoderTicks, Event, Heading, HostClock, Input, LinkId, Meters, Ownership,
    PeerId, Pose, Radians, RadiansPerSecond, Recipients, RobotId, RobotSnapshot, TimeDelta, Timestamp,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::support::ground::{GCS, GCS_LINK};
use crate::support::{BRICK, HEARTBEAT, LINK, STATION, TestStation, at, config, frame, link, messages, time_answer};

const ROBOT: RobotId = RobotId { link: LINK, address: BRICK };
const CAMERA_LINK: LinkId = LinkId(7);
const CAMERA: Address = Address::new(40, 100);
const WRONG_CAMERA: Address = Address::new(41, 100);
/// What the clocks of robot and camera show at host zero.
const ROBOT_AHEAD_MS: i64 = 4_290_000;
const CAMERA_AHEAD_MS: i64 = 77_000;
/// The robot reads its wheels and its gyro so often.
const PERIOD_MS: i64 = 20;

/// A robot's link and a camera's.
fn two_links(filter: &str) -> StationConfig {
    let mut config = config();
    filter.clone_into(&mut config.robot.filter);
    config.robot.filter_config.noise.wall_range_m = 0.01;
    config.links.push(link(CAMERA_LINK, vec![]));
    config
}

/// Where a robot is that winds along at 0.2 m/s.
fn pose_at(millis: i64) -> (f64, f64, f64) {
    let heading_rad = |millis: i64| 0.8 * (0.35e-3 * millis as f64).sin();
    let (mut x_m, mut y_m) = (0.0, 0.0);
    for step in 0..millis / 10 {
        let (sin, cos) = heading_rad(10 * step + 5).sin_cos();
        (x_m, y_m) = (x_m + 0.002 * cos, y_m + 0.002 * sin);
    }
    (x_m, y_m, heading_rad(millis))
}

/// Rotation of the wheels, in counts of a degree.
fn counts_at(millis: i64) -> [i64; 2] {
    let s = millis as f64 * 1e-3;
    let (forward_m, turn_rad) = (0.2 * s, 0.8 * (0.35 * s).sin());
    [-1.0, 1.0].map(|side| ((forward_m + side * 0.056 * turn_rad) / 0.028).to_degrees().floor() as i64)
}

/// The wheels' counts, where the robot's counter of microseconds has 32 bits: it wraps in the fifth second.
fn wheels(millis: i64) -> Message {
    let [left, right] = counts_at(millis);
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(((ROBOT_AHEAD_MS + millis) * 1_000) as u32),
        left: EncoderTicks(left),
        right: EncoderTicks(right),
    })
}

fn gyro(stamp: WireStamp, millis: i64) -> Message {
    let rate = |millis: i64| 0.8 * 0.35 * (0.35e-3 * millis as f64).cos() + 0.011;
    let turn = 0.8 * (0.35e-3 * millis as f64).sin() + 0.011e-3 * millis as f64;
    Message::Inertial(Inertial {
        stamp,
        turn_rate: Some(RadiansPerSecond(rate(millis))),
        turn: Some(Radians(turn)),
        wheel_accelerations: Some((
            posebridge_telemetry::MetersPerSecondSquared(0.01),
            posebridge_telemetry::MetersPerSecondSquared(-0.01),
        )),
    })
}

fn fix(stamp: WireStamp, millis: i64) -> Message {
    let (x_m, y_m, heading_rad) = pose_at(millis);
    // One in nine is an outlier.
    let off_m = if millis % 1_800 == 0 { 0.7 } else { 0.002 * (millis as f64).sin() };
    Message::VisionPosition(VisionFix {
        stamp,
        x: Meters(x_m + off_m),
        y: Meters(y_m),
        heading: (millis % 600 != 0).then(|| Heading::from_rad(heading_rad)),
        covariance: Some([2e-5, 0.0, 2e-5, 1e-3]),
        reset_counter: 0,
        tag: None,
    })
}

/// Milliseconds by which each of ten messages in a row is late.
const LATE_MS: [i64; 10] = [3, 5, 4, 19, 3, 6, 3, 11, 4, 8];

/// What a station is given in so many seconds, but for the answers to its own requests: the robot's wheels and gyro, a fix of its own
/// camera that it relays late, thermometer and wall; and a camera with a clock of its own, which is late as well.
fn drive(seconds: i64) -> Vec<(Timestamp<HostClock>, Input)> {
    let mut inputs = Vec::new();
    let mut give = |arrival_ms: i64, link: LinkId, from: Address, message: &Message| {
        let input = Input::Bytes { link, peer: PeerId::default(), bytes: frame(from, message) };
        inputs.push((at(arrival_ms), input));
    };
    for step in 0..seconds * 1_000 / PERIOD_MS {
        let millis = step * PERIOD_MS;
        let arrival_ms = millis + LATE_MS[step as usize % 10];
        let shown = ROBOT_AHEAD_MS + millis;
        if step % 50 == 0 {
            give(arrival_ms, LINK, BRICK, &HEARTBEAT);
        }
        if step == 20 {
            let battery = Battery { voltage_v: Some(7.4), current_a: None, remaining: Some(0.6) };
            give(arrival_ms, LINK, BRICK, &Message::BatteryStatus(battery));
        }
        give(arrival_ms, LINK, BRICK, &wheels(millis));
        give(arrival_ms, LINK, BRICK, &gyro(WireStamp::Micros32((shown * 1_000) as u32), millis));
        if step % 10 == 7 {
            // By the robot's clock, and 140 ms old.
            let seen_ms = millis - 140;
            give(
                arrival_ms,
                LINK,
                BRICK,
                &fix(WireStamp::Micros64(((ROBOT_AHEAD_MS + seen_ms) * 1_000) as u64), seen_ms),
            );
        }
        if step % 15 == 4 {
            let seen_ms = millis - 90;
            let stamp = WireStamp::Micros64(((CAMERA_AHEAD_MS + seen_ms) * 1_000) as u64);
            give(arrival_ms, CAMERA_LINK, CAMERA, &fix(stamp, seen_ms));
        }
        if step % 15 == 9 {
            // Three metres off, and never used while the other one sees the robot.
            let stamp = WireStamp::Micros64(((CAMERA_AHEAD_MS + millis) * 1_000) as u64);
            let Message::VisionPosition(seen) = fix(stamp, millis) else { continue };
            let wrong = VisionFix { x: Meters(seen.x.0 + 3.0), ..seen };
            give(arrival_ms, CAMERA_LINK, WRONG_CAMERA, &Message::VisionPosition(wrong));
        }
        if step % 25 == 3 {
            let channel = ChannelName::from_bytes(b"temp1");
            let temperature = Celsius(20.0 + 0.5 * (millis as f64 * 1e-4).sin());
            let stamp = WireStamp::Millis32(shown as u32);
            give(arrival_ms, LINK, BRICK, &Message::Thermometer { stamp, channel, temperature });
        }
        if step % 5 == 2 {
            let stamp = WireStamp::Millis32(shown as u32);
            let range = Meters(3.0 - 0.0002 * millis as f64 % 2.0);
            give(arrival_ms, LINK, BRICK, &Message::DistanceSensor { stamp, range, sigma: None });
        }
    }
    inputs.sort_by_key(|(now, _)| *now);
    inputs
}

/// Inputs of the robot's link alone.
fn is_of_robot(input: &Input) -> bool {
    matches!(input, Input::Bytes { link: LINK, .. })
}

fn shifted(now: Timestamp<HostClock>, by: TimeDelta) -> Timestamp<HostClock> {
    now + by
}

/// What is compared: all that a station says of the robot's observations and estimates, in the robot's time, in every digit.
fn told(station: &TestStation, since: Timestamp<HostClock>) -> Vec<String> {
    let mut events = Vec::new();
    for (now, output) in &station.outputs {
        let posebridge_telemetry::Output::Event(event) = output else { continue };
        if *now < since {
            continue;
        }
        match event {
            Event::EstimateUpdated { estimate, .. } => events.push(format!("{estimate:?}")),
            Event::ObservationFused { record, .. } => events.push(format!("{record:?}")),
            Event::ObservationAligned { observation, .. } => events.push(format!("{observation:?}")),
            Event::QuantityUpdated { estimate, .. } => events.push(format!("{estimate:?}")),
            Event::Temperature { stamp, verdict, settled, .. } => {
                events.push(format!("{stamp:?} {verdict:?} {settled:?}"));
            }
            Event::Text { text, .. } if !text.contains("this station owns it") => events.push(text.clone()),
            _ => {}
        }
    }
    events
}

fn owner(epoch: u64, bytes: Vec<u8>, clock_offset: TimeDelta) -> Input {
    let state = Some(RobotSnapshot { bytes, clock_offset });
    Input::Ownership { robot: ROBOT, ownership: Ownership::Owner { epoch, state } }
}

fn standby(epoch: u64) -> Input {
    Input::Ownership { robot: ROBOT, ownership: Ownership::Standby { epoch } }
}

/// A robot that leaves its station at an instant for one whose clock is ahead of the first one's, and what both say of it from then on.
struct Migration<'a> {
    config: &'a StationConfig,
    inputs: &'a [(Timestamp<HostClock>, Input)],
    at: Timestamp<HostClock>,
    ahead: TimeDelta,
}

impl Migration<'_> {
    /// The second station hears the camera from the beginning, and the robot from the instant on.
    fn check(&self, name: &str) -> usize {
        let Self { config, inputs, at: instant, ahead } = *self;
        let (mut first, mut second) = (TestStation::new(config), TestStation::new(config));
        let mut size = 0;
        let mut has_moved = false;
        for (now, input) in inputs {
            if !has_moved && *now >= instant {
                has_moved = true;
                let state = first.engine.robot_state(ROBOT).expect("the robot is known");
                size = state.len();
                second.handle(shifted(*now, ahead), owner(1, state, -ahead));
            }
            first.handle(*now, input.clone());
            if has_moved || !is_of_robot(input) {
                second.handle(shifted(*now, ahead), input.clone());
            }
        }
        let (stays, goes) = (told(&first, instant), told(&second, shifted(instant, ahead)));
        assert!(stays.len() > 500, "{name}: {}", stays.len());
        for (index, (expected, found)) in stays.iter().zip(&goes).enumerate() {
            assert_eq!(expected, found, "{name} at {instant:?}: {index} of {} differs", stays.len());
        }
        assert_eq!(stays.len(), goes.len(), "{name}");
        // What no event shows yet, such as the evidence about its wiring and what is known of its battery.
        let is_same = first.engine.robot_state(ROBOT) == second.engine.robot_state(ROBOT);
        assert!(is_same || ahead != TimeDelta::ZERO, "{name}: the states differ at the end");
        let text = format!("robot {ROBOT}: this station owns it (epoch 1)");
        assert!(second.texts().contains(&text.as_str()), "{name}: {:?}", second.texts());
        size
    }
}

#[test]
fn migration_equals_no_migration_for_every_filter() {
    let inputs = drive(60);
    println!(
        "bytes of a robot's state: wheels, gyro and accelerometers at 50 Hz, fixes at 5 Hz and 3.3 Hz, range, thermometer"
    );
    for entry in FILTERS {
        let config = two_links(entry.name);
        let sizes = [3_007, 20_001, 41_240].map(|millis| {
            Migration { config: &config, inputs: &inputs, at: at(millis), ahead: TimeDelta::ZERO }.check(entry.name)
        });
        println!("{:24} {sizes:?}", entry.name);
    }
}

/// All host times of the state are moved together, and everything else is relative to them or in the robot's time: not an ulp differs.
#[test]
fn the_clock_of_the_second_station_may_show_another_time() {
    let inputs = drive(30);
    let config = two_links("pose");
    let ahead = TimeDelta::from_millis(1_234_500);
    Migration { config: &config, inputs: &inputs, at: at(15_161), ahead }.check("ahead");
}

/// A robot that has described its geometry takes that along: its counts mean other distances. So does one with two inertial units the one
/// that is used.
#[test]
fn a_described_geometry_and_the_chosen_inertial_unit_go_with_the_robot() {
    let mut config = two_links("pose");
    config.robot.description = DescriptionPolicy::Adopt;
    let description = Message::RobotDescription(posebridge_protocol::message::RobotDescription {
        left_wheel_radius: Meters(0.031),
        right_wheel_radius: Meters(0.03),
        track_width: Meters(0.12),
        ticks_per_turn: 720.0,
        name: String::new(),
        gyro_sigma: RadiansPerSecond(0.01),
        gyro_resolution: RadiansPerSecond(0.0),
    });
    let mut inputs = drive(20);
    let first = Input::Bytes { link: LINK, peer: PeerId::default(), bytes: frame(BRICK, &description) };
    inputs.insert(6, (inputs[6].0, first));
    for (millis, message) in (500..20_000).step_by(100).zip([ImuMessage::Raw, ImuMessage::Scaled2].into_iter().cycle())
    {
        let stamp = WireStamp::Millis32((ROBOT_AHEAD_MS + millis) as u32);
        let imu = PlanarImu { message, stamp, turn_rate: Some(RadiansPerSecond(0.1)), forward_acceleration: None };
        let bytes = frame(BRICK, &Message::Imu(imu));
        inputs.push((at(millis + 4), Input::Bytes { link: LINK, peer: PeerId::default(), bytes }));
    }
    inputs.sort_by_key(|(now, _)| *now);
    Migration { config: &config, inputs: &inputs, at: at(10_150), ahead: TimeDelta::ZERO }.check("described");
}

/// A station that was given so much of a drive.
fn driven(config: &StationConfig, until: Timestamp<HostClock>) -> TestStation {
    let mut station = TestStation::new(config);
    for (now, input) in drive(6).into_iter().filter(|(now, _)| *now < until) {
        station.handle(now, input);
    }
    station
}

/// The station's text about a state that it does not use.
fn refusal(station: &TestStation) -> String {
    let texts = station.texts();
    let text = texts.iter().find(|text| text.contains("is not used"));
    text.map(|text| (*text).to_owned()).unwrap_or_default()
}

#[test]
fn a_state_of_another_configuration_is_refused_with_what_differs() {
    let state = driven(&two_links("pose"), at(5_000)).engine.robot_state(ROBOT).expect("it is known");
    let with = |change: fn(&mut StationConfig)| {
        let mut config = two_links("pose");
        change(&mut config);
        config
    };
    let cases = [
        (two_links("odometry"), "it is of the filter pose, and the robot has odometry here"),
        (
            with(|config| config.robot.filter_config.noise.gyro_rad_per_s *= 2.0),
            "the robot is configured otherwise there: its noise",
        ),
        (
            with(|config| {
                config.robot.filter_config.geometry.track_width.0 += 0.001;
                config.robot.filter_config.params.gate_probability = 0.9;
                config.robot.tag_in_body.x.0 = 0.05;
            }),
            "its geometry, parameters and wiring or tag",
        ),
    ];
    for (config, expected) in cases {
        let mut station = driven(&config, at(5_000));
        let before = station.engine.robot_state(ROBOT);
        station.handle(at(5_000), owner(3, state.clone(), TimeDelta::ZERO));
        assert!(refusal(&station).contains(expected), "{}", refusal(&station));
        assert_eq!(station.engine.robot_state(ROBOT), before, "it goes on as it was");
        assert_eq!(station.engine.first_robot().ownership(), OwnershipStatus::Owner { epoch: 3 });
    }
    // The same bytes with another version in front.
    let mut other = state;
    other[0] += 1;
    let mut station = driven(&two_links("pose"), at(5_000));
    station.handle(at(5_000), owner(3, other, TimeDelta::ZERO));
    assert!(refusal(&station).contains("(layout 2), and this is"), "{}", refusal(&station));
}

/// A stand-by station's peers on the robot's link: the robot is 0.
const VIEWER: PeerId = PeerId(5);
const GCS_HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 });

/// What a station has sent to the robot.
fn sent_to_robot(station: &TestStation, first_output: usize) -> Vec<Message> {
    let to_robot =
        station.sent_since(first_output).filter(|sent| sent.link == LINK && sent.to.includes(PeerId::default()));
    to_robot.flat_map(|sent| messages(sent.bytes)).collect()
}

/// A ground station on a link of its own and one beside the robot.
fn with_viewers() -> StationConfig {
    let mut config = two_links("pose");
    let mut ground = link(GCS_LINK, vec![crate::support::stream(posebridge_station::OutputKind::Attitude, 100)]);
    ground.announced_as = AnnouncedAs::StationAndVehicle;
    config.links.push(ground);
    // Less often than the robot is heard.
    config.links[0].outputs = vec![crate::support::stream(posebridge_station::OutputKind::PlanarPose, 700)];
    config.fix_requests.above_m = Some(1e-6);
    config
}

fn give_drive(station: &mut TestStation, from_ms: i64, until_ms: i64) {
    for (now, input) in drive(20).into_iter().filter(|(now, _)| *now >= at(from_ms) && *now < at(until_ms)) {
        if now.as_nanos() % 500_000_000 < 20_000_000 {
            station.bytes_from(now, GCS_LINK, PeerId::default(), &frame(GCS, &GCS_HEARTBEAT));
            station.bytes_from(now, LINK, VIEWER, &frame(Address::new(253, 190), &GCS_HEARTBEAT));
        }
        station.pass_until(now);
        station.handle(now, input);
    }
}

#[test]
fn a_stand_by_station_hears_the_robot_and_sends_it_nothing_until_it_owns_it() {
    for is_known_before in [true, false] {
        let mut station = TestStation::new(&with_viewers());
        if is_known_before {
            give_drive(&mut station, 0, 3_000);
        }
        station.handle(at(3_000), standby(4));
        let first = station.outputs.len();
        give_drive(&mut station, 3_000, 9_000);
        let command = |target| Message::Command(CommandLong { target, command: 400, params: [1.0; 7] });
        station.bytes_from(at(9_000), GCS_LINK, PeerId::default(), &frame(GCS, &command(BRICK)));
        assert_eq!(sent_to_robot(&station, first), [], "known before: {is_known_before}");
        assert_eq!(station.engine.first_robot().ownership(), OwnershipStatus::Standby { epoch: 4 });
        // It is fused, and shown to those who look on: on their own link, and on the robot's.
        let fused = station.events_since(first).filter(|event| matches!(event, Event::EstimateUpdated { .. })).count();
        assert!(fused > 250, "{fused}");
        let shown = station.messages_since(first, GCS_LINK);
        assert!(shown.iter().filter(|message| matches!(message, Message::Attitude { .. })).count() > 40);
        let to_viewer =
            station.sent_since(first).filter(|sent| sent.link == LINK && sent.to == Recipients::Peer(VIEWER));
        let to_viewer: Vec<Message> = to_viewer.flat_map(|sent| messages(sent.bytes)).collect();
        assert!(to_viewer.iter().any(|message| matches!(message, Message::PlanarPose(_))), "{to_viewer:?}");
        // It owns the robot: the next observation is answered, and requests go out again.
        let first = station.outputs.len();
        station.handle(
            at(9_001),
            Input::Ownership { robot: ROBOT, ownership: Ownership::Owner { epoch: 5, state: None } },
        );
        let sent = sent_to_robot(&station, first);
        assert!(
            !sent.iter().any(|message| matches!(message, Message::PlanarPose(_))),
            "not before it is heard: {sent:?}"
        );
        station.bytes(at(9_024), &frame(BRICK, &wheels(9_020)));
        let sent = sent_to_robot(&station, first);
        let epochs = sent.iter().filter_map(|message| match message {
            Message::PlanarPose(pose) => Some(pose.epoch),
            _ => None,
        });
        assert_eq!(epochs.collect::<Vec<_>>(), [5]);
        give_drive(&mut station, 9_040, 10_000);
        let sent = sent_to_robot(&station, first);
        for is_it in [
            (|message: &Message| matches!(message, Message::TimeSync(_))) as fn(&Message) -> bool,
            |message| matches!(message, Message::Heartbeat(_)),
            |message| matches!(message, Message::Command(_) | Message::SetMessageInterval(_)),
        ] {
            assert!(sent.iter().any(is_it), "known before: {is_known_before}: {sent:?}");
        }
    }
}

#[test]
fn commands_of_people_to_a_stand_by_robot_are_refused_with_a_text() {
    let mut station = TestStation::new(&with_viewers());
    give_drive(&mut station, 0, 3_000);
    station.handle(at(3_000), standby(9));
    let before = station.engine.robot_state(ROBOT);
    let set_pose = Command::SetPose { pose: Pose::default(), position_sigma_m: 0.1, heading_sigma_rad: 0.1 };
    station.handle(at(3_001), Input::RobotCommand { robot: ROBOT, command: set_pose });
    station.handle(at(3_002), Input::Command(set_pose));
    station.handle(at(3_003), Input::RobotCommand { robot: ROBOT, command: Command::ResetPose });
    assert_eq!(station.engine.robot_state(ROBOT), before);
    let refused = "another station owns the robot (epoch 9)";
    assert_eq!(station.texts().iter().filter(|text| text.contains(refused)).count(), 3, "{:?}", station.texts());
    // What a ground station sends to the robot itself is not passed on, which is said once.
    let command = Message::Command(CommandLong { target: BRICK, command: 42_999, params: [0.0; 7] });
    let mut encoder = posebridge_protocol::dialect::Encoder::new(posebridge_protocol::framing::WireVersion::V2);
    for millis in [3_010, 3_020] {
        let mut bytes = Vec::new();
        encoder.encode(GCS, &command, &mut bytes);
        station.bytes_from(at(millis), GCS_LINK, PeerId::default(), &bytes);
    }
    let said = station.texts().iter().filter(|text| text.contains("is not passed on")).count();
    assert_eq!(said, 1, "{:?}", station.texts());
    // The station's own settings are its own.
    station.handle(
        at(3_030),
        Input::Command(Command::SetParameter { name: ChannelName::from_bytes(b"gate_prob"), value: 0.9 }),
    );
}

#[test]
fn the_replay_of_a_session_with_a_takeover_equals_the_session() {
    let config = with_viewers();
    let mut left = TestStation::new(&config);
    give_drive(&mut left, 0, 4_000);
    let state = left.engine.robot_state(ROBOT).expect("it is known");
    let mut station = TestStation::new(&config);
    station.handle(at(100), standby(1));
    give_drive(&mut station, 1_000, 4_000);
    station.handle(at(4_000), owner(2, state, TimeDelta::from_millis(3)));
    give_drive(&mut station, 4_000, 6_000);
    station.handle(at(6_000), standby(3));
    give_drive(&mut station, 6_000, 7_000);
    assert_eq!(refusal(&station), "");
    assert_eq!(station.replayed(&config).outputs, station.outputs);
}

fn cases() -> ProptestConfig {
    ProptestConfig {
        cases: 400,
        rng_seed: RngSeed::Fixed(20_261),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(cases())]

    /// Whatever another machine sends as a state: the engine goes on, and the robot has an estimate with the next observations.
    #[test]
    fn for_any_state_the_engine_neither_panics_nor_loses_the_robot(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in prop::option::of(any::<prop::sample::Index>()),
        offset_nanos in prop_oneof![3 => Just(0_i64), 1 => any::<i64>()],
        filter in 0..FILTERS.len(),
    ) {
        let entry = &FILTERS[filter];
        let mut config = two_links(entry.name);
        config.robot.filter_config.params.history_s = 0.4;
        let mut station = driven(&config, at(2_000));
        let mut state = station.engine.robot_state(ROBOT).expect("it is known");
        for (index, byte) in changes {
            let index = index.index(state.len());
            state[index] ^= byte;
        }
        if let Some(cut) = cut {
            state.truncate(cut.index(state.len()));
        }
        station.handle(at(2_000), owner(1, state, TimeDelta::from_nanos(offset_nanos)));
        let first = station.outputs.len();
        for (now, input) in drive(3).into_iter().filter(|(now, _)| *now >= at(2_000)) {
            station.handle(now, input);
        }
        let has_pose = find_filter(entry.name).is_some_and(|entry| entry.quantity == EstimatedQuantity::Pose);
        let mut estimates = station.events_since(first).filter_map(|event| match event {
            Event::EstimateUpdated { estimate, .. } => Some(estimate.is_finite()),
            _ => None,
        });
        prop_assert!(!has_pose || estimates.any(|is_finite| is_finite), "{}", entry.name);
        prop_assert!(station.engine.robot_state(ROBOT).is_some());
    }
}

#[test]
fn time_answers_of_before_a_takeover_still_hold_after_it() {
    let mut config = two_links("pose");
    config.links[0].outputs[0].instant = posebridge_station::OutputInstant::Arrival;
    let mut first = TestStation::new(&config);
    for (now, input) in drive(4) {
        let before = first.outputs.len();
        first.pass_until(now);
        for request in first.time_requests(before).into_iter().filter(|request| request.link == LINK) {
            let shown = request.sent.as_nanos() + ROBOT_AHEAD_MS * 1_000_000 + 2_000_000;
            first.bytes(request.sent + TimeDelta::from_millis(4), &frame(BRICK, &time_answer(shown, request.nanos)));
        }
        first.handle(now, input);
    }
    let mut second = TestStation::new(&config);
    let state = first.engine.robot_state(ROBOT).expect("it is known");
    second.handle(at(4_000), owner(1, state, TimeDelta::ZERO));
    let wheels = frame(BRICK, &wheels(4_020));
    let (before, next) = (first.outputs.len(), second.outputs.len());
    first.bytes(at(4_023), &wheels);
    second.bytes(at(4_023), &wheels);
    // Predicted for the instant of its arrival, which the alignment of the clocks gives.
    let pose = |station: &TestStation, since| {
        sent_to_robot(station, since).into_iter().find(|message| matches!(message, Message::PlanarPose(_)))
    };
    let expected = pose(&first, before);
    assert!(matches!(&expected, Some(Message::PlanarPose(pose)) if pose.flags.predicted), "{expected:?}");
    let Some(Message::PlanarPose(found)) = pose(&second, next) else { panic!("it is sent at once") };
    let Some(Message::PlanarPose(expected)) = expected else { panic!("it is sent at once") };
    assert_eq!(posebridge_protocol::message::PlanarPose { epoch: 0, ..found }, expected);
    assert_eq!(second.count(|event| matches!(event, Event::Text { source: STATION, .. })), 1);
}
