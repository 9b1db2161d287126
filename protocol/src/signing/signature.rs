//! The signature of a frame and its time; nothing else computes with the calendar.

use posebridge_telemetry::TimeDelta;
use sha2::{Digest, Sha256};

use super::key::Key;
use crate::framing::FrameRef;

/// Bytes of the hash in a signature; link id (1) and timestamp (6) precede it.
const MAC: usize = 6;
/// 2015-01-01 00:00 UTC in microseconds since 1970: 1 420 070 400 s, MAVLink guide, "Timestamp Handling".
const EPOCH_UNIX_MICROS: u64 = 1_420_070_400_000_000;
const UNIT_NANOS: i64 = 10_000;
const MAX_UNITS: u64 = (1 << 48) - 1;

/// An instant as signatures state it: units of 10 µs since 2015-01-01 UTC, 48 bits, which last until 2104.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct SigningTime(u64);

impl SigningTime {
    pub const ZERO: Self = Self(0);
    pub const MAX: Self = Self(MAX_UNITS);

    /// Saturates at 48 bits.
    pub const fn from_units(units: u64) -> Self {
        if units > MAX_UNITS { Self::MAX } else { Self(units) }
    }

    /// [`Self::ZERO`] for instants before 2015.
    pub const fn from_unix_micros(micros: u64) -> Self {
        Self::from_units(micros.saturating_sub(EPOCH_UNIX_MICROS) / 10)
    }

    pub const fn units(self) -> u64 {
        self.0
    }

    /// Cut to full units; saturates, and a negative duration changes nothing.
    pub fn saturating_add(self, duration: TimeDelta) -> Self {
        let units = u64::try_from(duration.as_nanos() / UNIT_NANOS).unwrap_or(0);
        Self::from_units(self.0.saturating_add(units))
    }

    /// Zero if `earlier` is not earlier.
    pub fn since(self, earlier: Self) -> TimeDelta {
        let units = i64::try_from(self.0.saturating_sub(earlier.0)).unwrap_or(i64::MAX);
        TimeDelta::from_nanos(units.saturating_mul(UNIT_NANOS))
    }

    pub fn next(self) -> Option<Self> {
        (self < Self::MAX).then_some(Self(self.0 + 1))
    }

    pub(super) const fn to_wire(self) -> [u8; 6] {
        let [a, b, c, d, e, f, _, _] = self.0.to_le_bytes();
        [a, b, c, d, e, f]
    }

    pub(super) const fn from_wire(wire: [u8; 6]) -> Self {
        let [a, b, c, d, e, f] = wire;
        Self(u64::from_le_bytes([a, b, c, d, e, f, 0, 0]))
    }
}

/// Signs one frame of our own; its timestamp is used once.
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

#[derive(Clone, Copy, Debug)]
pub(super) struct Signature<'a> {
    pub(super) link_id: u8,
    pub(super) timestamp: SigningTime,
    mac: [u8; MAC],
    /// Everything before the hash.
    signed_bytes: &'a [u8],
}

impl<'a> Signature<'a> {
    pub(super) fn parse(frame: &FrameRef<'a>) -> Option<Self> {
        if !frame.is_signed() {
            return None;
        }
        let (covered, mac) = frame.raw.split_last_chunk::<MAC>()?;
        let (_, signing_fields) = covered.split_last_chunk::<{ 1 + 6 }>()?;
        let [link_id, a, b, c, d, e, f] = *signing_fields;
        Some(Self { link_id, timestamp: SigningTime::from_wire([a, b, c, d, e, f]), mac: *mac, signed_bytes: covered })
    }

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

/// Compares in constant time: whoever could measure the length of the matching prefix would need 6 · 256 guesses and
/// not 256⁶.
fn is_equal(a: [u8; MAC], b: [u8; MAC]) -> bool {
    let differing = a.iter().zip(b).fold(0, |bits, (a, b)| bits | (a ^ b));
    // Hidden from the optimiser, which might leave early once a bit is set.
    std::hint::black_box(differing) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_epoch_is_the_beginning_of_2015() {
        // `date -u -d 2015-01-01 +%s` says 1420070400.
        assert_eq!(SigningTime::from_unix_micros(1_420_070_400_000_000), SigningTime::ZERO);
        assert_eq!(SigningTime::from_unix_micros(1_420_070_401_000_019).units(), 100_001);
        assert_eq!(SigningTime::from_unix_micros(0), SigningTime::ZERO);
        assert_eq!(SigningTime::from_unix_micros(u64::MAX), SigningTime::MAX);
    }

    #[test]
    fn durations_are_counted_in_full_units_and_never_backwards() {
        let start = SigningTime::from_units(7);
        assert_eq!(start.saturating_add(TimeDelta::from_nanos(19_999)).units(), 8);
        assert_eq!(start.saturating_add(TimeDelta::from_millis(-1)), start);
        assert_eq!(SigningTime::MAX.saturating_add(TimeDelta::from_millis(1)), SigningTime::MAX);
        assert_eq!(SigningTime::from_units(107).since(start), TimeDelta::from_millis(1));
        assert_eq!(start.since(SigningTime::MAX), TimeDelta::ZERO);
        assert_eq!(SigningTime::MAX.next(), None);
    }

    #[test]
    fn differences_of_two_bytes_do_not_cancel() {
        assert!(is_equal([7; MAC], [7; MAC]));
        assert!(!is_equal([7; MAC], [7, 7, 7, 8, 8, 7]));
        assert!((0..MAC).all(|at| !is_equal([0; MAC], std::array::from_fn(|index| u8::from(index == at)))));
    }

    #[test]
    fn six_bytes_hold_it_completely() {
        let stamp = SigningTime::from_units(0x1234_5678_9ABC);
        assert_eq!(stamp.to_wire(), [0xBC, 0x9A, 0x78, 0x56, 0x34, 0x12]);
        assert_eq!(SigningTime::from_wire(stamp.to_wire()), stamp);
    }
}
