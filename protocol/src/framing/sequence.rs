//! How many frames are missing, by the senders' sequence numbers.
//!
//! Every (system, component) counts for itself. A number that stands still or falls back by up to half the circle is a
//! duplicate or a reordering, not a loss, and a gap of more than 127 cannot be told from one. Some senders do not count by
//! one at all; for those the figure means nothing, and the cap keeps it from drowning the others.

use std::collections::BTreeMap;

use posebridge_telemetry::Address;

/// The largest gap that counts as a loss: half the circle of an 8-bit counter.
const LARGEST_GAP: u8 = 127;

/// Remembers the last sequence number of every sender on one link.
#[derive(Clone, Debug, Default)]
pub struct SequenceTracker {
    last: BTreeMap<Address, u8>,
}

impl SequenceTracker {
    /// A tracker that has heard nobody.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes note of a frame and returns how many frames of its sender are missing before it: 0 to 127.
    pub fn missing_before(&mut self, source: Address, sequence: u8) -> u8 {
        let Some(previous) = self.last.insert(source, sequence) else {
            return 0;
        };
        let missing = sequence.wrapping_sub(previous).wrapping_sub(1);
        if missing <= LARGEST_GAP { missing } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: Address = Address::new(1, 1);

    #[test]
    fn a_gap_is_counted_across_the_wrap() {
        let mut tracker = SequenceTracker::new();
        assert_eq!(tracker.missing_before(ROBOT, 254), 0, "first frame");
        assert_eq!(tracker.missing_before(ROBOT, 255), 0, "next frame");
        assert_eq!(tracker.missing_before(ROBOT, 2), 2, "0 and 1 are missing");
    }

    #[test]
    fn duplicates_reorderings_and_absurd_gaps_are_no_losses() {
        let mut tracker = SequenceTracker::new();
        tracker.missing_before(ROBOT, 10);
        assert_eq!(tracker.missing_before(ROBOT, 10), 0, "duplicate");
        assert_eq!(tracker.missing_before(ROBOT, 8), 0, "older frame");
        assert_eq!(tracker.missing_before(ROBOT, 136), 127, "largest gap");
        assert_eq!(tracker.missing_before(ROBOT, 9), 0, "gap of 128");
    }

    #[test]
    fn every_component_counts_for_itself() {
        let mut tracker = SequenceTracker::new();
        tracker.missing_before(ROBOT, 5);
        assert_eq!(tracker.missing_before(Address::new(1, 197), 90), 0);
        assert_eq!(tracker.missing_before(ROBOT, 7), 1);
    }
}
