//! Which of a sender's latest frames are missing: they may still come.

/// Number of the latest frames that are remembered: at 100 per second what a stall of twenty seconds holds back.
const WINDOW: u64 = 2_048;

/// The latest frames by their unwrapped numbers, a bit for each that is missing.
#[derive(Clone, Debug)]
pub(super) struct MissingFrames {
    bits: [u64; (WINDOW / 64) as usize],
    /// The newest frame.
    newest: u64,
}

impl MissingFrames {
    /// Nothing is missing before the first frame.
    pub(super) const fn new() -> Self {
        Self { bits: [0; (WINDOW / 64) as usize], newest: 0 }
    }

    /// The next frame has come.
    pub(super) const fn push_received(&mut self) {
        self.newest += 1;
        self.remove(self.newest);
    }

    /// The next frame has not come.
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
        self.bits[word(number)] & bit(number) != 0
    }

    /// The frame at this distance before the newest has come after all; false if it was not missing, or it is unknown.
    pub(super) const fn recover_late(&mut self, behind: u64) -> bool {
        let was_missing = self.contains(behind);
        if was_missing {
            self.remove(self.newest - behind);
        }
        was_missing
    }

    const fn insert(&mut self, number: u64) {
        self.bits[word(number)] |= bit(number);
    }

    const fn remove(&mut self, number: u64) {
        self.bits[word(number)] &= !bit(number);
    }
}

const fn word(number: u64) -> usize {
    (number % WINDOW / 64) as usize
}

const fn bit(number: u64) -> u64 {
    1 << (number % 64)
}
