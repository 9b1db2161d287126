//! Cameras with JSON lines: lines as Python's json module writes them, every chunk size, every lost byte, and what goes back.

use posebridge_protocol::bricks::camera_json::CameraJsonSettings;
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::framing::TransportKind;
use posebridge_protocol::message::{CommandLong, Message, TimeSync, VisionFix, WireStamp};
use posebridge_telemetry::{Address, HostClock, PeerId, ReceiveError, Recipients, TimeDelta, Timestamp};
use serde_json::Value;

use crate::support::{CAMERA, STATION, at};

const SECOND: Address = Address::new(1, 101);

/// Lines written by Python's json module, with what they mean beside them; see tests/data/camera_json/make.py.
const GOLDEN: &str = include_str!("../data/camera_json/lines.jsonl");
const MEANINGS: &str = include_str!("../data/camera_json/meanings.json");

fn codec(framing: TransportKind) -> Box<dyn BrickCodec> {
    let fixes = CameraJsonSettings { framing, ..CameraJsonSettings::default() };
    let mut codec = crate::support::codec("camera-json", &CodecSettings { fixes, ..CodecSettings::default() });
    codec.on_link_up(Timestamp::ZERO);
    codec
}

/// An event in short; none for heartbeats.
fn short(event: CodecEvent<'_>) -> Option<String> {
    Some(match event {
        CodecEvent::Message { from, message } => match message {
            Message::Heartbeat(heartbeat) => {
                assert_eq!(heartbeat.vehicle_type, 30);
                return None;
            }
            Message::VisionPosition(fix) => format!("{from}: {}", fix_text(&fix)),
            Message::TimeSync(sync) => {
                format!("{from}: answer {} {}", sync.request_nanos, sync.answer_nanos)
            }
            other => panic!("{other:?}"),
        },
        CodecEvent::StatusText { text, .. } => format!("note: {text}"),
        CodecEvent::Error(ReceiveError::UnframedBytes { bytes }) => format!("garbage: {bytes}"),
        CodecEvent::Error(ReceiveError::Payload { .. }) => "no sense".to_owned(),
        other => panic!("{other:?}"),
    })
}

fn fix_text(fix: &VisionFix) -> String {
    let stamp = match fix.stamp {
        WireStamp::Micros64(micros) => format!("{micros} us"),
        WireStamp::HostInterval { sent, answered } => {
            format!("{}..{} us", sent.as_micros(), answered.as_micros())
        }
        WireStamp::Micros32(_) | WireStamp::Millis32(_) => panic!("{:?}", fix.stamp),
    };
    let heading = fix.heading.map_or("-".to_owned(), |heading| format!("{:.6}", heading.rad()));
    let sigmas = fix.covariance.map_or("-".to_owned(), |[xx, _, _, hh]| format!("{:.6} {:.6}", xx.sqrt(), hh.sqrt()));
    format!("{stamp} {:.6} {:.6} {heading} {sigmas} {}", fix.x.0, fix.y.0, fix.reset_counter)
}

fn decode_in_chunks(bytes: &[u8], chunk: usize) -> Vec<String> {
    let mut codec = codec(TransportKind::Stream);
    let mut events = Vec::new();
    for part in bytes.chunks(chunk) {
        let now = Timestamp::from_millis(10_000);
        codec.push(now, part, &mut |item| events.extend(short(item)));
    }
    events
}

fn decode_from(codec: &mut dyn BrickCodec, now: Timestamp<HostClock>, peer: u32, text: &str) -> Vec<String> {
    let mut events = Vec::new();
    codec.push_from_peer(now, PeerId(peer), text.as_bytes(), &mut |item| {
        events.extend(short(item));
    });
    events
}

/// The meanings of the golden lines, as a list of texts like those of [`short`].
fn meanings() -> Vec<String> {
    let meanings: Vec<String> = serde_json::from_str(MEANINGS).expect("it is a list of texts");
    assert_eq!(meanings.len(), GOLDEN.lines().count());
    meanings
}

#[test]
fn what_python_writes_is_understood_in_every_chunk_size() {
    let events = decode_in_chunks(GOLDEN.as_bytes(), GOLDEN.len());
    let (notes, fixes): (Vec<_>, Vec<_>) = events.iter().cloned().partition(|text| text.starts_with("note: "));
    assert_eq!(fixes, meanings());
    assert_eq!(
        notes,
        [
            "note: camera `camera` is 1/100 here",
            "note: camera `north` is 1/101 here",
            "note: the camera's `id` is not used",
            "note: the camera's `n..m.` is not used",
        ]
    );
    for chunk in 1..=GOLDEN.len() {
        assert_eq!(decode_in_chunks(GOLDEN.as_bytes(), chunk), events, "{chunk}");
    }
}

#[test]
fn a_datagram_ends_its_last_line_and_a_stream_does_not() {
    let line = "{\"x_m\": 1, \"y_m\": 2}";
    let two = format!("{line}\r\n{line}");
    for (framing, count) in [(TransportKind::Datagram, 2), (TransportKind::Stream, 1)] {
        let mut codec = codec(framing);
        let events = decode_from(&mut *codec, Timestamp::ZERO, 0, &two);
        let fixes = events.iter().filter(|text| text.starts_with("1/100"));
        assert_eq!(fixes.count(), count, "{framing:?}");
    }
}

