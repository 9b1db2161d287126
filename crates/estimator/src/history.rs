//! Late data for any filter: what was used during the last seconds, with the state after each, so that it can be used again.
//!
//! An entry that comes late is put where its time says. The states from there on are out of date; [`FixedLagHistory::insert`] gives back
//! each of these entries with the state before it, oldest first, for the filter to apply again. So the order of arrival does not matter,
//! bit for bit, as long as nothing is older than the history.
//!
//! A state is large, and each begins as a copy of the one before. So the states stand in a ring, where that copy is made once and in
//! place, apart from the entries, which are searched.

use std::cmp::Ordering;
use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, Timestamp};

use crate::motion::count_before;

/// The first capacity: ten seconds of a brick that is read 50 times a second, more than a history holds as a rule. A state takes over a
/// kilobyte, and memory that is moved later leaves a hole as large as it was in a station that runs for weeks.
const INITIAL_CAPACITY: usize = 512;
/// The first length of the ring: one or two seconds. It is as long as the history needs and no longer, because what it goes round has to
/// fit into a cache beside the rings of hundreds of other robots.
const INITIAL_STATES: usize = 64;

/// What a filter uses at one instant.
pub trait HistoryEntry {
    /// The instant.
    fn stamp(&self) -> Timestamp<BrickClock>;

    /// The order in which two entries are applied: by time first. Entries that are equal are applied in the order in which they came.
    fn order(&self, other: &Self) -> Ordering;
}

/// The entries of the last seconds in the order of time, with the state after each.
#[derive(Clone, Debug)]
pub struct FixedLagHistory<E, S> {
    /// Oldest first.
    entries: VecDeque<E>,
    /// The state after each entry, that after the oldest at `first`; behind the last slot comes the first one.
    states: Vec<S>,
    first: usize,
    /// The state before the oldest entry.
    base: S,
}

impl<E: HistoryEntry, S: Copy> FixedLagHistory<E, S> {
    /// No entries, and the state before them.
    pub const fn new(base: S) -> Self {
        Self { entries: VecDeque::new(), states: Vec::new(), first: 0, base }
    }

    /// The entries, oldest first.
    pub const fn entries(&self) -> &VecDeque<E> {
        &self.entries
    }

    /// The state before the oldest entry.
    pub const fn base(&self) -> &S {
        &self.base
    }

    /// The state before the oldest entry, to change it while there is none.
    pub const fn base_mut(&mut self) -> &mut S {
        &mut self.base
    }

    /// The state after the last entry.
    pub fn last_state(&self) -> &S {
        self.state_before_index(self.entries.len())
    }

    /// The state after the last entry at or before an instant; that before all entries if there is none.
    pub fn state_at_or_before(&self, stamp: Timestamp<BrickClock>) -> &S {
        self.state_before_index(self.count_until(stamp))
    }

    /// Inserts an entry at its own time and returns what has to be applied again, oldest first: the entry and all after it, and what
    /// comes after `changed_after` where that is earlier. Until they are applied their states are not those after them.
    pub fn insert(&mut self, entry: E, changed_after: Option<Timestamp<BrickClock>>) -> Replay<'_, E, S> {
        let inserted = count_before(&self.entries, |other| other.order(&entry) != Ordering::Greater);
        let next = changed_after.map_or(inserted, |after| self.count_until(after)).min(inserted);
        if self.entries.len() == self.states.len() {
            self.grow();
        }
        self.entries.insert(inserted, entry);
        Replay { history: self, inserted, next }
    }

    /// Forgets the entries before an instant; the state after them is the one before all others.
    pub fn discard_before(&mut self, stamp: Timestamp<BrickClock>) {
        let count = self.entries.iter().take_while(|entry| entry.stamp() < stamp).count();
        if count > 0 {
            self.base = *self.state_before_index(count);
            self.entries.drain(..count);
            self.first = self.slot_of(count);
        }
    }

    /// Forgets all entries, and begins from another state.
    pub fn reset(&mut self, base: S) {
        self.entries.clear();
        self.first = 0;
        self.base = base;
    }

    /// The number of entries at or before an instant.
    fn count_until(&self, stamp: Timestamp<BrickClock>) -> usize {
        count_before(&self.entries, |entry| entry.stamp() <= stamp)
    }

    /// The state before an entry, or after the last.
    fn state_before_index(&self, index: usize) -> &S {
        let slot = index.checked_sub(1).map(|before| self.slot_of(before));
        slot.and_then(|slot| self.states.get(slot)).unwrap_or(&self.base)
    }

    /// Where a state stands, or where the one behind the last would.
    const fn slot_of(&self, index: usize) -> usize {
        let slot = self.first + index;
        if slot < self.states.len() { slot } else { slot - self.states.len() }
    }

    #[cold]
    fn grow(&mut self) {
        self.states.rotate_left(self.first);
        self.first = 0;
        let before = self.states.len();
        let wanted = if before == 0 { INITIAL_STATES } else { before + before / 4 };
        self.states.reserve_exact(wanted.max(INITIAL_CAPACITY) - before);
        self.states.resize(wanted, self.base);
    }
}

/// What has to be applied again after an insertion.
#[derive(Debug)]
#[must_use = "until all entries are applied again the states behind the insertion are not theirs"]
pub struct Replay<'h, E, S> {
    history: &'h mut FixedLagHistory<E, S>,
    inserted: usize,
    next: usize,
}

/// One entry that has to be applied.
#[derive(Debug)]
pub struct ReplayStep<'h, E, S> {
    /// The entry.
    pub entry: &'h E,
    /// The state before it.
    pub before: &'h S,
    /// The state after it, which begins as a copy of that before.
    pub after: &'h mut S,
    /// Whether it is the one that was inserted, or another that was applied before.
    pub is_inserted: bool,
}

