//! Damage to single bits and bytes, each independent of all others.
//!
//! # Model
//! ```text
//! bits until the next error ~ Geometric(bit error rate)        bytes until the next one is missing ~ Geometric(byte loss)
//! ```
//! Drawing the gap instead of every trial makes a rate of 1e-6 cost nothing.

use super::draws::failures_before_success;
use crate::random::RandomStream;

/// Independent events at a rate, drawn as the gaps between them.
#[derive(Clone, Debug)]
pub(super) struct ErrorGaps {
    probability: f64,
    /// Trials that still go well; drawn at the first one.
    until_next: Option<u64>,
    stream: RandomStream,
}

impl ErrorGaps {
    pub(super) const fn new(probability: f64, stream: RandomStream) -> Self {
        Self { probability, until_next: None, stream }
    }

    /// Which of the next `trials` are hit, counted from 0, in their order.
    pub(super) fn hits(&mut self, trials: u64) -> Vec<u64> {
        let mut hits = Vec::new();
        if self.probability <= 0.0 {
            return hits;
        }
        let mut until_next = match self.until_next {
            Some(until_next) => until_next,
            None => self.draw(),
        };
        let mut passed = 0;
        while until_next < trials - passed {
            passed += until_next;
            hits.push(passed);
            passed += 1;
            until_next = self.draw();
        }
        self.until_next = Some(until_next - (trials - passed));
        hits
    }

    fn draw(&mut self) -> u64 {
        failures_before_success(&mut self.stream, self.probability)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_the_trials_are_counted_does_not_change_the_hits() {
        let whole = ErrorGaps::new(0.2, RandomStream::new(4, "gaps")).hits(1_000);
        let mut parts = ErrorGaps::new(0.2, RandomStream::new(4, "gaps"));
        let mut found = Vec::new();
        let mut start = 0;
        for size in [1, 7, 0, 92, 400, 500] {
            found.extend(parts.hits(size).into_iter().map(|hit| hit + start));
            start += size;
        }
        assert_eq!(found, whole);
        assert!(whole.len() > 150);
    }
}
