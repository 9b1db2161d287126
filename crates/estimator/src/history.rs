//! Late data for any filter: the entries of the last seconds, with states from which they can be applied again. So the
//! order of arrival does not matter, bit for bit, as long as nothing is older than the history.
//!
//! State p is the state after the first p entries; state 0 is the base. Kept are the last `RECENT_STATES` states, and
//! of the older ones each with p = 0 mod `CHECKPOINT_INTERVAL`: all of them would take a hundred kilobytes for each
//! robot, and a station with hundreds of robots would fetch each from memory instead of from a cache.

use std::cmp::Ordering;
use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, Timestamp};
use serde::{Deserialize, Serialize};

use crate::motion::count_before;
use crate::saved::{MAX_ENTRIES, RestoreError};

/// The number of last states that are stored: 0.16 s of a brick whose wheels and gyro are read 50 times a second.
const RECENT_STATES: usize = 16;
/// The distance between the older states that are kept, in entries.
const CHECKPOINT_INTERVAL: usize = 8;
/// Three seconds of a brick that is read 80 times a second; growing later would fragment the memory of a station.
const INITIAL_CHECKPOINTS: usize = 32;

/// An input of a filter at one instant.
pub trait HistoryEntry {
    fn stamp(&self) -> Timestamp<BrickClock>;

    /// The order in which two entries are applied: by time first. Equal entries are applied in the order of arrival.
    fn order(&self, other: &Self) -> Ordering;
}

/// The entries of the last seconds in time order, with states between them.
#[derive(Clone, Debug)]
pub struct FixedLagHistory<E, S> {
    /// Oldest first.
    entries: VecDeque<E>,
    /// The state before the oldest entry.
    base: S,
    /// Every state p with p = 0 mod [`CHECKPOINT_INTERVAL`], from the first after the base on.
    checkpoints: VecDeque<S>,
    /// A ring of the last states; empty before the first entry. State p is at index (`ring_offset` + p) mod [`RECENT_STATES`].
    recent: Vec<S>,
    ring_offset: usize,
}

/// A history as it is kept elsewhere: what it begins with, and what was applied to that.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedHistory<E, S> {
    pub base: S,
    pub entries: VecDeque<E>,
    /// The states between, where the entries do not lead to them any more: they were applied with other parameters.
    states: Option<StoredStates<S>>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct StoredStates<S> {
    checkpoints: VecDeque<S>,
    /// The last [`RECENT_STATES`], oldest first.
    recent: Vec<S>,
}

impl<E, S> SavedHistory<E, S> {
    /// All states that were stored.
    pub fn states(&self) -> impl Iterator<Item = &S> {
        let stored = self.states.iter().flat_map(|states| states.checkpoints.iter().chain(&states.recent));
        std::iter::once(&self.base).chain(stored)
    }
}

impl<E: HistoryEntry + Clone, S: Copy + PartialEq> FixedLagHistory<E, S> {
    /// This history to be continued elsewhere; `apply` as for [`Self::insert`].
    ///
    /// All states would be ten times as long as what they follow from, so they are left out where that leads to them.
    pub fn save(&self, apply: impl FnMut(&S, &mut S, &E)) -> SavedHistory<E, S> {
        let saved = SavedHistory { base: self.base, entries: self.entries.clone(), states: None };
        let stored = self.stored_states();
        let is_implied = Self::replayed(&saved, apply).stored_states() == stored;
        SavedHistory { states: (!is_implied).then_some(stored), ..saved }
    }

