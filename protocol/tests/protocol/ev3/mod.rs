//! The station and an EV3: what passes between them byte for byte, and what damage, stalls and missing sensors cost.
//!
//! The figures: `cargo test -p posebridge-protocol ev3 -- --nocapture`.

mod battery;
mod session;

use posebridge_protocol::bricks::DEFAULT_BRICK_ADDRESS;
use posebridge_protocol::bricks::ev3::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroMounting, GyroReading, GyroSettings, MotorDirection, SensorPort,
};
use posebridge_protocol::message::{Inertial, Message, PlanarPose, PoseFlags, WheelTicks, WireStamp};
use posebridge_telemetry::{EncoderTicks, Heading, Meters, Pose, Radians, RadiansPerSecond, ReceiveError, Timestamp};
use session::{Ev3Session, ReplyCorruption, TURN_AROUND, codec, without_gyro};

use crate::support::ev3_double::{Ev3Double, FailureMode, PluggedSensor, curve};
use crate::support::{RecordedEvent, estimate, noise, recorded};

#[test]
fn requests_are_those_of_the_firmware_and_replies_are_decoded() {
    let mut codec = codec(Ev3Settings::default());
    codec.on_link_up(Timestamp::ZERO);
    // READY_SI of port 2, type 32, mode 1, one value.
    let set_up = [0x0E, 0x00, 0x01, 0x00, 0x00, 0x04, 0x00, 0x99, 0x1D, 0x00, 0x01, 0x81, 0x20, 0x01, 0x01, 0x60];
    assert_eq!(codec.poll().as_deref(), Some(&set_up[..]));
    assert_eq!(codec.poll(), None);
    let ready = [0x07, 0x00, 0x01, 0x00, 0x02, 0, 0, 0, 0];
    codec.push(Timestamp::from_millis(40), &ready, &mut |_| {});
    // TIMER_READ_US, OUTPUT_GET_COUNT of B and of C, READSI of port 2 as it is.
    let cycle = [
        0x15, 0x00, 0x02, 0x00, 0x00, 0x10, 0x00, 0x8F, 0x60, 0xB3, 0x00, 0x01, 0x64, 0xB3, 0x00, 0x02, 0x68, 0x9D,
        0x00, 0x01, 0x00, 0x3F, 0x6C,
    ];
    assert_eq!(codec.poll().as_deref(), Some(&cycle[..]));
    // 1.0 s, 360, -1, and -90.0 degrees per second clockwise.
    let answer = [
        0x13, 0x00, 0x02, 0x00, 0x02, 0x40, 0x42, 0x0F, 0x00, 0x68, 0x01, 0x00, 0x00, 0xFF, 0xFF, 0xFF, 0xFF, 0x00,
        0x00, 0xB4, 0xC2,
    ];
    let mut events = Vec::new();
    codec.push(Timestamp::from_millis(70), &answer, &mut |found| {
        events.push(recorded(found));
    });
    let stamp = WireStamp::Micros32(1_000_000);
    let expected = [
        RecordedEvent::ClockReply { sent: Timestamp::from_millis(40), peer_nanos: 1_000_000_000 },
        RecordedEvent::Message(Message::WheelTicks(WheelTicks {
            stamp,
            left: EncoderTicks(360),
            right: EncoderTicks(-1),
        })),
        RecordedEvent::Message(Message::Inertial(Inertial {
            stamp,
            turn_rate: Some(RadiansPerSecond(std::f64::consts::FRAC_PI_2)),
            turn: None,
            wheel_accelerations: None,
        })),
    ];
    assert_eq!(events, expected);
}

