//! Any bytes at any time to the codecs of bricks without MAVLink: they make progress, keep their limits of requests, and decode only
//! finite numbers. Any bytes to a brick: an accepted estimate is finite, and the station understands every reply.

#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "a body stops at the first thing that must not be"
)]

use posebridge_brick::{Link, Received, Receiver};
use posebridge_protocol::bricks::camera_json::CameraJsonSettings;
use posebridge_protocol::bricks::ev3::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroReading, GyroSettings, SensorPort,
};
use posebridge_protocol::bricks::nxt::{MaxOutstanding, NxtSensor, NxtSettings};
use posebridge_protocol::bricks::text_line::{
    ChecksumPolicy, Column, LineLayout, QUANTITIES, Separator, TextLineSettings,
};
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings, brick_protocol};
use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{HostClock, PeerId, TimeDelta, Timestamp};

use crate::operands::Operands;

/// Most questions of the EV3's codec that may leave at once: four that wait and one that opens the brick.
const MAX_REQUESTS: usize = 5;
/// No gyro turns faster, rad/s.
const FASTEST_RAD_PER_S: f64 = 100.0;

/// Input: options, then operations: a length below 128 and so many bytes that arrive, or above that time that passes.
pub(crate) fn check_ev3(data: &[u8]) {
    let mut operands = Operands::new(data);
    let options = operands.byte();
    let gyro = GyroSettings {
        reading: if options & 4 == 0 { GyroReading::Rate } else { GyroReading::RateAndAngle },
        ..GyroSettings::default()
    };
    let settings = Ev3Settings {
        outstanding: options & 3,
        gyro: (options & 8 == 0).then_some(gyro),
        distance: (options & 16 != 0)
            .then_some(DistanceSettings { port: SensorPort::P4, kind: DistanceKind::Infrared }),
        ..Ev3Settings::default()
    };
    run("ev3", &CodecSettings { ev3: settings, ..CodecSettings::default() }, operands);
}

/// Input: separator, checksum and columns, then operations as above.
pub(crate) fn check_line(data: &[u8]) {
    let mut operands = Operands::new(data);
    let options = operands.byte();
    let separators = [Separator::Comma, Separator::Pipe, Separator::Colon, Separator::Blank];
    let separator = separators[usize::from(options & 3)];
    let which = operands.number();
    let chosen = QUANTITIES.iter().enumerate().filter(|(index, _)| which >> index & 1 == 1);
    let columns: Vec<Column> = chosen.map(|(_, (_, quantity))| Column::new(*quantity)).collect();
    let layout = if options & 4 == 0 {
        LineLayout::Columns { columns, separator }
    } else {
        let keys = ["t", "l", "r", "g", "d", "c"].iter().zip(columns);
        LineLayout::Pairs {
            keys: keys.map(|(key, column)| ((*key).to_owned(), column)).collect(),
            separator,
            key_separator: separators[usize::from(options >> 3 & 3)],
        }
    };
    let settings = TextLineSettings {
        layout,
        checksum: if options & 32 == 0 { ChecksumPolicy::Optional } else { ChecksumPolicy::Required },
        ..TextLineSettings::default()
    };
    // A layout that is refused is read all the same: nothing may break by it.
    let _ = settings.validate();
    let name = if options & 64 == 0 { "line" } else { "columns" };
    run(name, &CodecSettings { line: settings, ..CodecSettings::default() }, operands);
}

/// Input: framing and quality, then operations as above; odd lengths come from another sender than even ones.
pub(crate) fn check_camera_json(data: &[u8]) {
    let mut operands = Operands::new(data);
    let options = operands.byte();
    let framing = if options & 1 == 0 { TransportKind::Stream } else { TransportKind::Datagram };
    let fixes =
        CameraJsonSettings { framing, min_quality: f64::from(options >> 1 & 63), ..CameraJsonSettings::default() };
    run("camera-json", &CodecSettings { fixes, ..CodecSettings::default() }, operands);
}