#[test]
fn senders_of_one_link_do_not_mix_their_lines() {
    let mut codec = codec(TransportKind::Stream);
    let now = Timestamp::ZERO;
    assert!(decode_from(&mut *codec, now, 1, "{\"camera\": \"a\", \"x_m\": 1, ").is_empty());
    let other = decode_from(&mut *codec, now, 2, "{\"camera\": \"b\", \"x_m\": 5, \"y_m\": 5}\n");
    assert!(other[1].starts_with("1/100: "), "{other:?}");
    let rest = decode_from(&mut *codec, now, 1, "\"y_m\": 2}\n");
    assert!(rest[1].starts_with("1/101: "), "{rest:?}");
}

#[test]
fn a_lost_byte_costs_one_line_or_two_where_it_was_the_end_of_one() {
    let line = |k: usize| format!("{{\"exposed_us\": {}, \"x_m\": {k}, \"y_m\": 0}}\n", 1_000 * k);
    let lines: Vec<String> = (1..=3).map(line).collect();
    let complete = lines.concat().into_bytes();
    let fixes = |bytes: &[u8]| {
        let events = decode_in_chunks(bytes, bytes.len());
        let is_fix = |text: &String| text.starts_with("1/100: ");
        events.into_iter().filter(is_fix).collect::<Vec<_>>()
    };
    let all = fixes(&complete);
    let mut fewest = all.len();
    for lost in 0..complete.len() {
        let mut bytes = complete.clone();
        let was_end = bytes.remove(lost) == b'\n';
        let remaining = fixes(&bytes);
        let same = all.iter().filter(|text| remaining.contains(text)).count();
        let least = if was_end { 1 } else { 2 };
        assert!(same >= least, "byte {lost}: {remaining:?}");
        fewest = fewest.min(same);
    }
    assert_eq!(fewest, 1, "two lines that ran together are none");
}

#[test]
fn a_bad_line_is_answered_to_its_sender_with_line_and_key_once_a_second() {
    let mut codec = codec(TransportKind::Datagram);
    let good = "{\"x_m\": 1, \"y_m\": 2}\n";
    decode_from(&mut *codec, at(0), 7, good);
    let bad = decode_from(&mut *codec, at(10), 7, "{\"x_m\": 1}\n");
    assert_eq!(bad[0], "no sense");
    assert!(bad[1].contains("`y_m` is missing"), "{bad:?}");
    for k in 0..5 {
        decode_from(&mut *codec, at(20 + k), 7, "{\"x_m\": NaN, \"y_m\": 0}\n");
    }
    decode_from(&mut *codec, at(30), 8, "nonsense\n");
    decode_from(&mut *codec, at(1_010), 7, "{\"x_m\": 1, \"y_m\": 2, \"sigma_m\": -1}\n");
    let mut answers = Vec::new();
    while let Some((to, bytes)) = codec.poll_addressed() {
        let Recipients::Peer(PeerId(peer)) = to else {
            panic!("{to:?}");
        };
        assert_eq!(bytes.last(), Some(&b'\n'));
        let reply: Value = serde_json::from_slice(&bytes).unwrap();
        answers.push((peer, reply));
    }
    let [(7, first), (8, second), (7, third)] = &answers[..] else {
        panic!("{answers:?}");
    };
    assert_eq!((&first["key"], &first["line"]), (&"y_m".into(), &2.into()));
    assert_eq!(second["line"], 1);
    assert!(second["error"].as_str().unwrap().contains("from byte"));
    assert_eq!((&third["key"], &third["unsaid"]), (&"sigma_m".into(), &5.into()));
    let counts = codec.counters();
    assert_eq!((counts.frames, counts.garbage_bytes), (1, 5 * 22 + 8));
}

#[test]
fn a_number_out_of_range_is_answered_with_the_range_in_its_own_unit() {
    for (rest, expected) in [
        ("\"sigma_m\": 1e-300", "`sigma_m` is 1e-300, must lie between 1e-6 and 1000.0"),
        ("\"sigma_m\": 0.0000009", "must lie between 1e-6 and 1000.0"),
        ("\"sigma_m\": 0.01, \"heading_deg\": 0, \"sigma_heading_deg\": 0.00005", "must lie between 5.7295779"),
        ("\"sigma_m\": 0.01, \"heading_rad\": 0, \"sigma_heading_rad\": 1e-200", "must lie between 1e-6 and 1000.0"),
        ("\"heading_deg\": -1e8", "must lie between -57295779.5"),
    ] {
        let mut codec = codec(TransportKind::Datagram);
        let line = format!("{{\"x_m\": 1, \"y_m\": 2, {rest}}}\n");
        let events = decode_from(&mut *codec, Timestamp::ZERO, 7, &line);
        assert_eq!(events[0], "no sense", "{line}");
        assert!(events[1].contains(expected), "{line}: {events:?}");
    }
    let mut codec = codec(TransportKind::Datagram);
    let far = "{\"x_m\": 1, \"y_m\": 2, \"heading_deg\": -2e6, \"sigma_m\": 1e-6, \"sigma_heading_rad\": 1e-6}\n";
    let events = decode_from(&mut *codec, Timestamp::ZERO, 7, far);
    assert!(!events.contains(&"no sense".to_owned()), "{events:?}");
}

