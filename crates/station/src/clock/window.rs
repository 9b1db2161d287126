//! The bounds of one side within the window, and which of them a hull can want.
//!
//! A hull over the whole window costs hundreds of steps, and one is wanted after every exchange. Between two of them a single bound
//! was added at one end and perhaps one forgotten at the other. So the window is kept in two parts, as a queue is made of two stacks:
//!
//! ```text
//!   oldest ......................... | ............................ youngest
//!   corners from each bound to here  | corners from here to each     open
//!   (`after`, read from the oldest)  | (`chain`)                     half second
//! ```
//!
//! To forget the oldest bound is one step in the left part, to add one at the end a few in the right part. When the left part is empty,
//! the right one takes its place: once per window. The corners of both together hold all corners of the whole.
//!
//! Bounds are loosened with the square of their age ([`BoundHull::span`](super::hull::BoundHull::span)), for one allowance or
//! none. The square of (t - t_i) is that of t_i and something straight in t_i, and what is straight turns no corner into none: so
//! corners do not depend on t. Nor does a larger allowance lose any, because it makes the points bend towards the hull. One set
//! of corners serves both.

use std::collections::VecDeque;

use super::hull::{BoundSide, OffsetBound, is_below};

/// Bounds of one side, oldest first, one per bucket of time.
#[derive(Clone, Debug)]
pub(super) struct BoundWindow {
    side: BoundSide,
    /// The largest allowance with which a hull will be asked for, per second.
    drift_per_s: f64,
    /// The older part, and for each its next corner towards the middle.
    older: VecDeque<OlderBound>,
    /// The younger part: all of them, for the day when it becomes the older one.
    younger: Vec<OffsetBound>,
    /// The corners of the younger part.
    chain: Vec<OffsetBound>,
    /// The youngest of all, which a tighter one of its bucket replaces.
    open: Option<OffsetBound>,
}

/// A bound of the older part.
#[derive(Clone, Copy, Debug)]
struct OlderBound {
    bound: OffsetBound,
    /// Number of places to the next corner; 0 if there is none.
    after: usize,
}

