//! Signatures: no frame is believed twice or changed, stamps of our own only rise, and what is kept between sessions survives it.
//!
//! The first byte says what the others are: bytes of a link with foreign signatures, a conversation of several senders, the text of
//! a key file, or the text of what is kept beside a key.

mod stored;
mod talk;
mod wire;

use posebridge_protocol::framing::{FrameRef, Scanned, Scanner, ScannerConfig};
use posebridge_protocol::signing::{Key, Timestamp};
use posebridge_telemetry::Stamp;

use crate::operands::Operands;

/// Input: one byte that chooses the part, then what that part reads.
pub(crate) fn check(data: &[u8]) {
    let mut operands = Operands::new(data);
    match operands.byte() % 4 {
        0 => wire::check(operands),
        1 => talk::check(operands),
        2 => stored::check_key(operands.rest()),
        _ => stored::check_memory(operands.rest()),
    }
}

/// The two keys of protocol/tests/data/signed.json, so that its frames can be seeds.
fn key(choice: u8) -> Key {
    let byte = |at: u8| match choice % 2 {
        0 => at,
        _ => 0xFF_u8.wrapping_sub(at.wrapping_mul(5)),
    };
    let mut bytes = [0; 32];
    for (at, place) in (0..).zip(&mut bytes) {
        *place = byte(at);
    }
    Key::from_bytes(bytes)
}

/// A time to begin with: the first there is, one in 2025, one shortly before the last there is, and the last.
fn start(choice: u8) -> Timestamp {
    let last = Timestamp::MAX.units();
    Timestamp::from_units(match choice % 4 {
        0 => 0,
        1 => 34_000_000_000_000,
        2 => last - 20_000_000,
        _ => last - u64::from(choice / 4),
    })
}

/// Every verified frame in some bytes, MAVLink 1 too.
fn frames(bytes: &[u8], mut look: impl FnMut(&FrameRef<'_>)) {
    let mut scanner = Scanner::new(ScannerConfig { accept_v1: true, ..ScannerConfig::default() });
    let mut take = |found: Scanned<'_>| {
        if let Scanned::Frame(frame) | Scanned::Unknown(frame) = found {
            look(&frame);
        }
    };
    scanner.push(Stamp::ZERO, bytes, &mut take);
    if let Some(deadline) = scanner.deadline() {
        scanner.tick(deadline, &mut take);
    }
}
