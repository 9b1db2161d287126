//! What must hold for any bytes and any message.

#![expect(clippy::expect_used, clippy::wildcard_enum_match_arm, reason = "helpers of tests")]

#[path = "support/conversation.rs"]
mod conversation;
#[path = "support/framer_output.rs"]
mod framer_output;
#[path = "support/mix.rs"]
mod mix;

use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, SequenceTracker, TransportKind, WireVersion};
use posebridge_protocol::message::{
    EstimatorStatus, FusionHealth, Inertial, Message, Odometry, OdometryPose, PlanarImu, PlanarPose, PoseFlags,
    RobotDescription, SCALED_PRESSURE_CHANNEL, VisionFix, WheelTicks, WireStamp,
};
use posebridge_telemetry::{
    Address, Celsius, ChannelName, EncoderTicks, Heading, Meters, MetersPerSecond, MetersPerSecondSquared, Pose,
    Radians, RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use conversation::conversation;
use framer_output::{OwnedFramerOutput, frames, scan};
use mix::four_message_mix;

fn any_config() -> impl Strategy<Value = FramerConfig> {
    (any::<bool>(), any::<bool>()).prop_map(|(accept_v1, is_stream)| FramerConfig {
        accept_v1,
        transport: if is_stream { TransportKind::Stream } else { TransportKind::Datagram },
        ..FramerConfig::default()
    })
}

/// Bytes in which start bytes, small flags and known ids are frequent, so that the deeper branches are reached.
fn tempting_bytes() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![
        2 => any::<u8>(),
        1 => Just(0xFD_u8),
        1 => Just(0xFE_u8),
        3 => 0_u8..12,
    ];
    prop::collection::vec(byte, 0..600)
}

fn stamp32() -> impl Strategy<Value = WireStamp> {
    any::<u32>().prop_map(WireStamp::Micros32)
}

fn stamp_millis() -> impl Strategy<Value = WireStamp> {
    any::<u32>().prop_map(WireStamp::Millis32)
}

fn stamp64() -> impl Strategy<Value = WireStamp> {
    any::<u64>().prop_map(WireStamp::Micros64)
}

/// Numbers that a 32-bit float holds exactly.
fn float() -> impl Strategy<Value = f64> {
    (-1e6_f32..1e6).prop_map(f64::from)
}

fn angle() -> impl Strategy<Value = Heading> {
    (-3.1_f32..3.1).prop_map(|angle| Heading::from_rad(f64::from(angle)))
}

fn covariance<const N: usize>() -> impl Strategy<Value = [f64; N]> {
    prop::array::uniform(float())
        .prop_filter("zero position variances mean unknown", |all| all.iter().all(|&element| element != 0.0))
}

fn address() -> impl Strategy<Value = Address> {
    (1..=255_u8, 1..=255_u8).prop_map(|(system, component)| Address::new(system, component))
}

fn flags() -> impl Strategy<Value = PoseFlags> {
    (0..32_u8).prop_map(|bits| PoseFlags {
        position_valid: bits & 1 != 0,
        heading_valid: bits & 2 != 0,
        speeds_valid: bits & 4 != 0,
        dead_reckoning: bits & 8 != 0,
        predicted: bits & 16 != 0,
    })
}

fn own_message() -> BoxedStrategy<Message> {
    let ticks = (stamp32(), any::<i32>(), any::<i32>()).prop_map(|(stamp, left, right)| {
        Message::WheelTicks(WheelTicks {
            stamp,
            left: EncoderTicks(i64::from(left)),
            right: EncoderTicks(i64::from(right)),
        })
    });
    let rate = prop::option::of(any::<i16>());
    let total = prop::option::of(any::<i32>());
    let wheels = prop::option::of((any::<i16>(), any::<i16>()));
    let inertial = (stamp32(), rate, total, wheels).prop_map(|(stamp, rate, total, wheels)| {
        let acceleration = |raw: i16| MetersPerSecondSquared(f64::from(raw) * 1e-3);
        Message::Inertial(Inertial {
            stamp,
            turn_rate: rate.map(|raw| RadiansPerSecond(f64::from(raw) * 0.5e-3)),
            turn: total.map(|raw| Radians(f64::from(raw) * 1e-6)),
            wheel_accelerations: wheels.map(|(left, right)| (acceleration(left), acceleration(right))),
        })
    });
    let age = prop::option::of(0..65_535_i64);
    let pose = (stamp32(), (float(), float(), angle()), covariance(), age, flags()).prop_map(
        |(stamp, (x, y, heading), covariance, age, flags)| {
            Message::PlanarPose(PlanarPose {
                stamp,
                pose: Pose::new(Meters(x), Meters(y), heading),
                forward_speed: MetersPerSecond(y),
                turn_rate: RadiansPerSecond(x),
                covariance,
                fix_age: age.map(TimeDelta::from_millis),
                reset_counter: flags_as_counter(flags),
                flags,
            })
        },
    );
    prop_oneof![ticks, inertial, pose, health(), description()].boxed()
}

