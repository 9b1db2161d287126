//! Any bytes and any time to the codecs of bricks that speak no MAVLink: they never stick, ask no more than they may, and what they believe
//! is a number.

#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "a body stops at the first thing that must not be"
)]

use posebridge_protocol::bricks::ev3::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroReading, GyroSettings, SensorPort,
};
use posebridge_protocol::bricks::fixes::FixSettings;
use posebridge_protocol::bricks::line::{Checksum, Column, LineLayout, LineSettings, QUANTITIES, Separator};
use posebridge_protocol::bricks::{BrickCodec, BrickSettings, Heard, brick_protocol};
use posebridge_protocol::framing::Framing;
use posebridge_protocol::message::Message;
use posebridge_telemetry::{HostClock, PeerId, Span, Stamp};

use crate::operands::Operands;

/// Most questions of the EV3's codec that may leave at once: four that wait and one that opens the brick.
const MOST_QUESTIONS: usize = 5;
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
    run("ev3", &BrickSettings { ev3: settings, ..BrickSettings::default() }, operands);
}

/// Input: separator, checksum and columns, then operations as above.
pub(crate) fn check_line(data: &[u8]) {
    let mut operands = Operands::new(data);
    let options = operands.byte();
    let separators = [Separator::Comma, Separator::Pipe, Separator::Colon, Separator::Blank];
    let separator = separators[usize::from(options & 3)];
    let which = operands.number();
    let chosen = QUANTITIES.iter().enumerate().filter(|(index, _)| which >> index & 1 == 1);
    let columns: Vec<Column> = chosen.map(|(_, (_, quantity))| Column::of(*quantity)).collect();
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
    let settings = LineSettings {
        layout,
        checksum: if options & 32 == 0 { Checksum::Optional } else { Checksum::Required },
        ..LineSettings::default()
    };
    // A layout that is refused is read all the same: nothing may break by it.
    let _ = settings.check();
    run("line", &BrickSettings { line: settings, ..BrickSettings::default() }, operands);
}

/// Input: framing and quality, then operations as above; odd lengths come from another sender than even ones.
pub(crate) fn check_camera_json(data: &[u8]) {
    let mut operands = Operands::new(data);
    let options = operands.byte();
    let framing = if options & 1 == 0 { Framing::Stream } else { Framing::Datagram };
    let fixes = FixSettings { framing, least_quality: f64::from(options >> 1 & 63), ..FixSettings::default() };
    run("camera-json", &BrickSettings { fixes, ..BrickSettings::default() }, operands);
}

fn run(name: &str, settings: &BrickSettings, mut operands: Operands<'_>) {
    let protocol = brick_protocol(name).expect("there is a row of this name");
    let mut codec = (protocol.open)(settings);
    let mut now = Stamp::ZERO;
    let mut pushed = 0;
    codec.begin(now);
    questions(&mut *codec);
    while !operands.is_empty() {
        let operation = operands.byte();
        if operation < 128 {
            let bytes = operands.part(usize::from(operation));
            pushed += bytes.len() as u64;
            let peer = PeerId(u32::from(operation & 1));
            codec.push_from(now, peer, bytes, &mut believe);
        } else {
            now = now + Span::from_millis(i64::from(operation - 127) * 9);
            let is_due = |due: &Stamp<HostClock>| *due <= now;
            if codec.deadline().as_ref().is_some_and(is_due) {
                codec.tick(now, &mut believe);
                questions(&mut *codec);
                assert!(codec.deadline().is_none_or(|due| due > now), "{name} is stuck");
            }
        }
        questions(&mut *codec);
        let garbage = codec.counters().garbage_bytes;
        assert!(garbage <= pushed, "{garbage} of {pushed} bytes");
    }
    // After a silence nothing is held back any more but what is asked anew.
    for _ in 0..4 {
        now = now + Span::from_millis(5_000);
        codec.tick(now, &mut believe);
        questions(&mut *codec);
    }
    codec.begin(now);
    questions(&mut *codec);
}

fn questions(codec: &mut dyn BrickCodec) {
    let mut questions = 0;
    while let Some(bytes) = codec.poll() {
        questions += 1;
        assert!(!bytes.is_empty());
        assert!(questions <= MOST_QUESTIONS, "{questions} questions at once");
    }
}

/// What is said must be a number that can be.
fn believe(heard: Heard<'_>) {
    match heard {
        Heard::Message { message, .. } => believe_message(&message),
        Heard::Time { peer_nanos, .. } => assert!(peer_nanos >= 0),
        Heard::Note { text, .. } => {
            assert!(text.bytes().all(|byte| matches!(byte, 0x20..=0x7E)), "{text:?}");
        }
        Heard::Defect(_) => {}
        Heard::Other(frame) => panic!("these bricks send no {frame:?}"),
    }
}

fn believe_message(message: &Message) {
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
        other => assert!(matches!(other, Message::WheelTicks(_) | Message::Heartbeat(_)), "{other:?}"),
    }
}
