//! Every brick protocol behaves like one.

use posebridge_protocol::bricks::{BRICK_PROTOCOLS, BrickCodec, CodecEvent, CodecSettings, brick_protocol};
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks, Meters, MetersPerSecond, ReceiveError, TimeDelta, Timestamp};

use crate::support::{ROBOT, codec, noise};

fn ticks(count: i64) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(count as u32 * 50_000),
        left: EncoderTicks(count),
        right: EncoderTicks(-count),
    })
}

fn mavlink() -> Box<dyn BrickCodec> {
    codec("mavlink", &CodecSettings::default())
}

/// A received message, or the text of anything else; other frames by their bytes.
fn noted(event: CodecEvent<'_>) -> Result<(Address, Message), String> {
    match event {
        CodecEvent::Message { from, message } => Ok((from, message)),
        CodecEvent::ForwardFrame(frame) => Err(format!("other {:?}", frame.raw)),
        CodecEvent::ClockReply { from, .. } => Err(format!("time of {from}")),
        CodecEvent::StatusText { text, .. } => Err(text),
        CodecEvent::Error(defect) => Err(format!("{defect:?}")),
    }
}

#[test]
fn every_protocol_is_found_by_its_name() {
    for protocol in BRICK_PROTOCOLS {
        let found = brick_protocol(protocol.name).map(|found| found.name);
        assert_eq!(found, Some(protocol.name));
        assert_eq!(protocol.name, protocol.name.to_lowercase());
        assert!(!protocol.summary.is_empty(), "{}", protocol.name);
    }
    assert!(brick_protocol("carrier pigeon").is_none());
}

#[test]
fn noise_yields_no_message_in_any_protocol_and_leaves_none_stuck() {
    let noise = noise(2_026, 4_000);
    for protocol in BRICK_PROTOCOLS {
        for chunk in [1, 7, 64, 4_000] {
            let mut codec = (protocol.open)(&CodecSettings::default());
            let mut now = Timestamp::ZERO;
            let mut messages = 0;
            codec.on_link_up(now);
            for part in noise.chunks(chunk) {
                now = now + TimeDelta::from_millis(1);
                let mut count = |item: CodecEvent<'_>| messages += u32::from(noted(item).is_ok());
                codec.push(now, part, &mut count);
                while codec.deadline().is_some_and(|due| due <= now) {
                    codec.tick(now, &mut count);
                    now = now + TimeDelta::from_millis(1);
                }
                while codec.poll().is_some() {}
            }
            assert_eq!(messages, 0, "{} in chunks of {chunk}", protocol.name);
            // The link comes back, and all is as it was.
            codec.on_link_up(now);
            assert!(codec.deadline().is_none_or(|due| due >= now), "{}", protocol.name);
        }
    }
}

#[test]
fn mavlink_reports_lost_frames_and_senseless_payloads() {
    let mut sender = mavlink();
    let mut receiver = mavlink();
    let mut events = Vec::new();
    for count in 0..4 {
        let mut bytes = Vec::new();
        sender.encode(Timestamp::ZERO, ROBOT, &ticks(count), &mut bytes);
        if count != 1 && count != 2 {
            receiver.push(Timestamp::ZERO, &bytes, &mut |item| events.push(noted(item)));
        }
    }
    let lost = ReceiveError::SequenceGap { source: ROBOT, frames: 2 };
    let expected = [Ok((ROBOT, ticks(0))), Err(format!("{lost:?}")), Ok((ROBOT, ticks(3)))];
    assert_eq!(events, expected);

    events.clear();
    let nowhere = Message::LocalPosition {
        stamp: WireStamp::Millis32(0),
        x: Meters(f64::NAN),
        y: Meters(0.0),
        x_speed: MetersPerSecond(0.0),
        y_speed: MetersPerSecond(0.0),
    };
    let mut bytes = Vec::new();
    sender.encode(Timestamp::ZERO, ROBOT, &nowhere, &mut bytes);
    receiver.push(Timestamp::ZERO, &bytes, &mut |item| events.push(noted(item)));
    let senseless = ReceiveError::Payload { message_id: 32 };
    assert_eq!(events, [Err(format!("{senseless:?}"))]);
}