fn flags_as_counter(flags: PoseFlags) -> u8 {
    u8::from(flags.predicted) + 2 * u8::from(flags.position_valid)
}

fn health() -> impl Strategy<Value = Message> {
    let numbers = (float(), covariance(), 0..65_536_i64);
    (stamp32(), any::<(u8, u8, u16, u16)>(), numbers).prop_map(|(stamp, counts, numbers)| {
        let (sensor, verdict, accepted, refused) = counts;
        let (nis_per_dof, innovation, lag) = numbers;
        Message::FusionHealth(FusionHealth {
            stamp,
            sensor: SensorId(sensor),
            verdict,
            nis_per_dof,
            innovation,
            lag: TimeDelta::from_millis(lag),
            accepted,
            refused,
        })
    })
}

fn description() -> impl Strategy<Value = Message> {
    ("[a-zä]{0,8}", covariance::<6>()).prop_map(|(name, numbers)| {
        let [left, right, track, ticks, sigma, resolution] = numbers;
        Message::RobotDescription(RobotDescription {
            name,
            left_wheel_radius: Meters(left),
            right_wheel_radius: Meters(right),
            track_width: Meters(track),
            ticks_per_turn: ticks,
            gyro_sigma: RadiansPerSecond(sigma),
            gyro_resolution: RadiansPerSecond(resolution),
        })
    })
}

/// Messages whose wire form is coarser than the message: compared within the given tolerance.
fn coarse() -> BoxedStrategy<Message> {
    let imu = (stamp_millis(), any::<(i16, i16)>()).prop_map(|(stamp, (rate, acceleration))| {
        Message::ScaledImu(PlanarImu {
            stamp,
            turn_rate: Some(RadiansPerSecond(f64::from(rate) * 1e-3)),
            forward_acceleration: Some(MetersPerSecondSquared(f64::from(acceleration) * 9.806_65e-3)),
        })
    });
    let precise =
        (stamp64(), prop::option::of(float()), prop::option::of(float())).prop_map(|(stamp, rate, acceleration)| {
            Message::HighresImu(PlanarImu {
                stamp,
                turn_rate: rate.map(RadiansPerSecond),
                forward_acceleration: acceleration.map(MetersPerSecondSquared),
            })
        });
    let wheels = (stamp64(), -1e9..1e9, -1e9..1e9).prop_map(|(stamp, left, right)| Message::WheelDistance {
        stamp,
        left: Meters(left),
        right: Meters(right),
    });
    let range = (stamp_millis(), 0..65_535_u16, prop::option::of(0..255_u8)).prop_map(|(stamp, range, variance)| {
        Message::DistanceSensor {
            stamp,
            range: Meters(f64::from(range) * 1e-2),
            sigma: variance.map(|variance| Meters(f64::from(variance).sqrt() * 1e-2)),
        }
    });
    let named = (stamp_millis(), "temp[ -~]{0,6}", -200.0_f32..3_000.0).prop_map(|(stamp, name, temperature)| {
        Message::Thermometer {
            stamp,
            channel: ChannelName::from_bytes(name.as_bytes()),
            temperature: Celsius(f64::from(temperature)),
        }
    });
    let pressure = (stamp_millis(), -27_315_i16..).prop_map(|(stamp, cdeg_c)| Message::Thermometer {
        stamp,
        channel: ChannelName::from_bytes(SCALED_PRESSURE_CHANNEL),
        temperature: Celsius(f64::from(cdeg_c) * 1e-2),
    });
    let thermometers = prop_oneof![named, pressure];
    prop_oneof![imu, precise, wheels, range, thermometers, fixes(), poses()].boxed()
}

fn fixes() -> impl Strategy<Value = Message> {
    let parts = (stamp64(), (float(), float()), prop::option::of(angle()), prop::option::of(covariance()));
    (parts, any::<u8>(), any::<bool>()).prop_map(|(parts, counter, is_mocap)| {
        let (stamp, (x, y), heading, covariance) = parts;
        let fix = VisionFix {
            stamp,
            x: Meters(x),
            y: Meters(y),
            heading,
            covariance,
            reset_counter: if is_mocap { 0 } else { counter },
            tag: None,
        };
        if is_mocap { Message::MocapPosition(fix) } else { Message::VisionPosition(fix) }
    })
}

