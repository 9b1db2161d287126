//! Any text as a key file, and any text as the state that is stored beside a key.

use posebridge::config::MemoryRecord;
use posebridge_protocol::signing::{
    Key, KeyError, LinkSigner, ShutdownKind, SigningConfig, SigningState, SigningTime, UnsignedPolicy,
};
use posebridge_telemetry::Timestamp;

use super::inputs::{key, start};

/// Digits of a key.
const DIGITS: usize = 64;

/// Input: the text of a key file; bytes that are none never come this far.
pub(super) fn check_key(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let characters: Vec<char> = text.trim().chars().collect();
    match text.parse::<Key>() {
        Ok(key) => {
            let hex = key.reveal_hex();
            assert_eq!(hex, text.trim().to_lowercase());
            assert_eq!(hex.parse::<Key>().as_ref(), Ok(&key));
            let shown = format!("{key:?} {}", key.name());
            // Eight digits of a hash may stand in a key by chance; sixteen of its own must not stand in what is shown.
            let mut parts = hex.as_bytes().windows(16);
            assert!(parts.all(|part| !shown.as_bytes().windows(16).any(|seen| seen == part)));
        }
        Err(KeyError::Length { found }) => {
            assert_eq!(found, characters.len());
            assert_ne!(found, DIGITS);
        }
        Err(KeyError::Digit { position }) => {
            assert_eq!(characters.len(), DIGITS);
            let first = characters.iter().position(|digit| !digit.is_ascii_hexdigit());
            assert_eq!(first, position.checked_sub(1));
        }
        Err(other) => panic!("{other}"),
    }
}

/// Input: the text of a memory, as it stands in a file beside a key and in a recording's configuration.
pub(super) fn check_memory(data: &[u8]) {
    let Ok(record) = std::str::from_utf8(data)
        .map_or_else(|_no_text| Err(None), |text| toml::from_str::<MemoryRecord>(text).map_err(Some))
    else {
        return;
    };
    let memory = record.memory();
    check_written(&memory);
    for ending in [ShutdownKind::Clean, ShutdownKind::Interrupted] {
        for utc in (0..4).map(start) {
            check_resumed(&memory, utc, ending);
        }
    }
}

/// A memory is read as it was written.
fn check_written(memory: &SigningState) {
    let written = toml::to_string(&MemoryRecord::of(&key(0), memory)).map_err(|error| error.to_string());
    let again =
        written.and_then(|text| toml::from_str::<MemoryRecord>(&text).map_err(|error| format!("{error}\n{text}")));
    match again {
        Ok(again) => assert_eq!(again.memory(), *memory),
        Err(error) => panic!("a memory cannot be kept: {error}"),
    }
}

/// No time goes back by a restart, and what was used is not used again.
fn check_resumed(memory: &SigningState, utc: SigningTime, ending: ShutdownKind) {
    let resumed = memory.clone().resume(utc, ending);
    assert_eq!(resumed.written_at, utc);
    assert!(resumed.clock >= memory.clock && resumed.clock >= utc);
    assert!(resumed.last_sent >= memory.last_sent);
    assert_eq!(resumed.min_timestamp, memory.min_timestamp);
    assert_eq!(resumed.streams.len(), memory.streams.len());
    for (stream, heard) in &memory.streams {
        let after = resumed.streams.get(stream).map(|heard| heard.timestamp);
        assert!(after >= Some(heard.timestamp), "{stream:?}");
    }
    let own = resumed.last_sent;
    let mut link =
        LinkSigner::new(SigningConfig { key: key(0), link_id: 0, unsigned: UnsignedPolicy::Accept, state: resumed });
    let is_signed = link.next_signer(Timestamp::ZERO).is_some();
    assert_eq!(is_signed, own < SigningTime::MAX, "{own:?}");
    assert!(link.state(Timestamp::ZERO).last_sent > own || !is_signed);
}
