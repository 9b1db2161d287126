//! Which protocol a link carries, from bytes that foreign programs and specifications made, and from noise.

use posebridge_protocol::detect::{Protocol, ProtocolDetection, recognise};

use crate::captures::{RECORDED, records};
use crate::support::{from_hex, golden_frames, noise};

fn golden(name: &str) -> Vec<u8> {
    golden_frames()[name].clone()
}

fn check(bytes: &[u8], protocol: Protocol, frames: usize, frame_bytes: usize) {
    let expected = ProtocolDetection { protocol, frames, frame_bytes };
    assert_eq!(recognise(bytes), expected, "{bytes:02x?}");
}

/// The same protocol wherever the window begins and ends, if at least `min_bytes` bytes remain.
fn check_any_window(stream: &[u8], protocol: Protocol, min_bytes: usize) {
    for begin in (0..stream.len()).step_by(3) {
        for end in ((begin + min_bytes)..=stream.len()).step_by(7) {
            let window = &stream[begin..end];
            assert_eq!(recognise(window).protocol, protocol, "{begin}..{end}");
        }
    }
}

#[test]
fn one_frame_is_enough_for_mavlink_2() {
    let frame = golden("heartbeat");
    check(&frame, Protocol::Mavlink2, 1, frame.len());
    let signed = golden("heartbeat_signed");
    check(&signed, Protocol::Mavlink2, 1, signed.len());
    let truncated = [&golden("odometry_arena")[30..], &frame, &noise(1, 300)].concat();
    check(&truncated, Protocol::Mavlink2, 1, frame.len());
}

#[test]
fn a_flight_is_mavlink_1_from_any_point() {
    let flight = records(RECORDED).concat();
    assert_eq!(recognise(&flight).protocol, Protocol::Mavlink1);
    assert_eq!(recognise(&flight).frames, 150);
    check_any_window(&flight[..600], Protocol::Mavlink1, 150);
}

#[test]
fn one_frame_of_mavlink_1_is_accepted_only_if_there_is_little_else_and_two_among_anything() {
    let frame = golden("v1_attitude");
    check(&frame, Protocol::Mavlink1, 1, frame.len());
    let among_noise = [&noise(2, 500), &frame[..], &noise(3, 500)].concat();
    check(&among_noise, Protocol::Unrecognized, 0, 0);
    let among_noise = [&noise(2, 500), &frame[..], &noise(3, 500), &frame].concat();
    check(&among_noise, Protocol::Mavlink1, 2, 2 * frame.len());
}

/// Sentences as receivers send them; the checksums are those of the sources.
const GPGGA: &[u8] = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n";
const GPRMC: &[u8] = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n";

#[test]
fn sentences_of_a_receiver_are_nmea_and_with_a_wrong_checksum_just_text() {
    let both = [GPGGA, GPRMC].concat();
    check(&both, Protocol::Nmea, 2, both.len() - 4);
    check(&both[20..], Protocol::Nmea, 1, GPRMC.len() - 2);
    let mut wrong = GPGGA.to_vec();
    wrong[10] ^= 1;
    check(&wrong, Protocol::Text, 1, wrong.len());
}

#[test]
fn replies_of_an_nxt_are_recognised_by_their_lengths() {
    // Replies as the developer kit lays them out: battery level 7900 mV, keep alive 10 minutes, firmware version, no program.
    let battery = "0500 020b00 dc1e";
    let keep_alive = "0700 020d00 c0270900";
    let version = "0700 028800 7c011d01";
    let no_program = "1700 0211ec 0000000000000000000000000000000000000000";
    let stream = from_hex(&[battery, keep_alive, version, no_program].concat());
    check(&stream, Protocol::Nxt, 4, stream.len());
    check(&from_hex(battery), Protocol::Nxt, 1, 7);
    let long = stream.repeat(4);
    check_any_window(&long, Protocol::Nxt, 100);
    // A brick that answers with a status that no firmware has.
    check(&from_hex("0500 020b77 dc1e"), Protocol::Unrecognized, 0, 0);
}

#[test]
fn after_a_truncated_telegram_three_complete_ones_are_accepted_and_two_are_not() {
    let truncated = from_hex("dc1e");
    let telegram = from_hex("0500 020b00 dc1e");
    let three = [&truncated[..], &telegram.repeat(3)].concat();
    check(&three, Protocol::Nxt, 3, 21);
    let two = [&truncated[..], &telegram.repeat(2)].concat();
    check(&two, Protocol::Unrecognized, 0, 0);
}

#[test]
fn messages_of_a_program_on_an_nxt_are_recognised() {
    let message = from_hex("0900 8009 00 05 6869212100");
    check(&message.repeat(3), Protocol::Nxt, 3, 33);
    let wrong_size = from_hex("0900 8009 00 06 6869212100");
    check(&wrong_size.repeat(3), Protocol::Unrecognized, 0, 0);
}

#[test]
fn mailboxes_and_replies_of_an_ev3_are_recognised() {
    // A capture of a mailbox message: mailbox `abc`, text `hello!`.
    let mailbox = from_hex("1200 0100 819e 04 61626300 0700 68656c6c6f2100");
    check(&mailbox, Protocol::Ev3, 1, 20);
    // Replies to one direct command: counter, 02, sixteen bytes of globals.
    let mut stream = Vec::new();
    for counter in 0..12 {
        stream.extend(from_hex(&format!("1300 {counter:02x}00 02")));
        stream.extend(noise(counter, 16));
    }
    check(&stream, Protocol::Ev3, 12, 252);
    check_any_window(&stream, Protocol::Ev3, 105);
}