#[test]
fn one_telegram_a_cycle_as_fast_as_the_link_turns_around() {
    for (outstanding, rate_hz, least, most) in [(1, 50.0, 33.0, 33.4), (2, 50.0, 49.5, 50.1), (1, 10.0, 9.9, 10.1)] {
        let settings = Ev3Settings { outstanding, rate_hz, ..Ev3Settings::default() };
        let session = Ev3Session::run(settings, Ev3Double::default(), 30.0);
        let states = session.ticks().count();
        // One telegram set the gyro up, three asked for the battery, and the last ones are on their way.
        let telegrams = session.brick.telegrams - 4;
        assert!(telegrams - states <= usize::from(outstanding), "{telegrams}");
        let rate = states as f64 / 30.0;
        println!(
            "EV3 at 30 ms turn-around, {outstanding} outstanding, at most {rate_hz} Hz: {rate:.1} full states/s, {:.2} telegrams each",
            telegrams as f64 / states as f64
        );
        assert!((least..=most).contains(&rate), "{rate}");
        assert!(session.ticks().all(|reading| session.error(reading) == 0));
        assert_eq!(session.source().lost, 0);
        assert_eq!(session.notes(), [""; 0]);
    }
}

/// All events of a codec when the replies of a live session come in such chunks.
fn decode_in_chunks(chunk: usize) -> Vec<RecordedEvent> {
    let mailbox = include_bytes!("../../data/ev3_mailbox.bin");
    let mut brick = Ev3Double::default();
    let mut codec = codec(Ev3Settings::default());
    let mut now = Timestamp::ZERO;
    codec.on_link_up(now);
    let mut events = Vec::new();
    for turn in 0..12 {
        let request = codec.poll().expect("it asks");
        let mut bytes = brick.answer(now, &request).expect("it is answered");
        if turn % 3 == 1 {
            bytes = [&mailbox[..], &bytes, b"\xFF\xFF\xFF"].concat();
        }
        now = now + TURN_AROUND;
        for part in bytes.chunks(chunk) {
            codec.push(now, part, &mut |found| events.push(recorded(found)));
        }
    }
    events
}

#[test]
fn chunking_does_not_change_the_events() {
    let sound = |items: Vec<RecordedEvent>| {
        let is_defect = |item: &RecordedEvent| matches!(item, RecordedEvent::Error(_));
        let (defects, sound): (Vec<_>, Vec<_>) = items.into_iter().partition(is_defect);
        let garbage = defects.iter().map(|item| match item {
            RecordedEvent::Error(ReceiveError::UnframedBytes { bytes }) => *bytes,
            other => panic!("{other:?}"),
        });
        (sound, garbage.sum::<u32>())
    };
    let expected = sound(decode_in_chunks(1_000));
    assert_eq!(expected.1, 12);
    for chunk in 1..60 {
        assert_eq!(sound(decode_in_chunks(chunk)), expected, "chunk size {chunk}");
    }
}

#[test]
fn a_lost_an_inserted_or_a_flipped_byte_costs_at_most_one_request() {
    const HIT: usize = 7;
    let (mut cases, mut worst_ms) = (0, 0.0_f64);
    for outstanding in [1, 2] {
        for at in 0..21 {
            let lose = move |mut bytes: Vec<u8>| {
                bytes.remove(at);
                bytes
            };
            let insert = move |mut bytes: Vec<u8>| {
                bytes.insert(at, 0x02);
                bytes
            };
            let flips = (0..8).map(|bit| {
                Box::new(move |mut bytes: Vec<u8>| {
                    bytes[at] ^= 1 << bit;
                    bytes
                }) as ReplyCorruption
            });
            let others: [ReplyCorruption; 2] = [Box::new(lose), Box::new(insert)];
            for (case, spoil) in others.into_iter().chain(flips).enumerate() {
                let settings = Ev3Settings { outstanding, ..Ev3Settings::default() };
                let mut session = Ev3Session::new(settings, Ev3Double::default());
                session.run_until(Timestamp::from_millis(3_000), &|number, bytes| {
                    if number == HIT { spoil(bytes) } else { bytes }
                });
                let name = format!("outstanding {outstanding}, byte {at}, case {case}");
                let lost = session.source().lost;
                let wrong = session.ticks().filter(|reading| session.error(*reading) > 0).count() as u64;
                assert!(lost + wrong <= 1, "{name}: lost {lost}, wrong {wrong}");
                // The clock in particular is never wrong by more than the round trip allows.
                assert!(session.ticks().all(|reading| session.error(reading) < 66), "{name}");
                let times: Vec<_> = session.ticks().map(|(now, _)| now).collect();
                let gaps = times.windows(2).map(|pair| (pair[1] - pair[0]).as_millis_f64());
                worst_ms = worst_ms.max(gaps.fold(0.0, f64::max));
                assert!(times.last().is_some_and(|last| *last > Timestamp::from_millis(2_960)));
                cases += 1;
            }
        }
    }
    println!("{cases} ways to damage one byte: at most one question each, at most {worst_ms:.0} ms without news");
    assert!(worst_ms <= 200.0);
}