impl<E: HistoryEntry, S: Copy> Replay<'_, E, S> {
    /// The next entry to apply.
    #[inline]
    #[expect(clippy::should_implement_trait, reason = "what it returns borrows from the replay")]
    pub fn next(&mut self) -> Option<ReplayStep<'_, E, S>> {
        let index = self.next;
        let history = &mut *self.history;
        let entry = history.entries.get(index)?;
        self.next += 1;
        let slot = history.slot_of(index);
        let (before, after) = match index.checked_sub(1).map(|before| history.slot_of(before)) {
            None => (&history.base, &mut history.states[slot]),
            Some(before) if before < slot => {
                let (left, right) = history.states.split_at_mut(slot);
                (&left[before], &mut right[0])
            }
            Some(before) => {
                let (left, right) = history.states.split_at_mut(before);
                (&right[0], &mut left[slot])
            }
        };
        *after = *before;
        Some(ReplayStep { entry, before, after, is_inserted: index == self.inserted })
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

    fn apply_all(mut replay: Replay<'_, Append, Digest>) -> Vec<Append> {
        let mut entries = Vec::new();
        while let Some(step) = replay.next() {
            assert_eq!(step.before, step.after, "it begins as a copy");
            *step.after = applied(*step.before, step.entry);
            entries.push(*step.entry);
        }
        entries
    }

    fn ms(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    fn history_of(entries: &[Append]) -> FixedLagHistory<Append, Digest> {
        let mut history = FixedLagHistory::new(1);
        for entry in entries {
            apply_all(history.insert(*entry, None));
        }
        history
    }

    const ENTRIES: [Append; 4] = [
        Append { millis: 10, number: 1 },
        Append { millis: 20, number: 2 },
        Append { millis: 20, number: 3 },
        Append { millis: 30, number: 4 },
    ];

    #[test]
    fn late_entries_lead_to_the_state_of_entries_in_order() {
        let in_order = history_of(&ENTRIES);
        for order in [[3, 2, 1, 0], [1, 0, 3, 2], [2, 3, 0, 1], [0, 3, 1, 2]] {
            let late = history_of(&order.map(|index| ENTRIES[index]));
            assert_eq!(late.last_state(), in_order.last_state(), "{order:?}");
            for millis in [9, 10, 15, 20, 29, 30, 99] {
                let states = [&late, &in_order].map(|history| history.state_at_or_before(ms(millis)));
                assert_eq!(states[0], states[1], "{order:?} at {millis} ms");
            }
        }
    }

    #[test]
    fn an_insertion_replays_the_entry_and_what_comes_after_it() {
        let mut history = history_of(&[ENTRIES[0], ENTRIES[2], ENTRIES[3]]);
        let mut replay = history.insert(ENTRIES[1], None);
        assert!(replay.next().is_some_and(|step| step.is_inserted && *step.entry == ENTRIES[1]));
        assert!(replay.next().is_some_and(|step| !step.is_inserted && *step.entry == ENTRIES[2]));
        assert!(replay.next().is_some_and(|step| !step.is_inserted && *step.entry == ENTRIES[3]));
        assert!(replay.next().is_none());
    }

    #[test]
    fn a_change_of_the_past_replays_from_behind_its_instant() {
        let late = Append { millis: 40, number: 5 };
        for (changed_after, from) in [(5, 0), (10, 1), (20, 3), (30, 4), (35, 4), (50, 4)] {
            let mut history = history_of(&ENTRIES);
            let replayed = apply_all(history.insert(late, Some(ms(changed_after))));
            let all = [ENTRIES[0], ENTRIES[1], ENTRIES[2], ENTRIES[3], late];
            assert_eq!(replayed, all[from..], "changed after {changed_after} ms");
        }
    }

    #[test]
    fn before_the_first_entry_holds_the_base_also_when_the_oldest_are_discarded() {
        let mut history = history_of(&ENTRIES);
        let after_two = *history.state_at_or_before(ms(10));
        assert_eq!(*history.state_at_or_before(ms(9)), 1);
        history.discard_before(ms(20));
        assert_eq!(history.entries().iter().copied().collect::<Vec<_>>(), ENTRIES[1..]);
        assert_eq!(*history.base(), after_two);
        assert_eq!(*history.state_at_or_before(ms(9)), after_two);
        history.reset(7);
        assert!(history.entries().is_empty());
        assert_eq!(*history.last_state(), 7);
    }

    /// The ring against a list, while it wraps and grows: each state adds one to that before it.
    #[test]
    fn states_stand_where_their_entries_stand_however_often_the_ring_turns() {
        let mut history = FixedLagHistory::new(0);
        let mut expected = vec![0];
        for step in 0..1_500_i64 {
            let mut replay = history.insert(Append { millis: step, number: 0 }, None);
            while let Some(step) = replay.next() {
                *step.after = *step.before + 1;
            }
            expected.push(expected[expected.len() - 1] + 1);
            // At first it fills, then it turns and empties, and in the end it fills from its middle and grows.
            if step % 5 > 1 && (300..900).contains(&step) {
                let count = 2.min(expected.len() - 1);
                expected.drain(..count);
                let oldest_kept = history.entries().get(count).map_or(step + 1, |entry| entry.millis);
                history.discard_before(ms(oldest_kept));
            }
            let found = (0..=history.entries().len()).map(|index| *history.state_before_index(index));
            assert_eq!(found.collect::<Vec<_>>(), expected, "step {step}");
        }
        let (capacity, used) = (history.states.len(), history.entries().len());
        assert!(used > INITIAL_CAPACITY, "{used} states: the ring has grown");
        assert!(capacity < used + used / 3, "room for {capacity} of {used}");
    }
}
