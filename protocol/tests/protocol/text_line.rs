//! Lines of boards that print: every layout, every chunk size, every damaged byte.
//!
//! The lines were written by hand from docs/protocols/boards.md; the sentence with a checksum is NMEA's own example.

use posebridge_protocol::bricks::text_line::{ChecksumPolicy, Column, LineLayout, Separator, TextLineSettings};
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings, DEFAULT_BRICK_ADDRESS};
use posebridge_protocol::message::{Message, PoseFlags, WireStamp};
use posebridge_telemetry::{Heading, HostClock, Meters, Pose, ReceiveError, TimeDelta, Timestamp};

use crate::support::{at, estimate, noise};

fn columns(names: &[&str]) -> TextLineSettings {
    let columns = names.iter().map(|name| Column::from_name(name));
    TextLineSettings {
        layout: LineLayout::Columns {
            columns: columns.collect::<Option<_>>().expect("the names are known"),
            separator: Separator::Comma,
        },
        ..TextLineSettings::default()
    }
}

fn pairs(keys: &[(&str, &str)], separator: Separator, key_separator: Separator) -> TextLineSettings {
    let column = |name: &str| Column::from_name(name).expect("the name is known");
    let keys = keys.iter().map(|(key, name)| ((*key).to_owned(), column(name)));
    TextLineSettings {
        layout: LineLayout::Pairs { keys: keys.collect(), separator, key_separator },
        ..TextLineSettings::default()
    }
}

/// A codec after a line end: the next line is complete.
fn codec(settings: TextLineSettings) -> Box<dyn BrickCodec> {
    settings.validate().expect("the layout can be");
    let mut codec = crate::support::codec("line", &CodecSettings { line: settings, ..CodecSettings::default() });
    codec.on_link_up(Timestamp::ZERO);
    codec.push(Timestamp::ZERO, b"cut\n", &mut |_| {});
    codec
}

/// An event in short: no heartbeats, stamps by their number.
fn short(event: CodecEvent<'_>) -> Option<String> {
    let stamp = |stamp: WireStamp| match stamp {
        WireStamp::Millis32(millis) => format!("{millis} ms"),
        WireStamp::Micros32(micros) => format!("{micros} us"),
        WireStamp::HostInterval { sent, answered } => {
            format!("{}..{} us", sent.as_micros(), answered.as_micros())
        }
        WireStamp::Micros64(micros) => panic!("{micros}"),
    };
    Some(match event {
        CodecEvent::Message { from, message } => {
            assert_eq!(from, DEFAULT_BRICK_ADDRESS);
            match message {
                Message::Heartbeat(_) => return None,
                Message::WheelTicks(ticks) => {
                    format!("{}: wheels {} {}", stamp(ticks.stamp), ticks.left.0, ticks.right.0)
                }
                Message::Inertial(inertial) => {
                    let rate = inertial.turn_rate.expect("a rate is said");
                    format!("{}: turn {:.6}", stamp(inertial.stamp), rate.0)
                }
                Message::DistanceSensor { stamp: at, range, .. } => {
                    format!("{}: range {:.4}", stamp(at), range.0)
                }
                Message::Thermometer { stamp: at, channel, temperature } => {
                    format!("{}: {channel} {:.2}", stamp(at), temperature.0)
                }
                Message::BatteryStatus(battery) => format!("battery {:?} V", battery.voltage_v),
                other => panic!("{other:?}"),
            }
        }
        CodecEvent::ClockReply { sent, peer_nanos, .. } => {
            assert_eq!(sent.as_nanos(), peer_nanos);
            "time".to_owned()
        }
        CodecEvent::StatusText { text, .. } => format!("note: {text}"),
        CodecEvent::Error(defect) => format!("{defect:?}"),
        CodecEvent::ForwardFrame(frame) => panic!("{frame:?}"),
    })
}

fn push(codec: &mut dyn BrickCodec, now: Timestamp<HostClock>, bytes: &[u8]) -> Vec<String> {
    let mut events = Vec::new();
    codec.push(now, bytes, &mut |found| events.extend(short(found)));
    events
}

/// The events of a codec for bytes that come at once.
fn decode(settings: TextLineSettings, bytes: &str) -> Vec<String> {
    push(&mut *codec(settings), Timestamp::from_millis(1_000), bytes.as_bytes())
}