fn poses() -> impl Strategy<Value = Message> {
    let parts = (stamp64(), (float(), float(), angle()), (float(), float()));
    let odometry = (
        parts,
        prop::option::of(covariance()),
        // A negative quality says that there is no pose: such a message has no meaning to come back with.
        (any::<u8>(), 0..=i8::MAX, any::<bool>()),
    )
        .prop_map(|(parts, covariance, (reset_counter, quality, is_arena))| {
            let (stamp, (x, y, heading), (forward, turn)) = parts;
            let pose = if is_arena {
                OdometryPose::Arena(Pose::new(Meters(x), Meters(y), heading))
            } else {
                OdometryPose::Odom(Pose::new(Meters(x), Meters(y), heading))
            };
            Message::Odometry(Odometry {
                stamp,
                pose,
                forward_speed: MetersPerSecond(forward),
                turn_rate: RadiansPerSecond(turn),
                covariance,
                reset_counter,
                quality,
            })
        });
    let local = (stamp_millis(), covariance::<4>()).prop_map(|(stamp, [x, y, vx, vy])| Message::LocalPosition {
        stamp,
        x: Meters(x),
        y: Meters(y),
        x_speed: MetersPerSecond(vx),
        y_speed: MetersPerSecond(vy),
    });
    let attitude = (stamp_millis(), angle(), float()).prop_map(|(stamp, heading, rate)| Message::Attitude {
        stamp,
        heading,
        turn_rate: RadiansPerSecond(rate),
    });
    let status = (stamp64(), flags(), float(), float()).prop_map(|(stamp, flags, ratio, sigma)| {
        Message::EstimatorStatus(EstimatorStatus {
            stamp,
            flags: PoseFlags {
                // What the message cannot say: a prediction, and how it lives without a position.
                predicted: false,
                dead_reckoning: flags.dead_reckoning && flags.position_valid,
                ..flags
            },
            position_ratio: ratio,
            position_sigma: Meters(sigma),
        })
    });
    prop_oneof![odometry, local, attitude, status]
}

/// Encodes, scans and decodes one message.
fn there_and_back(message: &Message) -> (Vec<u8>, Message) {
    let from = Address::new(3, 4);
    let mut bytes = Vec::new();
    let length = Encoder::new(WireVersion::V2).encode(from, message, &mut bytes);
    assert_eq!(length, bytes.len());
    let mut decoded = Vec::new();
    Framer::new(FramerConfig::default()).push(Timestamp::ZERO, &bytes, &mut |found| match found {
        FramerOutput::Frame(frame) => {
            assert_eq!((frame.source, frame.sequence), (from, 0));
            decoded.push(decode(&frame).expect("sense").expect("a use"));
        }
        FramerOutput::UnknownFrame(_) | FramerOutput::Error(_) => panic!("{found:?}"),
    });
    assert_eq!(decoded.len(), 1);
    (bytes, decoded.remove(0))
}

fn heading_of(message: &Message) -> Option<Heading> {
    match message {
        Message::VisionPosition(fix) | Message::MocapPosition(fix) => fix.heading,
        Message::Attitude { heading, .. } => Some(*heading),
        Message::Odometry(Odometry { pose: OdometryPose::Arena(pose), .. }) => Some(pose.heading),
        Message::Odometry(Odometry { pose: OdometryPose::Odom(pose), .. }) => Some(pose.heading),
        _ => None,
    }
}

fn with_heading(message: &Message, heading: Option<Heading>) -> Message {
    let mut changed = message.clone();
    match (&mut changed, heading) {
        (Message::VisionPosition(fix) | Message::MocapPosition(fix), heading) => {
            fix.heading = heading;
        }
        (Message::Attitude { heading: place, .. }, Some(heading)) => *place = heading,
        (Message::Odometry(odometry), Some(heading)) => match &mut odometry.pose {
            OdometryPose::Arena(pose) => pose.heading = heading,
            OdometryPose::Odom(pose) => pose.heading = heading,
        },
        _ => {}
    }
    changed
}

/// The wire's 32-bit floats carry an angle to half a microradian; a quaternion doubles the error.
const ANGLE_RESOLUTION_RAD: f64 = 1e-6;