#[test]
fn a_stall_is_followed_by_late_answers_and_no_false_motion() {
    let mut session = Ev3Session::new(Ev3Settings::default(), Ev3Double::default());
    session.delay_line.stall = Some((Timestamp::from_millis(5_000), Timestamp::from_millis(7_000)));
    session.run_for(10.0);
    assert!(session.ticks().all(|reading| session.error(reading) == 0));
    // Asked at 5.0, 5.5 and 6.5 s; all three were answered in the end.
    assert_eq!(session.source().lost, 0);
    assert_eq!(session.codec.counters().stalls, 2);
    let lost = session
        .events
        .iter()
        .filter(|(_, item)| matches!(item, RecordedEvent::Error(ReceiveError::SequenceGap { .. })));
    assert_eq!(lost.count(), 2);
    let round_trips = session.events.iter().filter_map(|(now, item)| match item {
        RecordedEvent::ClockReply { sent, .. } => Some((*now - *sent).as_millis_f64()),
        _ => None,
    });
    // That of a late answer would be 2 s.
    let longest_ms = round_trips.fold(0.0, f64::max);
    assert!(longest_ms < 600.0, "{longest_ms}");
}

#[test]
fn a_program_that_starts_sets_the_counters_to_zero_and_moves_nothing() {
    // Half a second of rest around the start of the program at 4 s.
    let counts = |host_s| match host_s {
        ..3.5 => curve(host_s),
        3.5..4.0 => curve(3.5),
        4.0..4.5 => [0; 4],
        _ => {
            let ([_, left, right, _], [_, left0, right0, _]) = (curve(host_s), curve(4.5));
            [0, left - left0, right - right0, 0]
        }
    };
    let brick = Ev3Double { counts, ..Ev3Double::default() };
    let session = Ev3Session::run(Ev3Settings::default(), brick, 8.0);
    let readings: Vec<_> = session.ticks().collect();
    for pair in readings.windows(2) {
        let (before, after) = (pair[0].1, pair[1].1);
        let change = (after.left.0 - before.left.0).max(after.right.0 - before.right.0);
        assert!((0..=20).contains(&change), "{before:?} {after:?}");
    }
    let (now, last) = readings[readings.len() - 1];
    let WireStamp::Micros32(micros) = last.stamp else {
        panic!("{last:?}");
    };
    let [_, left, right, _] = curve(session.brick.host_s(micros, now) - 1.0);
    assert!((last.left.0 - i64::from(left)).abs() <= 2, "{last:?} {left}");
    assert!((last.right.0 - i64::from(right)).abs() <= 2, "{last:?} {right}");
    assert_eq!(session.notes().len(), 1, "{:?}", session.notes());
    assert!(session.notes()[0].contains("counters"), "{:?}", session.notes());
}

#[test]
fn a_missing_sensor_is_reported_by_its_port_and_detected_when_plugged_in() {
    for fails in [FailureMode::ErrorReply, FailureMode::NanValue] {
        let mut brick = Ev3Double { failure: fails, ..Ev3Double::default() };
        let gyro = brick.sensors[1].take();
        let mut session = Ev3Session::run(Ev3Settings::default(), brick, 25.0);
        assert_eq!(session.notes().len(), 1, "{:?}", session.notes());
        assert!(session.notes()[0].contains("port 2"), "{:?}", session.notes());
        assert!(session.ticks().count() > 800);
        assert_eq!(session.turns(), []);
        session.brick.sensors[1] = gyro;
        session.run_for(11.0);
        assert!(session.turns().len() > 30);
        // When it is unplugged again, that is reported again.
        session.brick.sensors[1] = None;
        session.run_for(4.0);
        assert_eq!(session.notes().len(), 2, "{:?}", session.notes());
    }
}