#[test]
fn every_layout_is_read_in_si_units() {
    let robot = [("t", "time_ms"), ("l", "left_ticks"), ("r", "right_ticks"), ("g", "gyro_rad_per_s")];
    let wheels = [("L", "left_ticks"), ("R", "right_ticks")];
    for (keys, separator, key_separator, line, expected) in [
        (
            &robot[..],
            Separator::Pipe,
            Separator::Colon,
            "t:123|l:45|r:46|g:0.5\n",
            ["123 ms: wheels 45 46", "123 ms: turn 0.500000"],
        ),
        (
            &robot,
            Separator::Comma,
            Separator::Equals,
            "r = 46, g=-.5 ,t=123,l=45\r\n",
            ["123 ms: wheels 45 46", "123 ms: turn -0.500000"],
        ),
        (&wheels, Separator::Blank, Separator::Blank, "L 1  R\t-2\r", ["time", "960000..1000000 us: wheels 1 -2"]),
        (&wheels, Separator::Blank, Separator::Colon, "L:1 R:2\n", ["time", "960000..1000000 us: wheels 1 2"]),
    ] {
        assert_eq!(decode(pairs(keys, separator, key_separator), line), expected);
    }
    let csv = columns(&[
        "time_us",
        "ignore",
        "-left_ticks",
        "right_ticks",
        "-gyro_deg_per_s",
        "distance_cm",
        "temperature_c",
    ]);
    assert_eq!(
        decode(csv, "4294967295, x, 7.00, +8, 90, 12.5, 21.37\n"),
        [
            "4294967295 us: wheels -7 8",
            "4294967295 us: turn -1.570796",
            "4294967295 us: range 0.1250",
            "4294967295 us: temperature 21.37",
        ]
    );
}

#[test]
fn a_distance_is_in_metres_and_absent_without_a_target() {
    let wheels_and_distance = columns(&["time_us", "left_ticks", "right_ticks", "distance_cm"]);
    assert_eq!(decode(wheels_and_distance, "5,7,8,0\n"), ["5 us: wheels 7 8"]);
    for (name, value, range) in [("distance_mm", "1250", "1.2500"), ("distance_m", "1.25", "1.2500")] {
        assert_eq!(decode(columns(&["time_ms", name]), &format!("9,{value}\n")), [format!("9 ms: range {range}")]);
    }
}

#[test]
fn the_battery_is_a_column_or_a_key_and_told_once_a_second() {
    let keys = [("l", "left_ticks"), ("r", "right_ticks"), ("bat", "battery_v")];
    let mut board = codec(pairs(&keys, Separator::Blank, Separator::Equals));
    let told = push(&mut *board, at(1_000), b"l=1 r=2 bat=7.9\n");
    assert_eq!(told, ["time", "960000..1000000 us: wheels 1 2", "battery Some(7.9) V"]);
    let mut board = codec(columns(&["time_ms", "battery_v"]));
    assert_eq!(push(&mut *board, at(1_000), b"1000,7.4\n"), ["battery Some(7.4) V"]);
    assert_eq!(push(&mut *board, at(1_999), b"1999,7.3\n"), [""; 0]);
    assert_eq!(push(&mut *board, at(2_000), b"2000,7.2\n"), ["battery Some(7.2) V"]);
    assert!(push(&mut *board, at(3_000), b"3000,0\n").is_empty(), "a board that has none says 0");
    for wrong in ["7900", "-1", "nan", "full"] {
        let told = push(&mut *board, at(4_000), format!("4000,{wrong}\n").as_bytes());
        assert!(told[0].starts_with("UnframedBytes"), "{wrong}: {told:?}");
    }
}

#[test]
fn the_checksum_is_that_of_nmea() {
    // The example of NMEA 0183 receivers' manuals, whose checksum is 47.
    let sentence = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n";
    let mut names = vec!["ignore"; 15];
    names[1] = "time_ms";
    names[9] = "distance_m";
    let mut settings = columns(&names);
    assert_eq!(decode(settings.clone(), sentence), ["123519 ms: range 545.4000"]);
    settings.checksum = ChecksumPolicy::Required;
    assert_eq!(decode(settings.clone(), sentence), ["123519 ms: range 545.4000"]);
    let wrong = decode(settings.clone(), &sentence.replace("*47", "*48"));
    assert_eq!(wrong[0], "Checksum { message_id: 0, found: 72, expected: 71 }");
    let none = decode(settings, &sentence.replace("*47", ""));
    assert!(none[1].contains("no checksum"), "{none:?}");
}