/// Fixed cases: the hunt for new ones is the fuzzer's.
fn cases() -> ProptestConfig {
    ProptestConfig {
        cases: 1_000,
        rng_seed: RngSeed::Fixed(20_260_101),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn no_bytes_panic_and_every_byte_is_accounted_for(
        config in any_config(),
        bytes in tempting_bytes(),
        chunk in 1_usize..40,
    ) {
        let (found, counters) = scan(config, &bytes, chunk);
        let whole: usize = found
            .iter()
            .map(|item| match item {
                OwnedFramerOutput::Frame(raw) | OwnedFramerOutput::UnknownFrame(raw) => raw.len(),
                OwnedFramerOutput::Error(_) => 0,
            })
            .sum();
        prop_assert_eq!(whole + counters.garbage_bytes as usize, bytes.len());
    }

    #[test]
    fn no_payload_panics(id in 0..posebridge_protocol::dialect::MESSAGES.len(), payload in prop::collection::vec(any::<u8>(), 0..256)) {
        let info = posebridge_protocol::dialect::MESSAGES[id];
        let frame = posebridge_protocol::framing::FrameRef {
            version: WireVersion::V2,
            message_id: info.id,
            source: Address::new(1, 1),
            sequence: 0,
            payload: &payload,
            raw: &[],
        };
        if let Err(error) = decode(&frame) {
            prop_assert_eq!(error.message_id(), info.id);
        }
    }

    /// Any bits of a number, any bytes of a name, cut anywhere: a temperature that can be, a defect, or of no use.
    #[test]
    fn no_thermometer_shows_what_cannot_be(
        is_named in any::<bool>(),
        number in prop_oneof![any::<u32>(), (-500.0_f32..5_000.0).prop_map(f32::to_bits)],
        name in prop_oneof![any::<[u8; 10]>(), any::<[u8; 6]>().prop_map(|end| {
            let mut name = *b"temp______";
            name[4..].copy_from_slice(&end);
            name
        })],
        length in 0_usize..19,
    ) {
        let mut payload = vec![1, 2, 3, 4];
        payload.extend_from_slice(&number.to_le_bytes());
        payload.extend_from_slice(&name);
        payload.truncate(length);
        let frame = posebridge_protocol::framing::FrameRef {
            version: WireVersion::V2,
            message_id: if is_named { 251 } else { 29 },
            source: Address::new(1, 1),
            sequence: 0,
            payload: &payload,
            raw: &[],
        };
        let shown = match decode(&frame) {
            Ok(Some(Message::Thermometer { channel, temperature, .. })) => {
                let said = channel.as_str();
                let is_printable = said.bytes().all(|byte| byte.is_ascii_graphic());
                prop_assert!(is_printable && !said.is_empty(), "{said:?}");
                prop_assert_eq!(is_named, said.starts_with("temp"));
                temperature.0
            }
            Ok(other) => {
                prop_assert!(matches!(other, Some(Message::NamedValue(_))));
                prop_assert!(is_named && (length < 12 || !name.starts_with(b"temp")));
                return Ok(());
            }
            Err(error) => {
                prop_assert_eq!(error.message_id(), frame.message_id);
                return Ok(());
            }
        };
        prop_assert!((-273.15..=3_500.0).contains(&shown), "{shown}");
    }

    #[test]
    fn messages_survive_the_wire(message in prop_oneof![own_message(), conversation()]) {
        let (_, decoded) = there_and_back(&message);
        prop_assert_eq!(decoded, message);
    }

    #[test]
    fn coarse_messages_survive_within_their_resolution(message in coarse()) {
        let (bytes, decoded) = there_and_back(&message);
        if let (Some(sent), Some(received)) = (heading_of(&message), heading_of(&decoded)) {
            prop_assert!((sent - received).0.abs() < ANGLE_RESOLUTION_RAD);
        }
        let rounded = with_heading(&message, heading_of(&decoded));
        prop_assert_eq!(&decoded, &rounded);
        // What was decoded says the same bytes again, but for the last bit of a quaternion.
        let (again, _) = there_and_back(&decoded);
        prop_assert_eq!(again.len(), bytes.len());
    }

    #[test]
    fn damage_costs_only_the_frames_that_it_hits(
        place in 0_usize..1_600,
        noise in prop::collection::vec(any::<u8>(), 1..30),
        chunk in 1_usize..300,
    ) {
        let mix = four_message_mix(16);
        let mut damaged = mix.concat();
        let place = place.min(damaged.len() - noise.len());
        damaged[place..place + noise.len()].copy_from_slice(&noise);
        let mut start = 0;
        let mut intact = Vec::new();
        for frame in &mix {
            let end = start + frame.len();
            if damaged[start..end] == frame[..] {
                intact.push(OwnedFramerOutput::Frame(frame.clone()));
            }
            start = end;
        }
        let (found, _) = scan(FramerConfig::default(), &damaged, chunk);
        let whole: Vec<OwnedFramerOutput> = frames(&found)
            .into_iter()
            .filter(|item| matches!(item, OwnedFramerOutput::Frame(_)))
            .collect();
        prop_assert_eq!(whole, intact);
    }

    #[test]
    fn losses_add_up_to_the_distance(steps in prop::collection::vec(1_u8..=128, 1..50)) {
        let mut tracker = SequenceTracker::new();
        let source = Address::new(1, 1);
        let mut sequence = 0_u8;
        tracker.record_number(source, sequence);
        for step in steps {
            sequence = sequence.wrapping_add(step);
            prop_assert_eq!(tracker.record_number(source, sequence), step - 1);
        }
    }
}
