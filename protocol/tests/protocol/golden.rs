//! Frames made by a foreign implementation decode to their meaning, and our encoder writes the same bytes.

use std::collections::BTreeMap;

use posebridge_protocol::dialect::{Encoder, PayloadError, RenumberError, decode};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::Message;
use posebridge_telemetry::Address;

use crate::support::{ROBOT, golden_frames, with_frame};

/// Name and meaning of each frame of golden.json: the message in SI units and our frames with six decimals, `unused`, or why it is
/// refused. See tests/data/README.md.
const MEANINGS: &str = include_str!("../data/golden_meanings.txt");

/// Frames that our encoder writes otherwise: they have a custom mode, a signature, other axes, another type of number, a dilution of precision,
/// or pressures, or are of another message that says the same.
const WRITTEN_OTHERWISE: &[&str] = &[
    "battery_status_of_cells",
    "battery_status_of_twelve_cells",
    "global_vision",
    "gps_raw_int_dilution",
    "gps_raw_int_of_unknown_accuracy",
    "heartbeat_of_unlisted_type",
    "heartbeat_signed",
    "manual_control_without_turn",
    "odometry_enu_flu",
    "param_set_of_type_1",
    "param_set_of_type_10",
    "param_set_of_type_2",
    "param_set_of_type_3",
    "param_set_of_type_4",
    "param_set_of_type_5",
    "param_set_of_type_6",
    "scaled_pressure",
    "set_mode",
    "velocity_target_north_east_down",
];

#[test]
fn every_frame_has_its_meaning_and_is_encoded_to_the_same_bytes() {
    let frames = golden_frames();
    let meanings: BTreeMap<&str, &str> = MEANINGS.lines().filter_map(|line| line.split_once(": ")).collect();
    assert!(frames.keys().eq(meanings.keys()));
    let mut otherwise = Vec::new();
    for (name, bytes) in &frames {
        let decoded = with_frame(bytes, decode);
        assert_eq!(meaning_of(&decoded), meanings[name.as_str()], "{name}");
        if let Ok(Some(message)) = decoded
            && encoded_alike(bytes, &message) != *bytes
        {
            otherwise.push(name.as_str());
        }
    }
    assert_eq!(otherwise, WRITTEN_OTHERWISE);
}

fn meaning_of(decoded: &Result<Option<Message>, PayloadError>) -> String {
    match decoded {
        Ok(Some(message)) => {
            let mut text = format!("{message:.6?}");
            // The spaces of a pose, which its type says.
            while let Some(start) = text.find(", spaces: ") {
                let end = text[start..].find('>').expect("a type ends") + start;
                text.replace_range(start..=end, "");
            }
            text
        }
        Ok(None) => "unused".to_owned(),
        Err(error) => format!("refused: {error}"),
    }
}

/// The message in the version, from the sender and with the number of a frame.
fn encoded_alike(frame: &[u8], message: &Message) -> Vec<u8> {
    let (version, source, sequence) = with_frame(frame, |frame| (frame.version, frame.source, frame.sequence));
    let mut encoder = Encoder::new(version);
    let mut bytes = Vec::new();
    for _ in 0..=sequence {
        bytes.clear();
        encoder.encode(source, message, &mut bytes);
    }
    bytes
}

#[test]
fn a_name_that_is_too_long_still_ends_with_a_zero() {
    let frame = &golden_frames()["component_information_basic"];
    let Ok(Some(Message::ComponentInformation(mut information))) = with_frame(frame, decode) else {
        panic!("it is one");
    };
    information.model.push_str(" and more");
    assert_eq!(&encoded_alike(frame, &Message::ComponentInformation(information)), frame);
}

#[test]
fn a_signed_frame_is_taken_with_its_signature() {
    let bytes = &golden_frames()["heartbeat_signed"];
    let (raw, payload) = with_frame(bytes, |frame| (frame.raw.to_vec(), frame.payload.len()));
    assert_eq!((&raw, raw.len(), payload), (bytes, 9 + 12 + 13, 9));
}

#[test]
fn sequences_count_per_address_and_version_1_cannot_encode_everything() {
    let mut encoder = Encoder::new(WireVersion::V1);
    let station = Address::new(1, 197);
    let heartbeat = crate::support::HEARTBEAT;
    let sequences = [ROBOT, station, ROBOT, ROBOT, station].map(|from| {
        let mut frame = Vec::new();
        assert_eq!(encoder.encode(from, &heartbeat, &mut frame), 17);
        frame[2]
    });
    assert_eq!(sequences, [0, 0, 1, 2, 1]);
    let wide = with_frame(&golden_frames()["wheel_distance"], decode);
    let mut frame = Vec::new();
    assert_eq!(encoder.encode(ROBOT, &wide.expect("it is known").expect("it is used"), &mut frame), 0);
    assert!(frame.is_empty());
}

/// The foreign encoder writes the same message under any number: under ours it must be the same bytes, whichever message it is.
#[test]
fn a_frame_under_another_number_is_what_its_sender_would_have_written() {
    let golden = golden_frames();
    for (version, number_at) in [("heartbeat", 4), ("v1_heartbeat", 2)] {
        // Number 0 in both; to 5 and back.
        let mut encoder = Encoder::new(WireVersion::V2);
        let mut frame = golden[version].clone();
        for _ in 0..6 {
            encoder.readdress(&mut frame, ROBOT).expect(version);
        }
        assert_eq!(frame[number_at], 5, "{version}");
        Encoder::new(WireVersion::V2).readdress(&mut frame, ROBOT).expect(version);
        assert_eq!(frame, golden[version], "{version}");
    }
    for (name, bytes) in &golden {
        let mut frame = bytes.clone();
        let source = with_frame(bytes, |frame| frame.source);
        let numbered = Encoder::new(WireVersion::V2).readdress(&mut frame, source);
        if name == "heartbeat_signed" {
            assert_eq!(numbered, Err(RenumberError::Signed));
            assert_eq!(&frame, bytes, "a signed frame is never touched");
        } else {
            assert_eq!(numbered, Ok(()), "{name}");
            with_frame(&frame, |found| assert_eq!(found.sequence, 0, "{name}"));
        }
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
    let mut frame = of_number(200);
    assert_eq!(encoder.readdress(&mut frame, ROBOT), Ok(()));
    assert_eq!(frame, of_number(0));
    let mut damaged = of_number(200);
    // No single byte of CRC_EXTRA explains both halves of this sum.
    *damaged.last_mut().expect("it has bytes") ^= 0x5A;
    let before = damaged.clone();
    assert_eq!(encoder.readdress(&mut damaged, ROBOT), Err(RenumberError::Damaged));
    assert_eq!(damaged, before);
    for cut in 0..before.len() {
        let mut truncated = before[..cut].to_vec();
        assert_eq!(encoder.readdress(&mut truncated, ROBOT), Err(RenumberError::NoFrame));
    }
    // A frame that could not be numbered has taken no number.
    let mut next = of_number(9);
    assert_eq!(encoder.readdress(&mut next, ROBOT), Ok(()));
    assert_eq!(next, of_number(1));
}