#[test]
fn the_first_bad_line_is_quoted_with_the_expected_format_and_unknown_names_are_reported_once() {
    let mut board = codec(columns(&["time_ms", "left_ticks", "right_ticks"]));
    let first = push(&mut *board, at(50), b"hello \x1b[31m world, this is my robot\n");
    assert_eq!(first[0], "UnframedBytes { bytes: 35 }");
    assert_eq!(
        first[1],
        "note: the line `hello .[31m world, this is my robot` is not understood: it is no text; expected `time_ms,left_ticks,right_ticks`"
    );
    assert_eq!(push(&mut *board, at(60), b"1,2\n"), ["UnframedBytes { bytes: 3 }"]);
    assert_eq!(board.counters().garbage_bytes, 3 + 35 + 3);
    for (line, why) in [
        ("1,2", "it has 2 values and not 3"),
        ("1,2,3,4", "it has 4 values and not 3"),
        ("1,2,nan", "`right_ticks` is no number"),
        ("1,1e999,3", "`left_ticks` is no number"),
        ("-1,2,3", "`time_ms` is no number"),
        ("1,2.5,3", "`left_ticks` is no number"),
        ("1,2,", "`right_ticks` is no number"),
    ] {
        let mut board = codec(columns(&["time_ms", "left_ticks", "right_ticks"]));
        let items = push(&mut *board, at(50), format!("{line}\n").as_bytes());
        assert!(items[1].contains(why), "{line}: {items:?}");
    }
    let keys = [("l", "left_ticks"), ("r", "right_ticks")];
    let settings = pairs(&keys, Separator::Pipe, Separator::Colon);
    let mut board = codec(settings.clone());
    let items = push(&mut *board, at(50), b"l:1|r:2|v:3\nl:1|r:2|v:3\n");
    let notes: Vec<_> = items.iter().filter(|item| item.starts_with("note")).collect();
    assert_eq!(notes, ["note: the board's `v` is not used"]);
    for (line, why) in [("l:1|l:2|r:3", "`left_ticks` twice"), ("l:1", "no `right_ticks`")] {
        let items = decode(settings.clone(), &format!("{line}\n"));
        assert!(items[1].contains(why), "{line}: {items:?}");
        assert!(items[1].ends_with("expected `l:<left_ticks>|r:<right_ticks>`"), "{items:?}");
    }
    let long = decode(columns(&["left_ticks", "right_ticks"]), &format!("{}\n", "9".repeat(300)));
    assert_eq!(long[0], "UnframedBytes { bytes: 300 }");
    assert!(long[1].contains("longer than 256"), "{long:?}");
}

/// Forty lines with checksums computed by hand's rule, 20 Hz.
fn transcript(checksum: ChecksumPolicy) -> Vec<u8> {
    let mut bytes = Vec::new();
    for n in 0..40 {
        let text = format!("{},{},{}", 10_000 + 50 * n, 100 + 7 * n, 200 + 8 * n);
        bytes.extend(text.as_bytes());
        if checksum == ChecksumPolicy::Required {
            let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
            bytes.extend(format!("*{sum:02x}").as_bytes());
        }
        bytes.push(b'\n');
    }
    bytes
}

/// The wheel messages of a transcript whose lines come each 50 ms.
fn wheels(bytes: &[u8], checksum: ChecksumPolicy) -> Vec<String> {
    let settings = TextLineSettings { checksum, ..TextLineSettings::default() };
    let mut board = codec(settings);
    let mut now = Timestamp::ZERO;
    let mut wheels = Vec::new();
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        now = now + TimeDelta::from_millis(50);
        let items = push(&mut *board, now, line);
        wheels.extend(items.into_iter().filter(|item| item.contains("wheels")));
    }
    wheels
}