#[test]
fn a_line_without_end_fills_no_memory_and_costs_only_itself() {
    let mut codec = codec(TransportKind::Stream);
    let mut events = Vec::new();
    for _ in 0..100 {
        events.extend(decode_from(&mut *codec, Timestamp::ZERO, 0, &"[".repeat(1_000)));
    }
    assert_eq!(events, Vec::<String>::new());
    let rest = decode_from(&mut *codec, Timestamp::ZERO, 0, "\n{\"x_m\": 1, \"y_m\": 2}\n");
    assert_eq!(rest[0], "garbage: 100000");
    assert!(rest.last().unwrap().starts_with("1/100: "), "{rest:?}");
    // Deep nesting that fits a line is refused by its depth and not by the stack.
    let deep = decode_from(&mut *codec, Timestamp::ZERO, 0, &format!("{}\n", "[".repeat(1_000)));
    assert_eq!(deep, ["garbage: 1000"]);
}

#[test]
fn seven_cameras_are_one_too_many() {
    let mut codec = codec(TransportKind::Datagram);
    for k in 0..6 {
        let line = format!("{{\"camera\": \"c{k}\", \"x_m\": 0, \"y_m\": 0}}");
        let events = decode_from(&mut *codec, Timestamp::ZERO, k, &line);
        assert_eq!(events.len(), 2, "{events:?}");
    }
    let events = decode_from(&mut *codec, Timestamp::ZERO, 9, "{\"camera\": \"c6\", \"x_m\": 0, \"y_m\": 0}");
    assert!(events.contains(&"no sense".to_owned()), "{events:?}");
    assert!(events.iter().any(|text| text.contains("more than 6")), "{events:?}");
    assert_eq!(codec.source_health().len(), 6);
}

#[test]
fn a_failed_fix_is_counted_and_one_without_time_has_the_configured_age() {
    let mut codec = codec(TransportKind::Datagram);
    let now = Timestamp::from_millis(5_000);
    let failed = decode_from(&mut *codec, now, 0, "{\"x_m\": 0, \"y_m\": 0, \"quality\": 0}");
    assert_eq!(failed[1..], ["no sense"]);
    let plain = decode_from(&mut *codec, now, 0, "{\"x_m\": 0, \"y_m\": 0, \"quality\": 1}");
    // 60 ms, give or take 40.
    assert_eq!(plain, ["1/100: 4900000..4980000 us 0.000000 0.000000 - - 0"]);
}

#[test]
fn requests_are_encoded_as_json_and_only_for_cameras_that_take_them() {
    let mut codec = codec(TransportKind::Datagram);
    let hello = "{\"camera\": \"a\", \"x_m\": 0, \"y_m\": 0}\n{\"camera\": \"b\", \"takes_requests\": true}";
    decode_from(&mut *codec, Timestamp::ZERO, 0, hello);
    let mut encoded = |message: &Message| {
        let mut bytes = Vec::new();
        let length = codec.encode(Timestamp::ZERO, STATION, message, &mut bytes);
        assert_eq!(length, bytes.len());
        String::from_utf8(bytes).unwrap()
    };
    let request = Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 123_456_789_012, target: None });
    assert_eq!(encoded(&request), "{\"time_request\":123456789012}\n");
    let request = |target, what: u32| {
        let mut params = [0.0; 7];
        params[0] = what as f32;
        Message::Command(CommandLong { target, command: ids::COMMAND_REQUEST_MESSAGE, params })
    };
    let fix = ids::VISION_POSITION_ESTIMATE;
    assert_eq!(encoded(&request(CAMERA, fix)), "");
    assert_eq!(encoded(&request(SECOND, fix)), "{\"camera\":\"b\",\"fix_request\":1}\n");
    assert_eq!(encoded(&request(SECOND, ids::ATTITUDE)), "");
    assert_eq!(encoded(&request(Address::new(2, 101), fix)), "");
}

#[test]
fn a_link_that_comes_back_keeps_the_names_and_forgets_half_a_line() {
    let mut codec = codec(TransportKind::Stream);
    let now = Timestamp::ZERO;
    decode_from(&mut *codec, now, 0, "{\"camera\": \"a\", \"x_m\": 1, \"y_m\": 2}\n{\"x_m\": ");
    codec.on_link_up(now + TimeDelta::from_millis(1));
    let events = decode_from(&mut *codec, now, 0, "{\"camera\": \"a\", \"x_m\": 1, \"y_m\": 2}\n");
    assert_eq!(events.len(), 1, "{events:?}");
    assert!(events[0].starts_with("1/100: "));
}
