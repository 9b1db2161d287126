//! The estimate as a message for a program on the brick.
//!
//! # Model
//! ```text
//! telegram   length u16 | counter u16 | 81 | 9E | name length u8 | name 00 | payload length u16 | payload
//! payload    24 bytes, little-endian:
//!            tick_ms u32 | x_m f32 | y_m f32 | heading_rad f32 | sigma_m f32 | flags u8 | reset_counter u8 | sequence u16
//! ```
//! A brick on which no program has opened the mailbox drops the message.
//!
//! # Sources
//! LEGO MINDSTORMS EV3 Communication Developer Kit, section 3 (WRITEMAILBOX); captures by QUT's robotics toolbox for the EV3, in which
//! the length of the name counts its final zero.

use crate::message::{PlanarPose, PoseFlags};

/// System command without reply, WRITEMAILBOX.
const WRITE_MAILBOX: [u8; 2] = [0x81, 0x9E];
/// Counter, type, command, length of the name, length of the payload.
const HEAD_BYTES: usize = 7;
/// A name has one byte of length, with its final zero.
const MAX_NAME_BYTES: usize = 254;
/// Bytes of an estimate.
const ESTIMATE_BYTES: usize = 24;

/// Writes to a mailbox. Of a name that is too long the front is taken.
pub(super) fn encode_mailbox_write(counter: u16, name: &str, payload: &[u8]) -> Vec<u8> {
    let name = name.as_bytes();
    let name = name.get(..MAX_NAME_BYTES).unwrap_or(name);
    let length = (HEAD_BYTES + name.len() + 1 + payload.len()) as u16;
    let mut telegram = Vec::with_capacity(usize::from(length) + 2);
    telegram.extend(length.to_le_bytes());
    telegram.extend(counter.to_le_bytes());
    telegram.extend(WRITE_MAILBOX);
    telegram.push((name.len() + 1) as u8);
    telegram.extend(name);
    telegram.push(0);
    telegram.extend((payload.len() as u16).to_le_bytes());
    telegram.extend(payload);
    telegram
}

/// The payload of an estimate; `None` if a number of it is not finite.
pub(super) fn encode_estimate(pose: &PlanarPose, sequence: u16) -> Option<[u8; ESTIMATE_BYTES]> {
    let tick_ms = (pose.stamp.as_micros() / 1_000) as u32;
    let origin = pose.pose.origin();
    let [xx_m2, _, _, yy_m2, ..] = pose.covariance;
    let sigma_m = xx_m2.max(yy_m2).sqrt();
    let numbers = [origin.x.0, origin.y.0, pose.pose.heading.rad(), sigma_m];
    if numbers.iter().any(|number| !number.is_finite()) {
        return None;
    }
    let [x, y, heading, sigma] = numbers.map(|number| (number as f32).to_le_bytes());
    let tick = tick_ms.to_le_bytes();
    let mut payload = [0; ESTIMATE_BYTES];
    let last = [flags(pose.flags), pose.reset_counter];
    let bytes = [tick, x, y, heading, sigma].into_iter().flatten();
    let bytes = bytes.chain(last).chain(sequence.to_le_bytes());
    for (slot, byte) in payload.iter_mut().zip(bytes) {
        *slot = byte;
    }
    Some(payload)
}

/// Bit 0: the position is valid; bit 1: the heading is.
const fn flags(flags: PoseFlags) -> u8 {
    flags.position_valid as u8 | (flags.heading_valid as u8) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_for_a_mailbox_is_that_of_a_capture() {
        // QUT's robotics toolbox for the EV3.
        let captured = [
            0x12, 0x00, 0x01, 0x00, 0x81, 0x9E, 0x04, b'a', b'b', b'c', 0x00, 0x07, 0x00, b'h', b'e', b'l', b'l', b'o',
            b'!', 0x00,
        ];
        assert_eq!(encode_mailbox_write(1, "abc", b"hello!\0"), captured);
    }
}
