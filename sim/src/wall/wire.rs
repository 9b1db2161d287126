//! The short frames between brick and host in the approach over a link: one kind each for readings, commands and estimates.
//!
//! ```text
//! 0xA7 | kind | time, first and second value: three f64, little endian | CRC-16/MCRF4XX of kind and values, little endian
//! ```
//! 28 bytes. They stand for what a brick of this class would say in a protocol of its own; no other program speaks it.

use posebridge_protocol::framing::checksum;

const START: u8 = 0xa7;
const LENGTH: usize = 28;
/// What the checksum begins with, beside the bytes: none of a real dialect.
const EXTRA: u8 = 0x57;

/// The content of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum WallFrame {
    /// Time in s, range in m.
    Reading(f64, f64),
    /// From when in s, PWM.
    Command(f64, f64),
    /// Time in s, distance in m, speed towards the wall in m/s.
    Estimate(f64, f64, f64),
}

impl WallFrame {
    pub(super) fn encode(self) -> [u8; LENGTH] {
        let (kind, values) = match self {
            Self::Reading(at_s, range_m) => (1, [at_s, range_m, 0.0]),
            Self::Command(at_s, pwm) => (2, [at_s, pwm, 0.0]),
            Self::Estimate(at_s, distance_m, towards) => (3, [at_s, distance_m, towards]),
        };
        let mut bytes = [0; LENGTH];
        bytes[0] = START;
        bytes[1] = kind;
        for (place, value) in bytes[2..26].chunks_exact_mut(8).zip(values) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        let sum = checksum(&bytes[1..26], EXTRA);
        bytes[26..].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// Takes one apart; `None` unless it is whole and every value finite.
    fn decode(bytes: &[u8; LENGTH]) -> Option<Self> {
        let [start, kind, ..] = *bytes;
        let sum = checksum(&bytes[1..26], EXTRA);
        if start != START || bytes[26..] != sum.to_le_bytes() {
            return None;
        }
        let mut values = [0.0; 3];
        for (value, place) in values.iter_mut().zip(bytes[2..26].chunks_exact(8)) {
            *value = f64::from_le_bytes(place.try_into().ok()?);
        }
        let [at_s, first, second] = values;
        if !values.iter().all(|value| value.is_finite()) {
            return None;
        }
        match kind {
            1 => Some(Self::Reading(at_s, first)),
            2 => Some(Self::Command(at_s, first)),
            3 => Some(Self::Estimate(at_s, first, second)),
            _ => None,
        }
    }
}

/// Finds frames in what arrives, in pieces of any size.
#[derive(Debug, Default)]
pub(super) struct WallFramer {
    held: Vec<u8>,
}

impl WallFramer {
    /// The frames that are whole now, in order.
    pub(super) fn push(&mut self, bytes: &[u8]) -> Vec<WallFrame> {
        self.held.extend_from_slice(bytes);
        let mut found = Vec::new();
        let mut at = 0;
        while let Some(candidate) = self.held.get(at..).and_then(|rest| rest.first_chunk()) {
            let frame = WallFrame::decode(candidate);
            // One byte after a defect: a real frame may begin inside it.
            at += if frame.is_some() { LENGTH } else { 1 };
            found.extend(frame);
        }
        self.held.drain(..at);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_found_in_any_pieces_and_between_garbage() {
        let frames =
            [WallFrame::Reading(1.25, 0.304), WallFrame::Command(2.5, -80.0), WallFrame::Estimate(-3.0, 1e-9, 7.0)];
        let mut bytes = vec![START, 1, 2];
        for frame in frames {
            bytes.extend(frame.encode());
            bytes.push(START);
        }
        for piece in 1..40 {
            let mut framer = WallFramer::default();
            let mut found: Vec<WallFrame> = bytes.chunks(piece).flat_map(|chunk| framer.push(chunk)).collect();
            found.extend(framer.push(&[0; LENGTH]));
            assert_eq!(found, frames, "{piece}");
        }
    }

    #[test]
    fn a_flipped_bit_and_a_value_that_is_none_are_no_frames() {
        let good = WallFrame::Reading(1.0, 2.0).encode();
        for index in 0..LENGTH {
            let mut bad = good;
            bad[index] ^= 4;
            assert_eq!(WallFrame::decode(&bad), None, "{index}");
        }
        assert_eq!(WallFrame::decode(&WallFrame::Command(f64::NAN, 0.0).encode()), None);
    }
}
