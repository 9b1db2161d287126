//! Every brick protocol behaves like one.

use posebridge_protocol::bricks::{BRICKS, Heard, brick_protocol};
use posebridge_protocol::framing::ScannerConfig;
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, Defect, EncoderTicks, Span, Stamp};

const ROBOT: Address = Address::new(1, 1);

fn ticks(count: i64) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(count as u32 * 50_000),
        left: EncoderTicks(count),
        right: EncoderTicks(-count),
    })
}

/// What was heard, with other frames by their bytes.
fn noted(heard: Heard<'_>) -> Result<(Address, Message), String> {
    match heard {
        Heard::Message { from, message } => Ok((from, message)),
        Heard::Other(frame) => Err(format!("other {:?}", frame.raw)),
        Heard::Defect(defect) => Err(format!("{defect:?}")),
    }
}

#[test]
fn every_protocol_is_found_by_its_name() {
    for protocol in BRICKS {
        let found = brick_protocol(protocol.name).map(|found| found.name);
        assert_eq!(found, Some(protocol.name));
        assert_eq!(protocol.name, protocol.name.to_lowercase());
        assert!(!protocol.summary.is_empty(), "{}", protocol.name);
    }
    assert!(brick_protocol("carrier pigeon").is_none());
}

#[test]
fn every_protocol_hears_what_it_says_in_any_chunks() {
    for protocol in BRICKS {
        let mut speaker = (protocol.open)(ScannerConfig::default());
        let mut bytes = Vec::new();
        for count in 0..5 {
            assert!(speaker.encode(ROBOT, &ticks(count), &mut bytes) > 0);
        }
        let expected: Vec<_> = (0..5).map(|count| Ok((ROBOT, ticks(count)))).collect();
        for chunk in 1..=bytes.len() {
            let mut listener = (protocol.open)(ScannerConfig::default());
            let mut heard = Vec::new();
            for part in bytes.chunks(chunk) {
                listener.push(Stamp::ZERO, part, &mut |item| heard.push(noted(item)));
            }
            assert_eq!(heard, expected, "{}, chunk size {chunk}", protocol.name);
            assert_eq!(listener.deadline(), None);
        }
    }
}

#[test]
fn every_protocol_gives_up_a_torn_message() {
    for protocol in BRICKS {
        let mut codec = (protocol.open)(ScannerConfig::default());
        let mut bytes = Vec::new();
        codec.encode(ROBOT, &ticks(1), &mut bytes);
        let torn = &bytes[..bytes.len() - 1];
        let mut heard = Vec::new();
        codec.push(Stamp::ZERO, torn, &mut |item| heard.push(noted(item)));
        assert!(heard.is_empty(), "{}", protocol.name);
        let deadline = codec.deadline().unwrap();
        codec.tick(deadline + Span::from_millis(1), &mut |item| {
            heard.push(noted(item));
        });
        assert_eq!(codec.deadline(), None, "{}", protocol.name);
        assert!(heard.iter().all(Result::is_err), "{heard:?}");
    }
}

#[test]
fn mavlink_reports_lost_frames_and_senseless_payloads() {
    let mavlink = brick_protocol("mavlink").unwrap();
    let mut speaker = (mavlink.open)(ScannerConfig::default());
    let mut listener = (mavlink.open)(ScannerConfig::default());
    let mut heard = Vec::new();
    for count in 0..4 {
        let mut bytes = Vec::new();
        speaker.encode(ROBOT, &ticks(count), &mut bytes);
        if count != 1 && count != 2 {
            listener.push(Stamp::ZERO, &bytes, &mut |item| heard.push(noted(item)));
        }
    }
    let lost = Defect::Lost {
        source: ROBOT,
        frames: 2,
    };
    let expected = [
        Ok((ROBOT, ticks(0))),
        Err(format!("{lost:?}")),
        Ok((ROBOT, ticks(3))),
    ];
    assert_eq!(heard, expected);

    heard.clear();
    let nowhere = Message::LocalPosition {
        stamp: WireStamp::Millis32(0),
        x: posebridge_telemetry::Meters(f64::NAN),
        y: posebridge_telemetry::Meters(0.0),
        x_speed: posebridge_telemetry::MetersPerSecond(0.0),
        y_speed: posebridge_telemetry::MetersPerSecond(0.0),
    };
    let mut bytes = Vec::new();
    speaker.encode(ROBOT, &nowhere, &mut bytes);
    listener.push(Stamp::ZERO, &bytes, &mut |item| heard.push(noted(item)));
    let senseless = Defect::Payload { message_id: 32 };
    assert_eq!(heard, [Err(format!("{senseless:?}"))]);
}
