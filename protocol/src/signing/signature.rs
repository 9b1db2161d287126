//! The 13 bytes behind a frame: made, found and compared.

use sha2::{Digest, Sha256};

use super::clock::SigningTime;
use super::key::Key;
use crate::framing::{FrameRef, START_BYTE_V2};

/// Bytes of the hash that a signature holds.
const MAC: usize = 6;
/// Bytes of a signature: link id, timestamp, hash.
const LENGTH: usize = 1 + 6 + MAC;

/// What one frame of our own is signed with; its timestamp is used up.
#[derive(Clone, Copy, Debug)]
pub struct FrameSigner<'k> {
    pub(super) key: &'k Key,
    pub(super) link_id: u8,
    pub(super) timestamp: SigningTime,
}

impl FrameSigner<'_> {
    /// Appends the signature of the frame that begins at `start` and ends with its checksum at the end of `out`. The
    /// frame's header must have [`super::FLAG_SIGNED`] set, or no receiver will look for the signature.
    pub fn sign(&self, out: &mut Vec<u8>, start: usize) {
        out.push(self.link_id);
        out.extend_from_slice(&self.timestamp.to_wire());
        let mac = mac(self.key, out.get(start..).unwrap_or_default());
        out.extend_from_slice(&mac);
    }
}

/// A frame's signature, not yet verified.
#[derive(Clone, Copy, Debug)]
pub(super) struct Signature<'a> {
    pub(super) link_id: u8,
    pub(super) timestamp: SigningTime,
    mac: [u8; MAC],
    /// Everything before the hash.
    signed_bytes: &'a [u8],
}

impl<'a> Signature<'a> {
    /// The signature of a frame, if it has one.
    pub(super) fn parse(frame: &FrameRef<'a>) -> Option<Self> {
        let [START_BYTE_V2, _, flags, ..] = *frame.raw else {
            return None;
        };
        if flags & super::FLAG_SIGNED == 0 {
            return None;
        }
        let (covered, mac) = frame.raw.split_last_chunk::<MAC>()?;
        let (_, said) = covered.split_last_chunk::<{ LENGTH - MAC }>()?;
        let [link_id, a, b, c, d, e, f] = *said;
        Some(Self { link_id, timestamp: SigningTime::from_wire([a, b, c, d, e, f]), mac: *mac, signed_bytes: covered })
    }

    /// Whether it was made with this key over these bytes.
    pub(super) fn is_valid(&self, key: &Key) -> bool {
        is_equal(mac(key, self.signed_bytes), self.mac)
    }
}

fn mac(key: &Key, covered: &[u8]) -> [u8; MAC] {
    let mut hash = Sha256::new();
    hash.update(key.bytes());
    hash.update(covered);
    let mut mac = [0; MAC];
    for (byte, of_hash) in mac.iter_mut().zip(hash.finalize()) {
        *byte = of_hash;
    }
    mac
}

/// Compares in the same time wherever the difference is: who could measure how far a guess is right would need 6 · 256
/// guesses and not 256⁶.
fn is_equal(a: [u8; MAC], b: [u8; MAC]) -> bool {
    let differing = a.iter().zip(b).fold(0, |bits, (a, b)| bits | (a ^ b));
    // Hidden from the optimiser, which might leave early once a bit is set.
    std::hint::black_box(differing) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_the_hash_counts() {
        let a = [0x5A; MAC];
        assert!(is_equal(a, a));
        for bit in 0..8 * MAC {
            let mut b = a;
            b[bit / 8] ^= 1 << (bit % 8);
            assert!(!is_equal(a, b), "bit {bit}");
        }
    }
}
