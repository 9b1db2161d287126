//! The entries of the history in the order of time, each with the state after it.
//!
//! A state is large, and each begins as a copy of the one before. So the states stand in a ring, where that copy is made once and in
//! place, apart from what was told, which is sought through.

use std::collections::VecDeque;

use super::history::Told;
use super::state::PoseState;

/// Room for so many states is made first: ten seconds of a brick that is read 50 times a second, more than a history holds as a rule. A state
/// takes over a kilobyte, and a ring that grows later leaves a hole as large as it was in the memory of a station that runs for weeks.
const FIRST_ROOM: usize = 512;

/// What was told, with the states.
pub(super) struct Entries<const N: usize> {
    /// What was told, oldest first.
    told: VecDeque<Told>,
    /// The state after each, that after the oldest at `first`; behind the last place comes the first one.
    states: Vec<PoseState<N>>,
    first: usize,
    /// The state before the oldest.
    pub(super) base: PoseState<N>,
}

/// One entry while it is applied.
pub(super) struct Applied<'e, const N: usize> {
    pub(super) told: &'e Told,
    /// The state before it.
    pub(super) before: &'e PoseState<N>,
    /// That after it, which begins as a copy.
    pub(super) after: &'e mut PoseState<N>,
}

impl<const N: usize> Entries<N> {
    /// No entries, and the state before them.
    pub(super) const fn new(base: PoseState<N>) -> Self {
        Self { told: VecDeque::new(), states: Vec::new(), first: 0, base }
    }

    /// What was told, oldest first.
    pub(super) const fn told(&self) -> &VecDeque<Told> {
        &self.told
    }

    pub(super) fn len(&self) -> usize {
        self.told.len()
    }

    /// The state before an entry, or after the last.
    pub(super) fn before(&self, index: usize) -> &PoseState<N> {
        let state = index.checked_sub(1).map(|before| self.place(before));
        let state = state.and_then(|place| self.states.get(place));
        state.unwrap_or(&self.base)
    }

    /// The state after the last entry.
    pub(super) fn last(&self) -> &PoseState<N> {
        self.before(self.len())
    }

    /// The state after the last entry, to change it; that before all where there is none.
    pub(super) fn last_mut(&mut self) -> &mut PoseState<N> {
        let last = self.len().checked_sub(1).map(|last| self.place(last));
        let state = last.and_then(|place| self.states.get_mut(place));
        state.unwrap_or(&mut self.base)
    }

    /// Puts what was told at its place. From there on the states are those of others until each entry was applied.
    pub(super) fn insert(&mut self, index: usize, told: Told) {
        if self.told.len() == self.states.len() {
            self.make_room();
        }
        self.told.insert(index, told);
    }

    /// The same right before the last entry, whose state stays.
    pub(super) fn insert_before_last(&mut self, told: Told) {
        let last = self.len().saturating_sub(1);
        self.insert(last, told);
        let (from, to) = (self.place(last), self.place(last + 1));
        self.states.copy_within(from..=from, to);
    }

    /// An entry that is to be applied, with the state before it copied to where that after it stays.
    ///
    /// # Panics
    /// There is no such entry.
    pub(super) fn apply(&mut self, index: usize) -> Applied<'_, N> {
        let at = self.place(index);
        let (before, after) = match index.checked_sub(1).map(|before| self.place(before)) {
            None => (&self.base, &mut self.states[at]),
            Some(before) if before < at => {
                let (left, right) = self.states.split_at_mut(at);
                (&left[before], &mut right[0])
            }
            Some(before) => {
                let (left, right) = self.states.split_at_mut(before);
                (&right[0], &mut left[at])
            }
        };
        *after = *before;
        Applied { told: &self.told[index], before, after }
    }

    /// Forgets the oldest entries; the state after them is the one before all others.
    pub(super) fn forget(&mut self, count: usize) {
        if count > 0 {
            self.base = *self.before(count);
            self.told.drain(..count);
            self.first = self.place(count);
        }
    }

    /// Forgets all, and what was before.
    pub(super) fn restart(&mut self, base: PoseState<N>) {
        self.told.clear();
        self.first = 0;
        self.base = base;
    }

    /// Where a state stands, or where the one behind the last would.
    const fn place(&self, index: usize) -> usize {
        let place = self.first + index;
        if place < self.states.len() { place } else { place - self.states.len() }
    }

    fn make_room(&mut self) {
        self.states.rotate_left(self.first);
        self.first = 0;
        let room = match self.states.len() {
            0 => FIRST_ROOM,
            full => full / 4,
        };
        self.states.reserve_exact(room);
        self.states.resize(self.states.len() + room, self.base);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filters::pose::history::Action;
    use crate::filters::pose::state::CORE;
    use posebridge_telemetry::{SensorId, Stamp};

    fn told(millis: i64) -> Told {
        Told { stamp: Stamp::from_millis(millis), sensor: SensorId::GYRO, action: Action::TurnRate(0.0) }
    }

    /// A state that is known by a number.
    fn state(number: f64) -> PoseState<CORE> {
        let mut state = PoseState::initial(&crate::filters::pose::motion::tests::config());
        state.forward.value = number;
        state
    }

    /// The ring against a list that is moved about, while it wraps and grows: each state adds one to that before it.
    #[test]
    fn states_stand_where_their_entries_stand_however_often_the_ring_turns() {
        let mut entries = Entries::new(state(0.5));
        let mut expected = vec![0.5];
        for step in 0..1_500_i64 {
            let len = entries.len();
            if step % 7 == 3 && len > 0 {
                let turned = entries.last().forward.value;
                entries.insert_before_last(told(step));
                entries.apply(len - 1).after.forward.value += 0.25;
                assert_eq!(entries.last().forward.value.to_bits(), turned.to_bits());
                let before = expected[len - 1];
                expected.insert(len, before + 0.25);
            } else {
                entries.insert(len, told(step));
                let applied = entries.apply(len);
                assert_eq!(applied.before.forward.value.to_bits(), f64::to_bits(expected[len]));
                applied.after.forward.value += 1.0;
                expected.push(expected[len] + 1.0);
            }
            // At first it fills, then it turns and empties, and in the end it fills from its middle and grows.
            if step % 5 > 1 && (300..900).contains(&step) {
                let count = 2.min(entries.len());
                entries.forget(count);
                expected.drain(..count);
            }
            let found = (0..=entries.len()).map(|index| entries.before(index).forward.value);
            assert_eq!(found.collect::<Vec<_>>(), expected, "step {step}");
        }
        let (room, used) = (entries.states.len(), entries.len());
        assert!(used > FIRST_ROOM, "{used} states: the ring has grown");
        assert!(room < used + used / 3, "room for {room} of {used}");
    }
}