    /// The history that was saved. Fails if it is none.
    pub fn restored(saved: SavedHistory<E, S>, apply: impl FnMut(&S, &mut S, &E)) -> Result<Self, RestoreError> {
        let is_in_order =
            saved.entries.iter().zip(saved.entries.iter().skip(1)).all(|(one, next)| one.order(next).is_le());
        (is_in_order && saved.entries.len() <= MAX_ENTRIES)
            .then_some(())
            .ok_or(RestoreError::Implausible("its observations are too many, or out of order"))?;
        let mut history = Self::replayed(&saved, apply);
        if let Some(states) = saved.states {
            let before = history.stored_states();
            let is_complete =
                (states.checkpoints.len(), states.recent.len()) == (before.checkpoints.len(), before.recent.len());
            is_complete.then_some(()).ok_or(RestoreError::Implausible("it lacks states between its observations"))?;
            history.checkpoints = states.checkpoints;
            let first = history.entries.len() - states.recent.len() + 1;
            for (number, state) in (first..).zip(states.recent) {
                let slot = history.slot(number);
                history.recent[slot] = state;
            }
        }
        Ok(history)
    }

    fn replayed(saved: &SavedHistory<E, S>, mut apply: impl FnMut(&S, &mut S, &E)) -> Self {
        let mut history = Self::new(saved.base);
        for entry in &saved.entries {
            history.insert(entry.clone(), None, |before, after, entry, _| apply(before, after, entry));
        }
        history
    }

    fn stored_states(&self) -> StoredStates<S> {
        let length = self.entries.len();
        let first = (length + 1).saturating_sub(RECENT_STATES).max(1);
        let recent = (first..=length).map(|number| self.recent[self.slot(number)]);
        StoredStates { checkpoints: self.checkpoints.clone(), recent: recent.collect() }
    }
}

impl<E: HistoryEntry, S: Copy> FixedLagHistory<E, S> {
    pub const fn new(base: S) -> Self {
        Self { entries: VecDeque::new(), base, checkpoints: VecDeque::new(), recent: Vec::new(), ring_offset: 0 }
    }

    pub const fn entries(&self) -> &VecDeque<E> {
        &self.entries
    }

    pub const fn base(&self) -> &S {
        &self.base
    }

    /// To change the state before the oldest entry while there is none.
    pub const fn base_mut(&mut self) -> &mut S {
        &mut self.base
    }

    pub fn last_state(&self) -> &S {
        self.stored_state(self.entries.len()).1
    }

    /// The state at an instant, as the nearest stored state before it and the entries to apply to it.
    pub fn state_at_or_before(&self, stamp: Timestamp<BrickClock>) -> (&S, impl Iterator<Item = &E>) {
        let count = self.count_until(stamp);
        let (stored, state) = self.stored_state(count);
        (state, self.entries.range(stored..count))
    }

    /// Inserts an entry at its own time, and applies it and all later ones again, oldest first; those after
    /// `changed_after` too, where that is earlier, and those between there and the nearest stored state. `apply` gets
    /// the state before an entry, a copy of that to be updated, the entry, and whether it is the inserted one.
    pub fn insert(
        &mut self,
        entry: E,
        changed_after: Option<Timestamp<BrickClock>>,
        mut apply: impl FnMut(&S, &mut S, &E, bool),
    ) {
        let inserted = count_before(&self.entries, |other| other.order(&entry) != Ordering::Greater);
        let changed = changed_after.map_or(inserted, |after| self.count_until(after)).min(inserted);
        if self.recent.is_empty() {
            self.checkpoints.reserve(INITIAL_CHECKPOINTS);
            self.recent = vec![self.base; RECENT_STATES];
        }
        let (next, state) = self.stored_state(changed);
        if !self.is_recent(next) {
            let (slot, state) = (self.slot(next), *state);
            self.recent[slot] = state;
        }
        if inserted == self.entries.len() {
            self.entries.push_back(entry);
        } else {
            self.entries.insert(inserted, entry);
        }
        for index in next..self.entries.len() {
            self.store_checkpoint(index);
            let slots = [self.slot(index), self.slot(index + 1)];
            if let (Some(entry), Ok([before, after])) = (self.entries.get(index), self.recent.get_disjoint_mut(slots)) {
                *after = *before;
                apply(before, after, entry, index == inserted);
            }
        }
    }