#[test]
fn a_set_up_that_is_never_answered_stops_the_wheels_once_while_they_turn() {
    // It is at rest from 60 s on.
    let brick = Ev3Double {
        failure: FailureMode::NoReply,
        sensors: [None; 4],
        counts: |host_s| curve(host_s.min(60.0)),
        ..Ev3Double::default()
    };
    let mut session = Ev3Session::run(Ev3Settings::default(), brick, 360.0);
    let times_s: Vec<f64> = session.ticks().map(|(now, _)| now.as_secs_f64()).collect();
    let gaps: Vec<f64> = times_s.windows(2).filter(|pair| pair[1] - pair[0] > 1.0).map(|pair| pair[0]).collect();
    println!("first wheels at {:.1} s; none for more than a second from {gaps:.1?} s on", times_s[0]);
    assert!(times_s[0] < 3.2, "{}", times_s[0]);
    // Standing for a second; then 20, 40, 80 and 160 s, with 3 s for each try.
    assert_eq!(gaps.len(), 4, "{gaps:?}");
    assert!((61.0..61.2).contains(&gaps[0]), "{gaps:?}");
    for (at, pair) in gaps.windows(2).enumerate() {
        let expected = 3.0 + 20.0 * f64::from(1 << at);
        assert!((pair[1] - pair[0] - expected).abs() < 0.1, "{gaps:?}");
    }
    assert_eq!(session.notes().len(), 1, "{:?}", session.notes());
    assert!(session.notes()[0].contains("port 2"), "{:?}", session.notes());
    // PluggedSensor in, it is found at the next try.
    session.brick.sensors[1] = Some(plugged(32, [12.0, 0.0]));
    session.run_for(340.0);
    assert!(!session.turns().is_empty());
}

#[test]
fn setting_the_clock_costs_no_motion_and_is_reported() {
    let mut session = Ev3Session::run(without_gyro(), Ev3Double::default(), 5.0);
    session.brick.start_micros += 900_000_000;
    session.run_for(5.0);
    let counts: Vec<_> = session.ticks().map(|(_, ticks)| (ticks.left.0, ticks.right.0)).collect();
    let (first, last) = (counts[0], counts[counts.len() - 1]);
    // 300 and 330 counts per second.
    let seconds = [(last.0 - first.0) as f64 / 300.0, (last.1 - first.1) as f64 / 330.0];
    assert!(seconds.iter().all(|seconds| (9.85..=10.0).contains(seconds)), "{seconds:?}");
    assert_eq!(session.notes().len(), 1, "{:?}", session.notes());
    assert!(session.notes()[0].contains("clock of the EV3 was set"), "{:?}", session.notes());
}

/// A sensor in a mode that is never requested.
const fn plugged(kind: u8, values: [f32; 2]) -> PluggedSensor {
    PluggedSensor { kind, mode: 7, values }
}

/// Everything that can be set, at other ports than usual.
fn all_else() -> Ev3Settings {
    Ev3Settings {
        motors: MotorDirection::Backward,
        gyro: Some(GyroSettings {
            port: SensorPort::P3,
            reading: GyroReading::RateAndAngle,
            mounting: GyroMounting::UpsideDown,
        }),
        distance: Some(DistanceSettings { port: SensorPort::P4, kind: DistanceKind::Ultrasonic }),
        ..Ev3Settings::default()
    }
}

