//! The checksum of MAVLink: CRC-16/MCRF4XX (reflected 0x1021, start 0xFFFF, no final inversion).
//!
//! Almost all the time of receiving goes into this sum, so it takes sixteen bytes per step from sixteen tables ("slicing",
//! Kounavis and Berry 2005), or, where the processor can multiply without carries, thirty-two at a time.

/// The generator polynomial 0x1021, bits reversed.
const POLYNOMIAL: u16 = 0x8408;
/// The start value.
const START: u16 = 0xFFFF;
/// Bytes per step of the sliced sum.
const SLICES: usize = 16;
/// From this length on the carry-less multiplier pays for its set-up: `cargo bench` shows no clear winner at 32 bytes and a
/// third less time at 64.
#[cfg(target_arch = "x86_64")]
const CLMUL_FROM: usize = 64;

/// `TABLES[k][b]` is the remainder of byte `b` followed by `k` zero bytes.
static TABLES: [[u16; 256]; SLICES] = tables();

const fn tables() -> [[u16; 256]; SLICES] {
    let mut tables = [[0_u16; 256]; SLICES];
    let mut byte = 0;
    while byte < 256 {
        let mut remainder = byte as u16;
        let mut bit = 0;
        while bit < 8 {
            remainder = if remainder & 1 == 1 { (remainder >> 1) ^ POLYNOMIAL } else { remainder >> 1 };
            bit += 1;
        }
        tables[0][byte] = remainder;
        byte += 1;
    }
    let mut slice = 1;
    while slice < SLICES {
        let mut byte = 0;
        while byte < 256 {
            let previous = tables[slice - 1][byte];
            tables[slice][byte] = (previous >> 8) ^ tables[0][(previous & 0xFF) as usize];
            byte += 1;
        }
        slice += 1;
    }
    tables
}

/// A way to compute the sum; all give the same result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crc {
    /// One table, one byte per step: the definition.
    Bytewise,
    /// Sixteen tables, sixteen bytes per step.
    Sliced,
    /// Carry-less multiplication where the processor has it, sliced elsewhere.
    Widest,
}

impl Crc {
    /// The sum of `bytes` from the standard start value.
    #[must_use]
    pub fn sum(self, bytes: &[u8]) -> u16 {
        match self {
            Self::Bytewise => bytewise(START, bytes),
            Self::Sliced => sliced(START, bytes),
            Self::Widest => widest(START, bytes),
        }
    }
}

/// The checksum of a frame: over `bytes` (everything between the start byte and the checksum), then over the message's
/// CRC_EXTRA.
#[must_use]
pub fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    step(widest(START, bytes), crc_extra)
}

/// The CRC_EXTRA with which `bytes` have this checksum; `None` if there is none. There is never more than one, because the last
/// step of the sum takes every byte to another remainder.
pub(crate) fn crc_extra_of(bytes: &[u8], sum: u16) -> Option<u8> {
    let before = widest(START, bytes);
    (0..=u8::MAX).find(|extra| step(before, *extra) == sum)
}

#[inline]
fn step(crc: u16, byte: u8) -> u16 {
    (crc >> 8) ^ TABLES[0][usize::from((crc as u8) ^ byte)]
}

fn bytewise(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| step(crc, byte))
}

pub(super) fn sliced(mut crc: u16, bytes: &[u8]) -> u16 {
    let (chunks, rest) = bytes.as_chunks::<SLICES>();
    for chunk in chunks {
        let [low, high] = crc.to_le_bytes();
        let mut next = TABLES[15][usize::from(chunk[0] ^ low)] ^ TABLES[14][usize::from(chunk[1] ^ high)];
        for (index, &byte) in chunk.iter().enumerate().skip(2) {
            next ^= TABLES[SLICES - 1 - index][usize::from(byte)];
        }
        crc = next;
    }
    short(crc, rest)
}

/// The sum of fewer bytes than there are tables: each has its own, so that no lookup waits for the one before.
#[inline]
fn short(crc: u16, bytes: &[u8]) -> u16 {
    let [first, second, behind @ ..] = bytes else {
        return bytewise(crc, bytes);
    };
    let [low, high] = crc.to_le_bytes();
    let next = TABLES[behind.len() + 1][usize::from(first ^ low)] ^ TABLES[behind.len()][usize::from(second ^ high)];
    let tables = TABLES[..behind.len()].iter().rev();
    tables.zip(behind).fold(next, |sum, (table, &byte)| sum ^ table[usize::from(byte)])
}

#[inline]
fn widest(crc: u16, bytes: &[u8]) -> u16 {
    #[cfg(target_arch = "x86_64")]
    if bytes.len() >= CLMUL_FROM
        && let Some(crc) = super::crc_clmul::folded(crc, bytes)
    {
        return crc;
    }
    sliced(crc, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of the CRC catalogue (Greg Cook, reveng): the sum of "123456789".
    #[test]
    fn every_way_gives_the_published_check_value() {
        for way in [Crc::Bytewise, Crc::Sliced, Crc::Widest] {
            assert_eq!(way.sum(b"123456789"), 0x6F91, "{way:?}");
        }
    }

    #[test]
    fn every_way_agrees_at_every_length_and_alignment() {
        let mut state = 0x1234_5678_u32;
        let bytes: Vec<u8> = (0..320)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect();
        for length in 0..300 {
            for start in 0..16 {
                let part = &bytes[start..start + length];
                let defined = Crc::Bytewise.sum(part);
                assert_eq!(Crc::Sliced.sum(part), defined, "sliced, length {length}");
                assert_eq!(Crc::Widest.sum(part), defined, "widest, length {length}");
            }
        }
    }
}
