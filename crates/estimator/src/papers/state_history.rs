//! A filter's state at recent instants: for filters that use observations as they come and so need no replay, but must
//! answer for the past.

use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

/// In the order of their instants, oldest first.
#[derive(Clone, Debug)]
pub(super) struct StateHistory<T> {
    entries: VecDeque<(Timestamp<BrickClock>, T)>,
    length: TimeDelta,
}

impl<T: Copy> StateHistory<T> {
    pub(super) fn new(length_s: f64) -> Self {
        Self { entries: VecDeque::new(), length: TimeDelta::from_secs_f64(length_s) }
    }

    /// Adds the state for an instant that is not before the last one; replaces the one of the same instant.
    pub(super) fn push(&mut self, stamp: Timestamp<BrickClock>, state: T) {
        if self.entries.back().is_some_and(|(last, _)| *last == stamp) {
            self.entries.pop_back();
        }
        self.entries.push_back((stamp, state));
        let horizon = stamp - self.length;
        // One state at or before the horizon stays, to start from.
        while self.entries.get(1).is_some_and(|(second, _)| *second <= horizon) {
            self.entries.pop_front();
        }
    }

    pub(super) fn last_at_or_before(&self, stamp: Timestamp<BrickClock>) -> Option<(Timestamp<BrickClock>, T)> {
        let index = self.entries.partition_point(|(at, _)| *at <= stamp);
        self.entries.get(index.checked_sub(1)?).copied()
    }

    pub(super) fn clear(&mut self) {
        self.entries.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_reaches_back_by_its_configured_length_and_no_further() {
        let mut timeline = StateHistory::new(0.25);
        for k in 0..10_i64 {
            timeline.push(Timestamp::from_millis(100 * k), k);
        }
        timeline.push(Timestamp::from_millis(900), 90);
        let at = |millis| timeline.last_at_or_before(Timestamp::from_millis(millis));
        assert_eq!(at(5_000).map(|(_, state)| state), Some(90));
        assert_eq!(at(899).map(|(_, state)| state), Some(8));
        assert_eq!(at(650).map(|(_, state)| state), Some(6), "kept to start from");
        assert_eq!(at(599), None);
    }
}