#[test]
fn rate_and_angle_distance_and_motors_built_in_backward_are_read_as_they_are_set() {
    let brick = Ev3Double {
        sensors: [None, None, Some(plugged(32, [100.0, 45.0])), Some(plugged(30, [37.5, 0.0]))],
        ..Ev3Double::default()
    };
    let mut session = Ev3Session::run(all_else(), brick, 0.12);
    let modes = session.brick.sensors.map(|sensor| sensor.map(|sensor| sensor.mode));
    assert_eq!(modes[2..], [Some(3), Some(0)]);
    session.brick.sensors[2] = Some(plugged(32, [101.0, 45.0]));
    session.brick.sensors[3] = Some(plugged(30, [255.0, 0.0]));
    session.run_for(0.06);
    let stamps: Vec<_> = session.ticks().map(|(_, ticks)| ticks.stamp).collect();
    let rate = Some(RadiansPerSecond(45.0_f64.to_radians()));
    let turned = |deg: f64| (rate, Some(Radians(deg.to_radians())));
    let turns = session.turns();
    assert_eq!(turns[0], turned(0.0));
    assert_eq!(turns[turns.len() - 1], turned(1.0));
    let ranges = session.events.iter().filter_map(|(_, item)| match item {
        RecordedEvent::Message(Message::DistanceSensor { stamp, range, .. }) => Some((*stamp, *range)),
        _ => None,
    });
    let ranges: Vec<_> = ranges.collect();
    // None where nothing was in sight.
    assert!(ranges.len() < stamps.len());
    assert_eq!(ranges[0], (stamps[0], Meters(0.375)));
    assert!(session.ticks().all(|(_, ticks)| ticks.left.0 < 0 && ticks.right.0 < 0));
}

#[test]
fn the_estimate_goes_to_the_mailbox() {
    let mut codec = codec(without_gyro());
    let pose = Pose::new(Meters(1.0), Meters(-2.0), Heading::from_rad(0.5));
    let flags = PoseFlags { position_valid: true, ..PoseFlags::default() };
    let pose = estimate(66_051_999, pose, [0.0625, 0.0, 0.0, 0.015_625, 0.0, 1.0], flags);
    let mut bytes = Vec::new();
    let message = Message::PlanarPose(pose);
    assert_eq!(codec.encode(Timestamp::ZERO, DEFAULT_BRICK_ADDRESS, &message, &mut bytes), 0);
    codec.on_link_up(Timestamp::ZERO);
    codec.poll();
    for _ in 0..2 {
        bytes.clear();
        assert_eq!(codec.encode(Timestamp::ZERO, DEFAULT_BRICK_ADDRESS, &message, &mut bytes), 42);
    }
    // Length 40, counter 3, then tick 66051 ms, 1.0, -2.0, 0.5, 0.25, flags 1, reset counter 9, sequence 1.
    let mut expected = vec![40, 0, 3, 0, 0x81, 0x9E, 9];
    expected.extend(b"estimate\0");
    expected.extend([24, 0, 0x03, 0x02, 0x01, 0x00, 0, 0, 0x80, 0x3F, 0, 0, 0x00, 0xC0]);
    expected.extend([0, 0, 0x00, 0x3F, 0, 0, 0x80, 0x3E, 1, 9, 1, 0]);
    assert_eq!(bytes, expected);
    let lost = Message::PlanarPose(PlanarPose { covariance: [f64::NAN; 6], ..pose });
    assert_eq!(codec.encode(Timestamp::ZERO, DEFAULT_BRICK_ADDRESS, &lost, &mut bytes), 0);
}

#[test]
fn noise_between_replies_is_never_accepted_and_the_session_goes_on() {
    let lengths = noise(6, 400);
    let noise: Vec<Vec<u8>> = (0..).zip(lengths).map(|(seed, length)| noise(seed, usize::from(length % 40))).collect();
    let mut session = Ev3Session::new(Ev3Settings::default(), Ev3Double::default());
    session.run_until(Timestamp::from_millis(30_000), &|number, bytes| {
        let noise = &noise[number % noise.len()];
        match number % 4 {
            0 => [noise, &bytes[..]].concat(),
            1 => [&bytes[..], noise].concat(),
            2 => noise.clone(),
            _ => bytes,
        }
    });
    assert!(session.ticks().all(|reading| session.error(reading) == 0));
    let count = session.ticks().count();
    println!("EV3 with noise around half of the answers and in the place of a quarter: {count} states in 30 s");
    assert!(count > 300, "{count}");
}
