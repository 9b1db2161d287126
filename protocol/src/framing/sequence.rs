//! How many frames are missing, by the senders' sequence numbers.
//!
//! Every (system, component) counts for itself. A number that stands still or falls back by up to half the circle is a
//! duplicate or a reordering, not a loss, and a gap of more than 127 cannot be told from one. Some senders do not count by
//! one at all; for those the figure means nothing, and the cap keeps it from drowning the others.

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, SourceHealth};

/// The largest gap that counts as a loss: half the circle of an 8-bit counter.
const LARGEST_GAP: u8 = 127;

/// Remembers the last sequence number of every sender on one link, and counts.
#[derive(Clone, Debug, Default)]
pub struct SequenceTracker {
    senders: BTreeMap<Address, Sender>,
}

#[derive(Clone, Copy, Debug)]
struct Sender {
    /// `None` after a break: the next frame follows nothing.
    last: Option<u8>,
    frames: u64,
    lost: u64,
}

impl SequenceTracker {
    /// A tracker that has heard nobody.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes note of a frame and returns how many frames of its sender are missing before it: 0 to 127.
    pub fn missing_before(&mut self, source: Address, sequence: u8) -> u8 {
        let sender = self.senders.entry(source).or_insert(Sender {
            last: None,
            frames: 0,
            lost: 0,
        });
        sender.frames += 1;
        let Some(previous) = sender.last.replace(sequence) else {
            return 0;
        };
        let missing = sequence.wrapping_sub(previous).wrapping_sub(1);
        let missing = if missing <= LARGEST_GAP { missing } else { 0 };
        sender.lost += u64::from(missing);
        missing
    }

    /// The link was away: nobody knows what was sent meanwhile, and the next frame of each sender follows nothing.
    pub fn break_off(&mut self) {
        for sender in self.senders.values_mut() {
            sender.last = None;
        }
    }

    /// What each sender has sent, in the order of their addresses.
    pub fn sources(&self) -> impl Iterator<Item = SourceHealth> {
        self.senders.iter().map(|(source, sender)| SourceHealth {
            source: *source,
            frames: sender.frames,
            lost: sender.lost,
        })
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
    fn what_was_sent_while_the_link_was_away_is_no_loss() {
        let mut tracker = SequenceTracker::new();
        tracker.missing_before(ROBOT, 10);
        tracker.missing_before(ROBOT, 12);
        tracker.break_off();
        assert_eq!(tracker.missing_before(ROBOT, 90), 0);
        let sources: Vec<_> = tracker.sources().collect();
        assert_eq!(
            sources,
            [SourceHealth {
                source: ROBOT,
                frames: 3,
                lost: 1
            }]
        );
    }

    #[test]
    fn every_component_counts_for_itself() {
        let mut tracker = SequenceTracker::new();
        tracker.missing_before(ROBOT, 5);
        assert_eq!(tracker.missing_before(Address::new(1, 197), 90), 0);
        assert_eq!(tracker.missing_before(ROBOT, 7), 1);
    }
}