fn run(name: &str, settings: &CodecSettings, mut operands: Operands<'_>) {
    let protocol = brick_protocol(name).expect("there is a row of this name");
    let mut codec = (protocol.open)(settings);
    let mut now = Timestamp::ZERO;
    let mut pushed = 0;
    codec.on_link_up(now);
    drain_requests(&mut *codec);
    while !operands.is_empty() {
        let operation = operands.byte();
        if operation < 128 {
            let bytes = operands.take_up_to(usize::from(operation));
            pushed += bytes.len() as u64;
            let peer = PeerId(u32::from(operation & 1));
            codec.push_from_peer(now, peer, bytes, &mut check_event);
        } else {
            now = now + TimeDelta::from_millis(i64::from(operation - 127) * 9);
            let is_due = |due: &Timestamp<HostClock>| *due <= now;
            if codec.deadline().as_ref().is_some_and(is_due) {
                codec.tick(now, &mut check_event);
                drain_requests(&mut *codec);
                assert!(codec.deadline().is_none_or(|due| due > now), "{name} is stuck");
            }
        }
        drain_requests(&mut *codec);
        let garbage = codec.counters().garbage_bytes;
        assert!(garbage <= pushed, "{garbage} of {pushed} bytes");
    }
    // After a silence nothing is held back any more but what is asked anew.
    for _ in 0..4 {
        now = now + TimeDelta::from_millis(5_000);
        codec.tick(now, &mut check_event);
        drain_requests(&mut *codec);
    }
    codec.on_link_up(now);
    drain_requests(&mut *codec);
}

fn drain_requests(codec: &mut dyn BrickCodec) {
    let mut questions = 0;
    while let Some(bytes) = codec.poll() {
        questions += 1;
        assert!(!bytes.is_empty());
        assert!(questions <= MAX_REQUESTS, "{questions} questions at once");
    }
}

/// What is said must be a number that can be.
fn check_event(heard: CodecEvent<'_>) {
    match heard {
        CodecEvent::Message { message, .. } => check_message(&message),
        CodecEvent::ClockReply { peer_nanos, .. } => assert!(peer_nanos >= 0),
        CodecEvent::StatusText { text, .. } => {
            assert!(text.bytes().all(|byte| matches!(byte, 0x20..=0x7E)), "{text:?}");
        }
        CodecEvent::Error(_) => {}
        CodecEvent::ForwardFrame(frame) => panic!("these bricks send no {frame:?}"),
    }
}

fn check_message(message: &Message) {
    match message {
        Message::Inertial(inertial) => {
            let rate = inertial.turn_rate.expect("a gyro says a rate");
            assert!(rate.0.abs() <= FASTEST_RAD_PER_S, "{rate:?}");
            assert!(inertial.turn.is_none_or(|turn| turn.0.is_finite()));
        }
        Message::DistanceSensor { range, .. } => {
            assert!((0.0..=1_000.0).contains(&range.0), "{range:?}");
        }
        Message::Thermometer { temperature, .. } => {
            assert!((-273.15..=3_500.0).contains(&temperature.0), "{temperature:?}");
        }
        Message::VisionPosition(fix) => {
            assert!(fix.x.0.abs() <= 1e5 && fix.y.0.abs() <= 1e5, "{fix:?}");
            let is_variance = |variance: f64| variance >= 0.0;
            assert!(
                fix.covariance.is_none_or(|[xx, _, yy, hh]| { is_variance(xx) && is_variance(yy) && is_variance(hh) }),
                "{fix:?}"
            );
        }
        Message::TimeSync(sync) => assert!(sync.answer_nanos > 0, "{sync:?}"),
        Message::BatteryStatus(battery) => {
            assert!(battery.voltage_v.is_none_or(|volts| (0.0..=65.0).contains(&volts)), "{battery:?}");
        }
        other => assert!(matches!(other, Message::WheelTicks(_) | Message::Heartbeat(_)), "{other:?}"),
    }
}