#[test]
fn the_announcement_of_an_ev3_is_no_ordinary_text() {
    let announcement = b"Serial-Number: 0016533f0c1e\r\nPort: 5555\r\nName: EV3\r\nProtocol: EV3\r\n";
    assert_eq!(recognise(announcement).protocol, Protocol::Ev3);
}

#[test]
fn text_is_lines_that_ended() {
    check(b"L 12 R 13\r\nL 14 R 1", Protocol::Text, 1, 11);
    check(b"L 12 R 13\rL 14 R 15\r", Protocol::Text, 2, 20);
    check(b"no end", Protocol::Unrecognized, 0, 0);
    // One byte in twenty may be none of text's, one in nineteen may not.
    check(b"abcdefghi\n\xFFbcdefghi\n", Protocol::Text, 2, 20);
    check(b"abcdefghi\n\xFFbcdefgh\n", Protocol::Unrecognized, 0, 0);
}

/// What rosserial_python's SerialClient sends: the request for topics and the stop; and, by wiki.ros.org/rosserial/Overview/Protocol,
/// the request for the time (topic 10) that a board sends first.
#[test]
fn messages_of_rosserial_are_recognised_by_both_of_their_checks() {
    let (topics, stop) = (from_hex("fffe 0000 ff 0000 ff"), from_hex("fffe 0000 ff 0b00 f4"));
    let time = from_hex("fffe 0800 f7 0a00 0000000000000000 f5");
    check(&topics, Protocol::Rosserial, 1, 8);
    let stream = [&time[..], &topics, &stop, &time].concat();
    check(&stream, Protocol::Rosserial, 4, 48);
    check_any_window(&stream.repeat(3), Protocol::Rosserial, 70);
    let mut wrong = time;
    wrong[9] ^= 1;
    assert_eq!(recognise(&wrong.repeat(3)).protocol, Protocol::Unrecognized);
}

/// Made by a Python program from the description of the serial transport; its CRC gives the check value BB3D of CRC-16/ARC. The second
/// payload has both bytes that are escaped.
#[test]
fn frames_of_micro_ros_are_recognised_by_their_crc() {
    let create = from_hex("7e010018008000000000011000585243450100010faabbccdd810000023f8e");
    let heartbeat = from_hex("7e01000d00810000000b0105007d5e007d5d0080a30e");
    check(&create, Protocol::MicroRos, 1, 31);
    check(&heartbeat.repeat(3), Protocol::MicroRos, 3, 66);
    check_any_window(&[&create[..], &heartbeat].concat().repeat(3), Protocol::MicroRos, 110);
    let mut wrong = create;
    wrong[20] ^= 1;
    assert_eq!(recognise(&wrong.repeat(3)).protocol, Protocol::Unrecognized);
}

#[test]
fn lines_with_as_many_numbers_each_are_columns() {
    let lines = b"t=1 l=5 r=6\nt=2 l=5 r=6\nt=3 l=5 r=6\nt=4";
    check(lines, Protocol::Columns, 3, 36);
    assert_eq!(recognise(b"ready\n1 of 2\nset 3 4 5\ndone\n").protocol, Protocol::Text);
}

#[test]
fn silence_is_not_noise() {
    check(b"", Protocol::NoData, 0, 0);
    check(&[0; 100], Protocol::Unrecognized, 0, 0);
}

#[test]
fn random_bytes_are_noise() {
    for seed in 0..300 {
        let bytes = noise(seed, 4_000);
        assert_eq!(recognise(&bytes).protocol, Protocol::Unrecognized, "seed {seed}");
    }
}

/// What a receiver at another speed makes of a line: it waits for a start bit, then takes eight bits at its own pace.
fn misread(bytes: &[u8], sent_baud: f64, read_baud: f64) -> Vec<u8> {
    let line: Vec<bool> = bytes
        .iter()
        .flat_map(|byte| {
            let bits = (0..8).map(move |bit| byte >> bit & 1 == 1);
            std::iter::once(false).chain(bits).chain([true, true])
        })
        .collect();
    let ratio = sent_baud / read_baud;
    let level = |at: f64| line.get(at as usize).copied();
    let mut found = Vec::new();
    let mut at = 0.0;
    while let Some(bit) = level(at) {
        if bit {
            at += 0.25;
            continue;
        }
        let mut byte = 0;
        for number in 0..8 {
            // In the middle of the bit; the line rests at one.
            let high = level(at + ratio * (1.5 + f64::from(number))).unwrap_or(true);
            byte |= u8::from(high) << number;
        }
        found.push(byte);
        at += ratio * 9.5;
    }
    found
}

#[test]
fn a_line_at_the_wrong_speed_is_noise_and_at_the_right_one_is_not() {
    let frames = [golden("pb_wheel_ticks"), golden("attitude"), golden("heartbeat")].concat();
    let stream = frames.repeat(20);
    assert_eq!(misread(&stream, 115_200.0, 115_200.0), stream);
    for read_baud in [9_600.0, 19_200.0, 38_400.0, 57_600.0, 230_400.0, 921_600.0] {
        let misread_bytes = misread(&stream, 115_200.0, read_baud);
        assert!(misread_bytes.len() > 100);
        let found = recognise(&misread_bytes).protocol;
        assert_eq!(found, Protocol::Unrecognized, "{read_baud}");
    }
}