    /// Whether [`Self::discard_before`] the same instant may discard anything; in constant time.
    pub fn has_outdated(&self, stamp: Timestamp<BrickClock>) -> bool {
        self.entries.get(CHECKPOINT_INTERVAL - 1).is_some_and(|entry| entry.stamp() < stamp)
    }

    /// Discards entries before an instant, up to the last checkpoint there, whose state becomes the base.
    pub fn discard_before(&mut self, stamp: Timestamp<BrickClock>) {
        let outdated = self.entries.iter().take_while(|entry| entry.stamp() < stamp).count();
        let checkpoints = (outdated / CHECKPOINT_INTERVAL).min(self.checkpoints.len());
        let last = self.checkpoints.drain(..checkpoints).next_back();
        if let Some(state) = last {
            self.base = state;
            let count = checkpoints * CHECKPOINT_INTERVAL;
            self.entries.drain(..count);
            self.ring_offset = self.slot(count);
        }
    }

    /// Discards all entries.
    pub fn reset(&mut self, base: S) {
        self.entries.clear();
        self.checkpoints.clear();
        self.base = base;
    }

    /// Number of entries at or before an instant.
    fn count_until(&self, stamp: Timestamp<BrickClock>) -> usize {
        count_before(&self.entries, |entry| entry.stamp() <= stamp)
    }

    /// The nearest stored state at or before state `number`, with its own number.
    fn stored_state(&self, number: usize) -> (usize, &S) {
        if self.is_recent(number) {
            return (number, &self.recent[self.slot(number)]);
        }
        let checkpoint = (number / CHECKPOINT_INTERVAL).checked_sub(1);
        match checkpoint.and_then(|index| Some((index, self.checkpoints.get(index)?))) {
            Some((index, state)) => ((index + 1) * CHECKPOINT_INTERVAL, state),
            None => (0, &self.base),
        }
    }

    /// Whether a state is in the ring. The base is kept separately.
    fn is_recent(&self, state: usize) -> bool {
        state > 0 && state + RECENT_STATES > self.entries.len()
    }

    /// The index of a state in the ring, if it is there.
    const fn slot(&self, state: usize) -> usize {
        (self.ring_offset + state) % RECENT_STATES
    }