#[test]
fn chunking_does_not_change_the_events() {
    let bytes =
        [&transcript(ChecksumPolicy::Optional)[..], b"noise\r\r\n", &transcript(ChecksumPolicy::Required)].concat();
    let bytes = &bytes[..bytes.len() - 1];
    let expected = push(&mut *codec(TextLineSettings::default()), Timestamp::ZERO, bytes);
    for chunk in 1..=bytes.len() {
        let mut board = codec(TextLineSettings::default());
        let parts = bytes.chunks(chunk);
        let items: Vec<_> = parts.flat_map(|part| push(&mut *board, Timestamp::ZERO, part)).collect();
        assert_eq!(items, expected, "chunk size {chunk}");
        assert!(board.deadline().is_some());
    }
}

#[test]
fn a_lost_an_inserted_or_a_flipped_byte_costs_one_line_and_a_line_end_two() {
    let mut cases = 0;
    for checksum in [ChecksumPolicy::Optional, ChecksumPolicy::Required] {
        let bytes = transcript(checksum);
        let sound = wheels(&bytes, checksum);
        assert_eq!(sound.len(), 40);
        let from = bytes.len() / 2;
        for at in from..from + 40 {
            let mut damaged = Vec::new();
            let mut lost = bytes.clone();
            lost.remove(at);
            damaged.push(lost);
            for inserted in [b'1', b',', b'\n', 0xFF] {
                let mut more = bytes.clone();
                more.insert(at, inserted);
                damaged.push(more);
            }
            for bit in 0..8 {
                let mut flipped = bytes.clone();
                flipped[at] ^= 1 << bit;
                damaged.push(flipped);
            }
            for (case, damaged) in damaged.iter().enumerate() {
                let items = wheels(damaged, checksum);
                let missing = sound.iter().filter(|item| !items.contains(item)).count();
                let wrong = items.iter().filter(|item| !sound.contains(item)).count();
                let name = format!("{checksum:?}, byte {at}, case {case}");
                let most = if bytes[at] == b'\n' { 2 } else { 1 };
                assert!(missing <= most, "{name}: {missing} missing");
                // Without a checksum a damaged digit is accepted, in its own line.
                let most_wrong = usize::from(checksum == ChecksumPolicy::Optional);
                assert!(wrong <= most_wrong, "{name}: {items:?}");
                cases += 1;
            }
        }
    }
    println!("{cases} ways to damage one byte: one line each at most, two where the line end is hit");
}

#[test]
fn a_time_with_a_lost_digit_is_no_restart() {
    let bytes = transcript(ChecksumPolicy::Optional);
    let text = String::from_utf8(bytes).unwrap();
    let damaged = text.replacen("10500,", "1500,", 1);
    let items = wheels(damaged.as_bytes(), ChecksumPolicy::Optional);
    assert_eq!(items.len(), 39);
    assert!(!items.iter().any(|item| item.starts_with("1500 ms")), "{items:?}");
}

#[test]
fn an_incomplete_line_is_dropped_and_its_end_is_not_taken_for_a_line() {
    let mut board = codec(columns(&["left_ticks", "right_ticks"]));
    push(&mut *board, at(100), b"12,3");
    let due = board.deadline().unwrap();
    let mut items = Vec::new();
    board.tick(due, &mut |found| items.extend(short(found)));
    assert_eq!(items, ["Timeout { bytes: 4 }"]);
    assert_eq!(board.deadline(), None);
    assert_eq!(board.counters().stalls, 1);
    let items = push(&mut *board, at(2_000), b"44,100\n13,350\n");
    assert_eq!(items[0], "UnframedBytes { bytes: 6 }");
    assert_eq!(items[2], "1960000..2000000 us: wheels 13 350", "{items:?}");
}

#[test]
fn counts_that_fall_to_zero_are_no_motion() {
    let mut board = codec(columns(&["left_ticks", "right_ticks"]));
    let lines = b"500,400\n510,410\n520,420\n0,0\n5,6\n";
    let items = push(&mut *board, Timestamp::ZERO, lines);
    let wheels: Vec<_> = items.iter().filter_map(|item| item.split_once("wheels ")).map(|(_, counts)| counts).collect();
    assert_eq!(wheels, ["500 400", "510 410", "520 420", "520 420", "525 426"]);
    // One wheel alone far from zero, left or right.
    for (lines, expected) in [("500,4\n510,5\n520,6\n0,0\n", "520 6"), ("4,500\n5,510\n6,520\n0,0\n", "6 520")] {
        let items = push(&mut *codec(columns(&["left_ticks", "right_ticks"])), Timestamp::ZERO, lines.as_bytes());
        assert!(items.iter().rfind(|item| item.contains("wheels ")).unwrap().ends_with(expected), "{items:?}");
    }
    // Slowly back through zero.
    let mut board = codec(columns(&["left_ticks", "right_ticks"]));
    let items = push(&mut *board, Timestamp::ZERO, b"20,20\n10,10\n0,0\n-10,-10\n");
    let last = items.last().unwrap();
    assert!(last.ends_with("wheels -10 -10"), "{last}");
}

