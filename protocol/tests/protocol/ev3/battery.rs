//! The battery: UI_READ of the firmware developer kit; the request is byte for byte that of ev3-dc 0.9.10.2 (`telegrams.rs` has it).

use posebridge_protocol::bricks::ev3::Ev3Settings;
use posebridge_protocol::message::{Battery, Message};
use posebridge_telemetry::{ReceiveError, Timestamp};

use super::session::{Ev3Session, codec, without_gyro};
use crate::support::ev3_double::Ev3Double;
use crate::support::{RecordedEvent, recorded};

const BYTECODES: [u8; 9] = [0x81, 0x01, 0x60, 0x81, 0x02, 0x64, 0x81, 0x12, 0x68];
/// 7.5 V, 0.25 A, 80 per cent.
const VALUES: [u8; 9] = [0, 0, 0xF0, 0x40, 0, 0, 0x80, 0x3E, 80];

fn told(session: &Ev3Session) -> Vec<(i64, Battery)> {
    let batteries = session.events.iter().filter_map(|(at, item)| match item {
        RecordedEvent::Message(Message::BatteryStatus(battery)) => Some((at.as_secs_f64() as i64, *battery)),
        _ => None,
    });
    batteries.collect()
}

/// The events of one reply to the battery's request, in chunks of this size.
fn decode(values: &[u8], chunk: usize) -> Vec<RecordedEvent> {
    let mut brick = Ev3Double::default();
    let mut codec = codec(without_gyro());
    codec.on_link_up(Timestamp::ZERO);
    let first = codec.poll().and_then(|request| brick.answer(Timestamp::ZERO, &request)).expect("it is answered");
    let now = Timestamp::from_millis(2_000);
    codec.push(now, &first, &mut |_| {});
    let request = codec.poll().expect("it asks for the battery");
    assert_eq!(request[7..], BYTECODES);
    let mut reply = vec![3 + values.len() as u8, 0];
    reply.extend_from_slice(&request[2..4]);
    reply.push(0x02);
    reply.extend_from_slice(values);
    let mut events = Vec::new();
    for part in reply.chunks(chunk) {
        codec.push(now, part, &mut |found| events.push(recorded(found)));
    }
    events.retain(|event| !matches!(event, RecordedEvent::Message(Message::Heartbeat(_))));
    events
}

#[test]
fn its_reply_is_read_in_chunks_of_every_size() {
    let battery = Battery { voltage_v: Some(7.5), current_a: Some(0.25), remaining: Some(0.8) };
    for chunk in 1..=14 {
        let expected = [RecordedEvent::Message(Message::BatteryStatus(battery))];
        assert_eq!(decode(&VALUES, chunk), expected, "chunks of {chunk}");
    }
}

#[test]
fn numbers_that_no_battery_has_are_left_out() {
    // No number and 65504 V.
    for volts in [[0, 0, 0xC0, 0x7F], [0, 0xE0, 0x7F, 0x47]] {
        let events = decode(&[&volts[..], &VALUES[4..]].concat(), 14);
        assert_eq!(events, [RecordedEvent::Error(ReceiveError::Payload { message_id: 2 })]);
    }
    // No number of amperes and 255 per cent.
    let events = decode(&[&VALUES[..4], &[0, 0, 0xC0, 0x7F, 0xFF]].concat(), 14);
    let battery = Battery { voltage_v: Some(7.5), ..Battery::default() };
    assert_eq!(events, [RecordedEvent::Message(Message::BatteryStatus(battery))]);
}

#[test]
fn it_is_asked_after_two_seconds_and_then_every_ten_and_costs_one_telegram() {
    for outstanding in [1, 2] {
        let settings = Ev3Settings { outstanding, ..Ev3Settings::default() };
        let session = Ev3Session::run(settings, Ev3Double::default(), 25.0);
        let battery = Battery { voltage_v: Some(7.5), current_a: Some(0.25), remaining: Some(0.8) };
        assert_eq!(told(&session), [2, 12, 22].map(|at| (at, battery)));
        assert!(session.ticks().all(|reading| session.error(reading) == 0));
        assert_eq!(session.source().lost, 0);
    }
}

#[test]
fn a_brick_that_does_not_tell_is_asked_twice_and_loses_nothing_else() {
    let brick = Ev3Double { battery: None, ..Ev3Double::default() };
    let session = Ev3Session::run(Ev3Settings::default(), brick, 60.0);
    assert_eq!(told(&session), []);
    assert_eq!(session.notes(), ["this EV3 does not report the voltage of its battery"]);
    assert_eq!(session.source().lost, 0);
    let states = session.ticks().count();
    // One telegram set the gyro up, two asked for the battery.
    assert!(session.brick.telegrams - 3 - states <= 1, "{} {states}", session.brick.telegrams);
    assert!(session.turns().len() == states);
}