/// Telegrams that may leave at once: two questions, each with one in front.
const MAX_TELEGRAMS: usize = 4;

/// Input: row and settings, then steps of a wait in milliseconds, a length, and so many bytes.
pub(crate) fn check_nxt(data: &[u8]) {
    let mut operands = Operands::new(data);
    let choice = operands.byte();
    let is_pushed = choice & 1 == 1;
    let row = if is_pushed { "nxt-push" } else { "nxt" };
    let Some(protocol) = brick_protocol(row) else {
        return;
    };
    let mut codec = (protocol.open)(&nxt_settings(choice));
    let mut now = Timestamp::ZERO;
    codec.on_link_up(now);
    loop {
        let mut telegrams = 0;
        while codec.poll().is_some() {
            telegrams += 1;
            assert!(telegrams <= MAX_TELEGRAMS, "{telegrams} telegrams at once");
        }
        // A program that answers no commands is left alone, and waited for until it has been silent for two seconds.
        match codec.deadline() {
            Some(due) => assert!(due > now, "due at {due:?}, and it is {now:?}"),
            None => assert!(is_pushed, "nothing to wait for"),
        }
        if operands.is_empty() {
            break;
        }
        now = now + TimeDelta::from_millis(i64::from(operands.byte()));
        let length = usize::from(operands.byte());
        let mut texts = 0;
        let mut sink = |heard: CodecEvent<'_>| texts += usize::from(matches!(heard, CodecEvent::StatusText { .. }));
        codec.push(now, operands.take_up_to(length), &mut sink);
        codec.tick(now, &mut sink);
        assert!(texts <= 300, "{texts} lines at once");
    }
}

fn nxt_settings(choice: u8) -> CodecSettings {
    let is = |bit: u8| choice & (1 << bit) != 0;
    CodecSettings {
        nxt: NxtSettings {
            sensors: [NxtSensor::HtGyro, NxtSensor::HtCompass, NxtSensor::Ultrasonic, NxtSensor::Temperature],
            outstanding: if is(1) { MaxOutstanding::Two } else { MaxOutstanding::One },
            ..NxtSettings::default()
        },
        ..CodecSettings::default()
    }
}

/// The shortest frame: one byte of payload.
const MIN_ANSWER_BYTES: usize = 13;

/// Input: the bytes of a link.
pub(crate) fn check_brick(data: &[u8]) {
    let (mut receiver, mut link) = (Receiver::new(), Link::new(1, 1));
    let mut frames = 0;
    for byte in data {
        receiver.push(*byte);
        while let Some(received) = receiver.poll() {
            frames += 1;
            match received {
                Received::Pose(pose) => {
                    let numbers = [pose.x_m, pose.y_m, pose.heading_rad];
                    assert!(numbers.iter().chain(&pose.covariance).all(|x| x.is_finite()));
                }
                Received::TimeRequest(request) => {
                    link.answer_time(&request, 7, &mut |answer: &[u8]| assert_answer(answer));
                }
            }
        }
    }
    assert!(frames * MIN_ANSWER_BYTES <= data.len(), "{frames} frames");
}

/// The answer is one frame, and in it the brick's 7 microseconds.
fn assert_answer(answer: &[u8]) {
    let mut answers = 0;
    let mut take = |found: FramerOutput<'_>| {
        if let FramerOutput::Frame(frame) = found {
            assert_eq!(frame.raw, answer);
            let message = decode(&frame).ok().flatten();
            assert!(matches!(message, Some(Message::TimeSync(sync)) if sync.answer_nanos == 7_000), "{message:?}");
            answers += 1;
        }
    };
    let mut framer = Framer::new(FramerConfig::default());
    framer.push(Timestamp::ZERO, answer, &mut take);
    framer.finish(&mut take);
    assert_eq!(answers, 1);
}
