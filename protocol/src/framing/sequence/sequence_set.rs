//! A set of sequence numbers: one bit for each of the 256.

/// Which of the 256 numbers are in it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SequenceSet([u64; 4]);

impl SequenceSet {
    pub(super) const fn insert(&mut self, sequence: u8) {
        self.0[word(sequence)] |= bit(sequence);
    }

    pub(super) const fn contains(&self, sequence: u8) -> bool {
        self.0[word(sequence)] & bit(sequence) != 0
    }

    /// Its numbers, the smallest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = u8> {
        (0..=u8::MAX).filter(|sequence| self.contains(*sequence))
    }
}

/// Two bits of a `u8` are at most 3.
const fn word(sequence: u8) -> usize {
    (sequence >> 6) as usize
}

const fn bit(sequence: u8) -> u64 {
    1 << (sequence & 63)
}