#[test]
fn counts_that_keep_falling_are_reported_at_each_doubling() {
    let mut board = codec(columns(&["left_ticks", "right_ticks"]));
    let far = 1_i64 << 53;
    let mut notes = 0;
    // So many falls would carry the totals around more than once.
    for _ in 0..3_000 {
        let lines = format!("{far},{far}\n{far},{far}\n0,0\n");
        board.push(Timestamp::ZERO, lines.as_bytes(), &mut |event| {
            notes += usize::from(matches!(event, CodecEvent::StatusText { .. }));
        });
    }
    assert_eq!(notes, 12);
}

#[test]
fn a_heartbeat_a_second_while_lines_come_and_the_estimate_only_when_configured() {
    let settings =
        TextLineSettings { estimate_interval: Some(TimeDelta::from_millis(100)), ..TextLineSettings::default() };
    let mut board = codec(settings);
    let pose = Pose::new(Meters(1.2344), Meters(-0.0456), Heading::from_rad(-1.5));
    let flags = PoseFlags { position_valid: true, heading_valid: true, ..PoseFlags::default() };
    let covariance = [0.000_004, 0.0, 0.0, 0.000_009_1, 0.0, 1.0];
    let pose = Message::PlanarPose(estimate(12_345_678, pose, covariance, flags));
    let (mut heartbeats, mut estimates) = (0, Vec::new());
    for n in 0..100_u32 {
        let now = Timestamp::from_millis(i64::from(n) * 50);
        let line = format!("{},0,0\n", 12_000 + n * 50);
        board.push(now, line.as_bytes(), &mut |found| {
            let is_heartbeat = matches!(found, CodecEvent::Message { message: Message::Heartbeat(_), .. });
            heartbeats += u32::from(is_heartbeat);
        });
        let mut out = Vec::new();
        let bytes = board.encode(now, DEFAULT_BRICK_ADDRESS, &pose, &mut out);
        assert_eq!(bytes, out.len());
        estimates.extend((bytes > 0).then_some(out));
    }
    assert_eq!(heartbeats, 5);
    assert_eq!(estimates.len(), 50);
    // 45 2c 31 .. 33: the exclusive or of the 31 characters is 46, by hand.
    let line = String::from_utf8(estimates[0].clone()).unwrap();
    assert_eq!(line, format!("E,12345,1234,-46,-1500,4,3*{:02X}\n", reference_checksum("E,12345,1234,-46,-1500,4,3")));
    let silent =
        codec(TextLineSettings::default()).encode(Timestamp::ZERO, DEFAULT_BRICK_ADDRESS, &pose, &mut Vec::new());
    assert_eq!(silent, 0);
}

/// NMEA's checksum, bit by bit.
fn reference_checksum(text: &str) -> u8 {
    (0..8).filter(|bit| text.bytes().filter(|byte| byte >> bit & 1 == 1).count() % 2 == 1).map(|bit| 1 << bit).sum()
}

#[test]
fn noise_and_every_byte_are_accounted_for() {
    let bytes = noise(11, 20_000);
    let ends = bytes.iter().filter(|byte| matches!(byte, b'\n' | b'\r')).count();
    let mut board = codec(TextLineSettings::default());
    let items = push(&mut *board, Timestamp::ZERO, &bytes);
    assert!(!items.iter().any(|item| item.contains("wheels")), "{items:?}");
    let mut reported_bytes = 0;
    board.tick(Timestamp::from_millis(600), &mut |found| {
        if let CodecEvent::Error(ReceiveError::Timeout { bytes }) = found {
            reported_bytes += u64::from(bytes);
        }
    });
    let counters = board.counters();
    assert_eq!(counters.garbage_bytes - 3, (bytes.len() - ends) as u64);
    assert!(reported_bytes > 0);
}
