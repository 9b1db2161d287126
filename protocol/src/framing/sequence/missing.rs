//! Sets of frames by their numbers: the missing ones among a sender's latest frames, and the received ones of the 256
//! numbers.

/// Number of remembered frames: at 100 per second a stall of twenty seconds.
const WINDOW: u64 = 2_048;

/// The latest frames by their unwrapped numbers, with a bit for each missing one.
#[derive(Clone, Debug, Default)]
pub(super) struct MissingFrames {
    bits: [u64; (WINDOW / 64) as usize],
    newest: u64,
}

impl MissingFrames {
    pub(super) const fn push_received(&mut self) {
        self.newest += 1;
        self.remove(self.newest);
    }

    pub(super) const fn push_missing(&mut self) {
        self.newest += 1;
        self.insert(self.newest);
    }

    /// Whether the frame at this distance before the newest is missing; false if it is unknown.
    pub(super) const fn contains(&self, behind: u64) -> bool {
        if behind >= WINDOW || behind > self.newest {
            return false;
        }
        let number = self.newest - behind;
        self.bits[word_index(number)] & bit(number) != 0
    }

    /// Records the late arrival of the frame at this distance before the newest; false if it was not missing, or is
    /// unknown.
    pub(super) const fn recover_late(&mut self, behind: u64) -> bool {
        let was_missing = self.contains(behind);
        if was_missing {
            self.remove(self.newest - behind);
        }
        was_missing
    }

    const fn insert(&mut self, number: u64) {
        self.bits[word_index(number)] |= bit(number);
    }

    const fn remove(&mut self, number: u64) {
        self.bits[word_index(number)] &= !bit(number);
    }
}

const fn word_index(number: u64) -> usize {
    (number % WINDOW / 64) as usize
}

const fn bit(number: u64) -> u64 {
    1 << (number % 64)
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SequenceSet([u64; 4]);

impl SequenceSet {
    pub(super) const fn insert(&mut self, sequence: u8) {
        self.0[word_index(sequence as u64)] |= bit(sequence as u64);
    }

    pub(super) const fn contains(&self, sequence: u8) -> bool {
        self.0[word_index(sequence as u64)] & bit(sequence as u64) != 0
    }

    /// In increasing order.
    pub(super) fn iter(&self) -> impl Iterator<Item = u8> {
        let words = self.0.into_iter().zip((0_u8..=192).step_by(64));
        words.flat_map(|(word, first)| set_bits(word).map(move |one| first + one))
    }

    /// The numbers among the 64 after `from` on the circle, each as its distance from `from`, the nearest first.
    pub(super) fn ahead_of(&self, from: u8) -> impl Iterator<Item = u8> {
        let first = from.wrapping_add(1);
        let (at, shift) = (word_index(u64::from(first)), first & 63);
        let near = self.0[at] >> shift;
        // Shifted out completely where the 64 numbers fill one word.
        let far = self.0[(at + 1) % 4].checked_shl(64 - u32::from(shift));
        set_bits(near | far.unwrap_or(0)).map(|one| one + 1)
    }
}

fn set_bits(mut word: u64) -> impl Iterator<Item = u8> {
    std::iter::from_fn(move || {
        let bit_index = (word != 0).then(|| word.trailing_zeros() as u8);
        word &= word.wrapping_sub(1);
        bit_index
    })
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
            let expected = (0..=u8::MAX).filter(|number| set.contains(*number));
            prop_assert!(set.iter().eq(expected));
            let ahead = (1..=64).filter(|ahead: &u8| set.contains(from.wrapping_add(*ahead)));
            prop_assert!(set.ahead_of(from).eq(ahead));
        }
    }
}
