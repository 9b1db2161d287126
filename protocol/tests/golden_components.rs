//! What components say of themselves, in frames made by a foreign implementation; see golden.rs.

#![expect(clippy::expect_used, reason = "helpers of tests")]

#[path = "support/golden.rs"]
mod frames;

use frames::{check, check_encoding, decode_golden, golden};
use posebridge_protocol::dialect::{Encoder, RenumberError};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{
    AutopilotVersion, CommandInt, ComponentInformation, FloatArray, Message, MessageInterval, ProtocolVersion,
    TextPart, WireStamp,
};
use posebridge_telemetry::{Address, ChannelName};

/// COMMAND_INT 8, PARAM_ENCODE_BYTEWISE 16 and MAVLINK2 8192 of MAV_PROTOCOL_CAPABILITY.
const CAPABILITIES: u64 = 8 + 16 + 8_192;

#[test]
fn versions_and_names() {
    check(
        "autopilot_version",
        &Message::AutopilotVersion(AutopilotVersion { capabilities: CAPABILITIES, software: [1, 2, 3, 128] }),
    );
    check(
        "protocol_version",
        &Message::ProtocolVersion(ProtocolVersion { version: 200, min_version: 100, max_version: 200 }),
    );
    check(
        "component_information_basic",
        &Message::ComponentInformation(ComponentInformation {
            capabilities: CAPABILITIES,
            stamp: WireStamp::Millis32(123_456),
            vendor: "an open source project".to_owned(),
            model: "thirty-one bytes of a model nam".to_owned(),
            software_version: "1.2.3-rc.1".to_owned(),
        }),
    );
}

#[test]
fn a_name_that_is_too_long_still_ends_with_a_zero() {
    let Ok(Some(Message::ComponentInformation(mut said))) = decode_golden("component_information_basic") else {
        panic!("it is one");
    };
    said.model.push_str(" and more");
    check_encoding("component_information_basic", &Message::ComponentInformation(said), WireVersion::V2);
}

#[test]
fn intervals_and_arrays() {
    for (name, message_id, interval_micros) in
        [("message_interval", 331, 200_000), ("message_interval_disabled", 42_102, -1)]
    {
        let said = MessageInterval { message_id, interval_micros };
        check(name, &Message::MessageInterval(said));
    }
    let array = |name: &str, id, values: &[f32]| {
        Message::FloatArray(FloatArray {
            stamp: WireStamp::Micros64(5_000_001),
            name: ChannelName::from_bytes(name.as_bytes()),
            id,
            values: values.to_vec(),
        })
    };
    let values = [1.5, 0.0, -0.25, 0.0, 0.0, 1e-9];
    check("debug_float_array", &array("tencharact", 3, &values));
    check("debug_float_array_empty", &array("camera", 65_535, &[]));
}

#[test]
fn a_command_in_integers_and_the_second_part_of_a_text() {
    check(
        "command_int",
        &Message::CommandInt(CommandInt {
            target: Address::new(1, 197),
            frame: 20,
            command: 65_000,
            params: [1.0, 2.0, 3.0, -4.0],
            x: i32::MIN,
            y: 70_000,
            z: 7.5,
        }),
    );
    check(
        "statustext_second_part",
        &Message::StatusText { severity: 6, text: "of two".to_owned(), part: TextPart { text_id: 513, index: 1 } },
    );
}

/// The sender of a frame, which stands behind the sequence number.
fn source_of(frame: &[u8]) -> Address {
    let system_at = if frame[0] == 0xFD { 5 } else { 3 };
    Address::new(frame[system_at], frame[system_at + 1])
}

/// The foreign encoder writes the same message under any number: under ours it must be the same bytes, whichever message it is.
#[test]
fn a_frame_under_another_number_is_what_its_sender_would_have_written() {
    let golden = golden();
    for version in ["heartbeat", "v1_heartbeat"] {
        // Number 0 in both; to 5 and back.
        let mut encoder = Encoder::new(WireVersion::V2);
        let mut frame = golden[version].clone();
        let robot = source_of(&frame);
        for _ in 0..6 {
            encoder.readdress(&mut frame, robot).expect(version);
        }
        assert_ne!(frame, golden[version], "{version}");
        let number = if version == "heartbeat" { 4 } else { 2 };
        assert_eq!(frame[number], 5, "{version}");
        Encoder::new(WireVersion::V2).readdress(&mut frame, robot).expect(version);
        assert_eq!(frame, golden[version], "{version}");
    }
    for (name, bytes) in &golden {
        let mut frame = bytes.clone();
        let numbered = Encoder::new(WireVersion::V2).readdress(&mut frame, source_of(bytes));
        if name == "heartbeat_signed" {
            assert_eq!(numbered, Err(RenumberError::Signed));
            assert_eq!(&frame, bytes, "a signed frame is never touched");
            continue;
        }
        assert_eq!(numbered, Ok(()), "{name}");
        frames::with_frame(&frame, |found| assert_eq!(found.sequence, 0, "{name}"));
    }
}

/// A frame of no dialect, CRC_EXTRA 77: made by hand from the definition of the checksum.
#[test]
fn a_frame_of_no_dialect_is_numbered_too_and_a_damaged_one_is_not() {
    let of_number = |number: u8| {
        let mut frame = vec![0xFD, 3, 0, 0, number, 1, 1, 0x60, 0xEA, 0x00, 7, 8, 9];
        let mut sum = 0xFFFF_u16;
        for byte in frame[1..].iter().chain(&[77]) {
            sum ^= u16::from(*byte);
            for _ in 0..8 {
                sum = if sum & 1 == 1 { (sum >> 1) ^ 0x8408 } else { sum >> 1 };
            }
        }
        frame.extend_from_slice(&sum.to_le_bytes());
        frame
    };
    let mut encoder = Encoder::new(WireVersion::V2);
    let robot = Address::new(1, 1);
    let mut frame = of_number(200);
    assert_eq!(encoder.readdress(&mut frame, robot), Ok(()));
    assert_eq!(frame, of_number(0));
    let mut damaged = of_number(200);
    // No single byte of CRC_EXTRA explains both halves of this sum.
    *damaged.last_mut().expect("it has bytes") ^= 0x5A;
    let before = damaged.clone();
    assert_eq!(encoder.readdress(&mut damaged, robot), Err(RenumberError::Damaged));
    assert_eq!(damaged, before);
    for cut in 0..before.len() {
        let mut torn = before[..cut].to_vec();
        assert_eq!(encoder.readdress(&mut torn, robot), Err(RenumberError::NoFrame));
    }
    // A frame that could not be numbered has taken no number.
    let mut next = of_number(9);
    assert_eq!(encoder.readdress(&mut next, robot), Ok(()));
    assert_eq!(next, of_number(1));
}
