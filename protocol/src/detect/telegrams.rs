//! Length-prefixed telegrams of LEGO bricks over Bluetooth, detected by chains of lengths.
//!
//! Neither protocol has a start byte or a checksum. So a stream counts as telegrams if from some offset on each length
//! leads to another plausible telegram until the bytes end. Only telegrams that a brick sends are considered.
//!
//! # Sources
//! NXT: LEGO MINDSTORMS NXT Bluetooth Developer Kit, appendix 1 (length, little-endian, excludes itself) and appendix 2
//! (reply 02, opcode, status; message write 80 09). EV3: LEGO MINDSTORMS EV3 Communication Developer Kit, section 3
//! (length, message counter, reply type; system command 81 9E writes a mailbox).

use super::protocol::{Protocol, UnitCounts};

/// Longest telegram that an NXT sends: its buffer for Bluetooth.
const NXT_MAX_BYTES: usize = 128;
/// Longest that an EV3 sends: its buffer for replies.
const EV3_MAX_BYTES: usize = 1024;
/// How far a first telegram may have begun before the bytes do, EV3's longest.
const MAX_SKIPPED: usize = EV3_MAX_BYTES + LENGTH_BYTES;
/// Bytes of the length in front of each telegram.
const LENGTH_BYTES: usize = 2;
/// Telegrams in a row that are needed when they do not start at the first byte.
const MIN_TELEGRAMS: usize = 3;

/// Whether bytes without their length are a telegram that a brick of this kind sends.
type TelegramPredicate = fn(&[u8]) -> bool;

/// No telegram is one of both.
const TELEGRAM_KINDS: &[(Protocol, TelegramPredicate)] = &[(Protocol::Ev3, is_of_ev3), (Protocol::Nxt, is_of_nxt)];

/// The protocol whose telegrams fill the bytes.
pub(super) fn detect_telegrams(bytes: &[u8]) -> Option<(Protocol, UnitCounts)> {
    for skipped in 0..bytes.len().min(MAX_SKIPPED) {
        let rest = bytes.get(skipped..).unwrap_or_default();
        for (protocol, is_telegram) in TELEGRAM_KINDS {
            if let Some(tally) = count_chain(rest, *is_telegram)
                && (tally.frames >= MIN_TELEGRAMS || tally.bytes == bytes.len())
            {
                return Some((*protocol, tally));
            }
        }
    }
    None
}

/// The telegrams, if they follow each other until fewer bytes are left than the last one claims.
fn count_chain(mut rest: &[u8], is_telegram: TelegramPredicate) -> Option<UnitCounts> {
    let mut tally = UnitCounts::default();
    while let Some((length, behind)) = rest.split_first_chunk::<LENGTH_BYTES>() {
        let length = usize::from(u16::from_le_bytes(*length));
        let Some((telegram, behind)) = behind.split_at_checked(length) else {
            // The last one is cut off by the end of the listening; a length that no telegram has is none.
            return (length <= EV3_MAX_BYTES).then_some(tally);
        };
        if !is_telegram(telegram) {
            return None;
        }
        tally.add(LENGTH_BYTES + length);
        rest = behind;
    }
    Some(tally)
}

/// A reply with a status that the firmware knows, or a message from a program on the brick.
fn is_of_nxt(telegram: &[u8]) -> bool {
    if telegram.len() > NXT_MAX_BYTES {
        return false;
    }
    match telegram {
        [0x02, opcode, status, ..] => is_nxt_opcode(*opcode) && is_nxt_status(*status),
        [0x80, 0x09, inbox, size, message @ ..] => *inbox < 20 && usize::from(*size) == message.len(),
        _ => false,
    }
}

/// Direct commands 00 to 13, system commands 80 to A2.
const fn is_nxt_opcode(opcode: u8) -> bool {
    matches!(opcode, 0x00..=0x13 | 0x80..=0xA2)
}

/// Success, pending, empty queue, and the errors of the developer kit's tables.
const fn is_nxt_status(status: u8) -> bool {
    matches!(
        status,
        0x00 | 0x20 | 0x40 | 0x81..=0x93 | 0xBD..=0xC0 | 0xDD..=0xE0 | 0xEC..=0xF0 | 0xFB | 0xFF
    )
}

/// A reply behind its counter, or a mailbox that a program on the brick writes.
fn is_of_ev3(telegram: &[u8]) -> bool {
    match telegram {
        // Replies to direct and to system commands, with and without an error.
        [_, _, 0x02..=0x05, ..] => telegram.len() <= EV3_MAX_BYTES,
        [_, _, 0x81, 0x9E, rest @ ..] => is_mailbox(rest),
        _ => false,
    }
}

/// Length of the name, name, length of the payload, payload.
fn is_mailbox(rest: &[u8]) -> bool {
    let Some((name_length, rest)) = rest.split_first() else {
        return false;
    };
    let Some((_, payload)) = rest.split_at_checked(usize::from(*name_length)) else {
        return false;
    };
    payload
        .split_first_chunk::<LENGTH_BYTES>()
        .is_some_and(|(length, payload)| usize::from(u16::from_le_bytes(*length)) == payload.len())
}