    /// Copies a state from the ring to the checkpoints, if it is one.
    fn store_checkpoint(&mut self, number: usize) {
        if number == 0 || !number.is_multiple_of(CHECKPOINT_INTERVAL) {
            return;
        }
        let index = number / CHECKPOINT_INTERVAL - 1;
        let state = self.recent[self.slot(number)];
        match self.checkpoints.get_mut(index) {
            Some(checkpoint) => *checkpoint = state,
            None => self.checkpoints.push_back(state),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Appends a number to a list; entries of one instant in the order of their numbers.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Append {
        millis: i64,
        number: u64,
    }

    impl HistoryEntry for Append {
        fn stamp(&self) -> Timestamp<BrickClock> {
            Timestamp::from_millis(self.millis)
        }

        fn order(&self, other: &Self) -> Ordering {
            (self.millis, self.number).cmp(&(other.millis, other.number))
        }
    }

    /// What a list of numbers comes to: order and contents decide it.
    type Digest = u64;

    const fn applied(state: Digest, entry: &Append) -> Digest {
        state.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(entry.number).rotate_left(17)
    }

    fn insert(
        history: &mut FixedLagHistory<Append, Digest>,
        entry: Append,
        changed_after: Option<Timestamp<BrickClock>>,
    ) -> Vec<Append> {
        let mut entries = Vec::new();
        history.insert(entry, changed_after, |before, after, entry, _| {
            assert_eq!(before, after, "it begins as a copy");
            *after = applied(*before, entry);
            entries.push(*entry);
        });
        entries
    }

    fn ms(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    fn history_of(entries: &[Append]) -> FixedLagHistory<Append, Digest> {
        let mut history = FixedLagHistory::new(1);
        for entry in entries {
            insert(&mut history, *entry, None);
        }
        history
    }

    const ENTRIES: [Append; 4] = [
        Append { millis: 10, number: 1 },
        Append { millis: 20, number: 2 },
        Append { millis: 20, number: 3 },
        Append { millis: 30, number: 4 },
    ];

    /// The state at an instant, and how many entries had to be applied for it.
    fn state_at(history: &FixedLagHistory<Append, Digest>, millis: i64) -> (Digest, usize) {
        let (stored, unapplied) = history.state_at_or_before(ms(millis));
        unapplied.fold((*stored, 0), |(state, count), entry| (applied(state, entry), count + 1))
    }

    #[test]
    fn a_change_of_the_past_replays_from_behind_its_instant() {
        let late = Append { millis: 40, number: 5 };
        for (changed_after, from) in [(5, 0), (10, 1), (20, 3), (30, 4), (35, 4), (50, 4)] {
            let mut history = history_of(&ENTRIES);
            let replayed = insert(&mut history, late, Some(ms(changed_after)));
            let all = [ENTRIES[0], ENTRIES[1], ENTRIES[2], ENTRIES[3], late];
            assert_eq!(replayed, all[from..], "changed after {changed_after} ms");
        }
    }

    #[test]
    fn before_the_first_entry_holds_the_base_also_after_a_reset() {
        let mut history = history_of(&ENTRIES);
        assert_eq!(state_at(&history, 9), (1, 0));
        history.discard_before(ms(20));
        assert_eq!(history.entries().len(), ENTRIES.len(), "there is no checkpoint yet");
        history.reset(7);
        assert!(history.entries().is_empty());
        assert_eq!((*history.base(), *history.last_state()), (7, 7));
        insert(&mut history, ENTRIES[0], None);
        assert_eq!(*history.last_state(), applied(7, &ENTRIES[0]));
    }

    /// The history against one that keeps everything, while entries come up to 70 places late and the oldest are discarded.
    #[test]
    fn every_state_is_that_of_the_ordered_entries_and_near_a_stored_one() {
        const LONGEST: i64 = 90;
        let mut history = FixedLagHistory::new(1);
        let mut expected: Vec<Append> = Vec::new();
        let mut base = 1;
        for step in 0..1_500_i64 {
            // Places that are late come between two entries of before.
            let late = if step % 3 == 0 { step * 7 % 70 } else { 0 };
            let entry = Append { millis: (10 * step - 10 * late - late.signum() * 5).max(0), number: step as u64 };
            let position = expected.partition_point(|other| other.order(&entry) != Ordering::Greater);
            expected.insert(position, entry);
            let replayed = insert(&mut history, entry, None);
            let recomputed = replayed.len() - (expected.len() - position);
            assert!(recomputed < CHECKPOINT_INTERVAL, "step {step}: {recomputed} more than the late ones");
            history.discard_before(ms(10 * (step - LONGEST)));
            let discarded = expected.len() - history.entries().len();
            assert_eq!(discarded % CHECKPOINT_INTERVAL, 0);
            base = expected.drain(..discarded).fold(base, |state, entry| applied(state, &entry));
            assert_eq!(*history.base(), base, "step {step}");
            assert!(history.entries().iter().copied().eq(expected.iter().copied()), "step {step}");
            let mut state = base;
            for (index, entry) in expected.iter().enumerate() {
                state = applied(state, entry);
                let (found, recomputed) = state_at(&history, entry.millis);
                let is_last_of_instant = expected.get(index + 1).is_none_or(|next| next.millis > entry.millis);
                if is_last_of_instant {
                    assert_eq!(found, state, "step {step}, entry {index}");
                }
                assert!(recomputed < CHECKPOINT_INTERVAL, "step {step}, entry {index}: {recomputed}");
            }
            assert_eq!(*history.last_state(), state, "step {step}");
        }
        let most = expected.len() / CHECKPOINT_INTERVAL;
        assert!(expected.len() < LONGEST as usize + 2 * CHECKPOINT_INTERVAL && history.checkpoints.len() <= most);
    }
}
