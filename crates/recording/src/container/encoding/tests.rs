//! The bytes of the format page, written by hand, and the errors.

use posebridge_telemetry::Input;

use super::*;

const POSITION: RecordPosition = RecordPosition { sequence: 7, log_time: 1_234_567_890 };

/// Appends the checksum as the format page describes it, computed bit by bit and not by the library.
fn with_checksum(body: &[u8], position: RecordPosition) -> Vec<u8> {
    let mut crc = u32::MAX;
    let prefix = [&position.sequence.to_le_bytes()[..], &position.log_time.to_le_bytes()[..]].concat();
    for byte in prefix.iter().chain(body) {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    [body, &(!crc).to_le_bytes()].concat()
}

/// `tests/data/messages.txt` has the messages; with `POSEBRIDGE_WRITE_OUTPUTS=1` their contents are written anew.
#[test]
fn the_bytes_are_those_of_the_format_page() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/messages.txt");
    let kept = std::fs::read_to_string(path).unwrap();
    let mut found = String::new();
    for line in kept.lines() {
        let hex = line.split(" = ").next().unwrap();
        if hex.is_empty() || hex.starts_with('#') {
            found.extend([line, "\n"]);
            continue;
        }
        let body: Vec<u8> = hex.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        let bytes = with_checksum(&body, POSITION);
        let decoded = decode(&bytes, POSITION);
        // Older layouts are read only.
        if let Ok(input) = &decoded
            && body[0] >= ENCODING_VERSION
        {
            let mut written = Vec::new();
            encode(input, POSITION, &mut written);
            assert_eq!(written, bytes, "{input:?}");
        }
        found += &decoded.map_or_else(|error| format!("{hex} = {error:?}\n"), |input| format!("{hex} = {input:?}\n"));
    }
    if std::env::var_os("POSEBRIDGE_WRITE_OUTPUTS").is_some() {
        std::fs::write(path, &found).unwrap();
    }
    for (found, expected) in found.lines().zip(kept.lines()) {
        assert_eq!(found, expected);
    }
}

#[test]
fn a_time_beyond_the_host_clock_is_refused_and_not_turned_negative() {
    let at = |log_time| {
        let position = RecordPosition { sequence: 0, log_time };
        decode(&with_checksum(&[ENCODING_VERSION, tag::TICK], position), position)
    };
    let last = i64::MAX as u64;
    assert_eq!(at(last), Ok(Input::Tick));
    assert_eq!(at(last + 1), Err(DecodeError::Time(last + 1)));
    assert_eq!(at(u64::MAX), Err(DecodeError::Time(u64::MAX)));
}

#[test]
fn a_message_at_another_place_is_damage() {
    let bytes = with_checksum(&[1, 4], POSITION);
    let elsewhere = RecordPosition { sequence: 1, ..POSITION };
    assert!(matches!(decode(&bytes, elsewhere), Err(DecodeError::Checksum { .. })));
}
