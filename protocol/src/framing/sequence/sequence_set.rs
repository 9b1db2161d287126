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
        let words = self.0.into_iter().zip((0_u8..=192).step_by(64));
        words.flat_map(|(word, first)| set_bits(word).map(move |one| first + one))
    }

    /// Those of its numbers that are among the 64 behind `from` on the circle, each as how far ahead of `from` it lies, the nearest first.
    pub(super) fn ahead_of(&self, from: u8) -> impl Iterator<Item = u8> {
        let first = from.wrapping_add(1);
        let (at, shift) = (word(first), first & 63);
        let near = self.0[at] >> shift;
        // Shifted out completely where the 64 numbers fill one word.
        let far = self.0[(at + 1) % 4].checked_shl(64 - u32::from(shift));
        set_bits(near | far.unwrap_or(0)).map(|one| one + 1)
    }
}

/// The places of the bits that are set, the lowest first.
fn set_bits(mut word: u64) -> impl Iterator<Item = u8> {
    std::iter::from_fn(move || {
        let place = (word != 0).then(|| word.trailing_zeros() as u8);
        word &= word.wrapping_sub(1);
        place
    })
}

/// Two bits of a `u8` are at most 3.
const fn word(sequence: u8) -> usize {
    (sequence >> 6) as usize
}

const fn bit(sequence: u8) -> u64 {
    1 << (sequence & 63)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_are_found_by_asking_for_each(numbers in proptest::collection::vec(0..=u8::MAX, 0..40), from in 0..=u8::MAX) {
            let mut set = SequenceSet::default();
            for number in &numbers {
                set.insert(*number);
            }
            let asked = (0..=u8::MAX).filter(|number| set.contains(*number));
            prop_assert!(set.iter().eq(asked));
            let ahead = (1..=64).filter(|ahead: &u8| set.contains(from.wrapping_add(*ahead)));
            prop_assert!(set.ahead_of(from).eq(ahead));
        }
    }
}