impl BoundWindow {
    pub(super) fn new(side: BoundSide, drift_per_s: f64, most: usize) -> Self {
        Self {
            side,
            drift_per_s,
            older: VecDeque::with_capacity(most),
            younger: Vec::with_capacity(most),
            chain: Vec::with_capacity(most),
            open: None,
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.open.is_none()
    }

    pub(super) fn oldest(&self) -> Option<OffsetBound> {
        let older = self.older.front().map(|one| one.bound);
        older.or(self.younger.first().copied()).or(self.open)
    }

    /// The bound that a tighter one may still replace.
    pub(super) fn youngest(&self) -> Option<OffsetBound> {
        self.open
    }

    /// Takes a bound that is tighter than the youngest one and of the same bucket.
    pub(super) fn tighten(&mut self, bound: OffsetBound) {
        self.open = Some(bound);
    }

    /// Takes a bound of a bucket behind all others.
    pub(super) fn append(&mut self, bound: OffsetBound) {
        if let Some(settled) = self.open.replace(bound) {
            self.younger.push(settled);
            while let [.., before, last] = self.chain.as_slice()
                && !self.is_corner(*before, *last, settled)
            {
                self.chain.pop();
            }
            self.chain.push(settled);
        }
    }

    /// Forgets the oldest bounds as long as they are `outdated`.
    pub(super) fn drop_outdated(&mut self, outdated: impl Fn(&OffsetBound) -> bool) {
        while self.oldest().is_some_and(|oldest| outdated(&oldest)) {
            if self.older.is_empty() {
                self.age_younger();
            }
            if self.older.pop_front().is_none() {
                self.open = None;
            }
        }
    }

    /// All that can be corners of the hull, in the order of time, for any allowance up to the largest.
    pub(super) fn candidates(&self) -> impl Iterator<Item = OffsetBound> {
        let mut place = (!self.older.is_empty()).then_some(0);
        let older = std::iter::from_fn(move || {
            let at = place?;
            let one = self.older.get(at)?;
            place = (one.after > 0).then_some(at + one.after);
            Some(one.bound)
        });
        older.chain(self.chain.iter().copied()).chain(self.open)
    }

    /// The younger part becomes the older one.
    fn age_younger(&mut self) {
        self.chain.clear();
        // Places of the corners from the bound in hand to the middle, the nearest last.
        let mut corners: Vec<usize> = Vec::new();
        for (place, bound) in self.younger.iter().enumerate().rev() {
            while let [.., behind, next] = corners.as_slice()
                && !self.is_corner(*bound, self.younger[*next], self.younger[*behind])
            {
                corners.pop();
            }
            let after = corners.last().map_or(0, |next| next - place);
            let bound = *bound;
            self.older.push_front(OlderBound { bound, after });
            corners.push(place);
        }
        self.younger.clear();
    }

    /// Whether the middle one of three bounds in the order of time lies below the line from the first to the last, loosened as they are
    /// at the instant of the last.
    fn is_corner(&self, first: OffsetBound, middle: OffsetBound, last: OffsetBound) -> bool {
        let [first, middle, last] =
            [first, middle, last].map(|bound| bound.loosened(self.side, last.t_s, self.drift_per_s));
        is_below(&first, &middle, &last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::hull::BoundHull;
    use proptest::prelude::*;

    const DRIFT_PER_S: f64 = 2e-7;
    const LENGTH_S: f64 = 20.0;

    proptest! {
        #[test]
        fn the_hull_of_the_candidates_is_that_of_the_whole_window(
            steps in proptest::collection::vec((0.4..6.0_f64, 0.0..0.05_f64, 0.0..0.05_f64), 1..200),
        ) {
            for side in [BoundSide::Upper, BoundSide::Lower] {
                let mut window = BoundWindow::new(side, DRIFT_PER_S, 8);
                let mut all: VecDeque<OffsetBound> = VecDeque::new();
                let mut t_s = 0.0;
                for (step_s, offset_s, tighter_s) in &steps {
                    t_s += step_s;
                    let bound = OffsetBound { t_s, offset_s: *offset_s };
                    window.append(bound);
                    all.push_back(bound);
                    if *tighter_s < 0.01 {
                        let bound = OffsetBound { t_s: t_s + 0.1, offset_s: *tighter_s };
                        window.tighten(bound);
                        all.pop_back();
                        all.push_back(bound);
                    }
                    let is_outdated = |bound: &OffsetBound| t_s - bound.t_s > LENGTH_S;
                    window.drop_outdated(is_outdated);
                    all.retain(|bound| !is_outdated(bound));
                    prop_assert_eq!(window.oldest(), all.front().copied());
                    prop_assert_eq!(window.youngest(), all.back().copied());
                    for drift_per_s in [0.0, DRIFT_PER_S] {
                        let (mut quick, mut whole) = (BoundHull::new(side), BoundHull::new(side));
                        quick.rebuild(window.candidates(), t_s, drift_per_s);
                        whole.rebuild(all.iter().copied(), t_s, drift_per_s);
                        for slope in [-0.01, -0.003, 0.0, 0.001, 0.0025, 0.01] {
                            prop_assert!((quick.at(slope, t_s).0 - whole.at(slope, t_s).0).abs() < 1e-15);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn what_is_outdated_to_the_last_leaves_an_empty_window() {
        let mut window = BoundWindow::new(BoundSide::Upper, DRIFT_PER_S, 8);
        for t_s in [1.0, 2.0, 3.0] {
            window.append(OffsetBound { t_s, offset_s: 0.0 });
        }
        window.drop_outdated(|_| true);
        assert!(window.is_empty());
        assert_eq!(window.candidates().count(), 0);
    }
}
