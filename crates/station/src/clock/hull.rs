//! The convex hull of one side's bounds: the bounds that can be tight for some slope.
//!
//! For a slope s the bounds of the upper side at an instant t are U(s) = min_i(u_i + s (t - t_i)), those of the lower
//! side L(s) = max_j(l_j + s (t - t_j)). Only the corners of the convex hull of the points (t_i, u_i), seen from below,
//! can be the minimum for some s, so a search over the slope visits some ten points instead of hundreds.
//!
//! ```text
//!   u  .    .  .      points: delays of messages        corners: the quickest ones
//!      o__  .    .
//!         ‾‾o___.___o
//! ```
//!
//! To rebuild the hull over the whole window costs hundreds of steps, and it is needed after every exchange. Between
//! two of them a single bound is added at one end and perhaps one removed at the other. So the window is kept in two
//! parts, as a queue is made of two stacks:
//!
//! ```text
//!   oldest ......................... | ............................ youngest
//!   corners from each bound to here  | corners from here to each     open
//!   (`after`, read from the oldest)  | (`chain`)                     half second
//! ```
//!
//! Removing the oldest bound is one step in the left part, adding one at the end a few in the right part. When the left
//! part is empty, the right one replaces it: once per window. The corners of both parts together include all corners of
//! the whole.
//!
//! Bounds are relaxed with the square of their age ([`OffsetBound::loosened`]), with an allowance or without. The
//! square of (t - t_i) is that of t_i plus a function that is linear in t_i, which changes no corner: so corners do not
//! depend on t. A larger allowance keeps all corners, because it bends the points towards the hull, so the corners for
//! the largest one serve any.
//!
//! Sources: Zhang, Liu, Xia (2002), section III; the hull by A. M. Andrew, "Another efficient algorithm for convex hulls in two
//! dimensions" (1979).

use std::collections::VecDeque;

use posebridge_estimator::RestoreError;
use posebridge_estimator::saved::finite;
use serde::{Deserialize, Serialize};

/// The side of the true offset on which the bounds lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BoundSide {
    /// The offset is at most this much.
    Upper,
    /// The offset is at least this much.
    Lower,
}

impl BoundSide {
    /// -1 mirrors the bounds of the lower side, so that it is treated as an upper one.
    const fn sign(self) -> f64 {
        match self {
            Self::Upper => 1.0,
            Self::Lower => -1.0,
        }
    }
}

/// One bound: at the remote instant `t_s` the offset is at most (or at least) `offset_s`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct OffsetBound {
    #[serde(deserialize_with = "finite")]
    pub(super) t_s: f64,
    #[serde(deserialize_with = "finite")]
    pub(super) offset_s: f64,
}

impl OffsetBound {
    /// As a point of the hull at `t_s`: mirrored on the lower side, and relaxed by the possible change of the rate
    /// since, `drift_per_s` (t - t_i)^2 / 2.
    fn loosened(self, side: BoundSide, t_s: f64, drift_per_s: f64) -> Self {
        let age_s = t_s - self.t_s;
        Self { t_s: self.t_s, offset_s: side.sign() * self.offset_s + 0.5 * drift_per_s * age_s * age_s }
    }
}

/// Corners of the hull of one side; keeps its memory between rebuilds.
#[derive(Clone, Debug)]
pub(super) struct BoundHull {
    side: BoundSide,
    /// In time order; offsets of the lower side are mirrored.
    corners: Vec<OffsetBound>,
}

impl BoundHull {
    pub(super) const fn new(side: BoundSide) -> Self {
        Self { side, corners: Vec::new() }
    }

    /// Rebuilds the hull from bounds in time order, each relaxed by the possible change of the rate since.
    pub(super) fn rebuild(&mut self, bounds: impl Iterator<Item = OffsetBound>, t_s: f64, drift_per_s: f64) {
        let Self { side, corners } = self;
        corners.clear();
        // A chain of iterators is walked through by itself quicker than by a loop.
        bounds.for_each(|bound| {
            let next = bound.loosened(*side, t_s, drift_per_s);
            while let [.., before, last] = corners.as_slice()
                && !is_below(before, last, &next)
            {
                corners.pop();
            }
            corners.push(next);
        });
    }

    /// U(s) or L(s) at `t_s`, and the instant of the bound that determines it.
    pub(super) fn at(&self, slope: f64, t_s: f64) -> (f64, f64) {
        let sign = self.side.sign();
        let value = |corner: &OffsetBound| corner.offset_s + sign * slope * (t_s - corner.t_s);
        // Along the hull the values fall to the corner that the line touches and rise behind it.
        let (mut low, mut high) = (0, self.corners.len().saturating_sub(1));
        while low < high {
            let middle = low.midpoint(high);
            if value(&self.corners[middle + 1]) < value(&self.corners[middle]) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        let touched = self.corners.get(low);
        touched.map_or((sign * f64::INFINITY, t_s), |corner| (sign * value(corner), corner.t_s))
    }
}

fn is_below(left: &OffsetBound, middle: &OffsetBound, right: &OffsetBound) -> bool {
    let rise_to_middle = (middle.offset_s - left.offset_s) * (right.t_s - left.t_s);
    let rise_to_right = (right.offset_s - left.offset_s) * (middle.t_s - left.t_s);
    rise_to_middle < rise_to_right
}

/// Bounds of one side, oldest first, one per bucket of time.
#[derive(Clone, Debug)]
pub(super) struct BoundWindow {
    pub(super) side: BoundSide,
    /// The largest allowance of any hull query, per second.
    drift_per_s: f64,
    /// The older part, and for each its next corner towards the middle.
    older: VecDeque<OlderBound>,
    /// The younger part: all of its bounds, for when it becomes the older one.
    younger: Vec<OffsetBound>,
    /// The corners of the younger part.
    chain: Vec<OffsetBound>,
    /// The latest bound, which a tighter one of its bucket replaces; `None` while there are no bounds.
    pub(super) open: Option<OffsetBound>,
}

#[derive(Clone, Copy, Debug)]
struct OlderBound {
    bound: OffsetBound,
    /// Distance to the next corner in `older`; 0 if there is none.
    after: usize,
}

/// The bounds of a window without what follows from them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SavedWindow {
    older: Vec<OffsetBound>,
    younger: Vec<OffsetBound>,
    open: Option<OffsetBound>,
}

impl BoundWindow {
    pub(super) fn save(&self) -> SavedWindow {
        let older = self.older.iter().map(|older| older.bound).collect();
        SavedWindow { older, younger: self.younger.clone(), open: self.open }
    }

    /// Fills an empty window, of at most `most` bounds, with those of another one.
    pub(super) fn restore(mut self, saved: SavedWindow, most: usize) -> Result<Self, RestoreError> {
        let SavedWindow { older, younger, open } = saved;
        let instants: Vec<f64> = older.iter().chain(&younger).chain(&open).map(|bound| bound.t_s).collect();
        let is_sound = instants.len() <= most
            && instants.is_sorted_by(|one, next| one < next)
            && (open.is_some() || instants.is_empty());
        is_sound
            .then_some(())
            .ok_or(RestoreError::Implausible("the bounds of its clock are too many, or out of order"))?;
        self.younger.extend(older);
        self.age_younger();
        for bound in younger.into_iter().chain(open) {
            self.append(bound);
        }
        Ok(self)
    }

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

    pub(super) fn oldest(&self) -> Option<OffsetBound> {
        let older = self.older.front().map(|one| one.bound);
        older.or(self.younger.first().copied()).or(self.open)
    }

    /// Appends a bound of a later bucket.
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

    /// Removes the oldest bounds while `outdated` holds.
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

    /// All bounds that can be corners of the hull, in time order, for any allowance up to the largest.
    pub(super) fn candidates(&self) -> impl Iterator<Item = OffsetBound> {
        let mut next = (!self.older.is_empty()).then_some(0);
        let older = std::iter::from_fn(move || {
            let at = next?;
            let one = self.older.get(at)?;
            next = (one.after > 0).then_some(at + one.after);
            Some(one.bound)
        });
        older.chain(self.chain.iter().copied()).chain(self.open)
    }

    /// The younger part becomes the older one.
    fn age_younger(&mut self) {
        self.chain.clear();
        // Places of the corners from the bound in hand to the middle, the nearest last.
        let mut corners: Vec<usize> = Vec::new();
        for (index, bound) in self.younger.iter().enumerate().rev() {
            while let [.., behind, next] = corners.as_slice()
                && !self.is_corner(*bound, self.younger[*next], self.younger[*behind])
            {
                corners.pop();
            }
            let after = corners.last().map_or(0, |next| next - index);
            let bound = *bound;
            self.older.push_front(OlderBound { bound, after });
            corners.push(index);
        }
        self.younger.clear();
    }

    /// Whether the middle one of three bounds in time order lies below the line from the first to the last, relaxed as
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
    use proptest::prelude::*;

    fn bounds(offsets: &[f64]) -> Vec<OffsetBound> {
        let indexed = offsets.iter().enumerate();
        let bound = |(k, offset_s): (usize, &f64)| OffsetBound { t_s: k as f64 * 0.5, offset_s: *offset_s };
        indexed.map(bound).collect()
    }

    proptest! {
        #[test]
        fn the_hull_equals_the_extreme_of_all_bounds(
            offsets in proptest::collection::vec(0.0..0.05_f64, 1..100),
            slope in -0.0101..0.0101_f64,
            drift_per_s in 0.0..1e-6_f64,
        ) {
            let bounds = bounds(&offsets);
            let t_s = 0.5 * offsets.len() as f64;
            for (side, sign) in [(BoundSide::Upper, 1.0), (BoundSide::Lower, -1.0)] {
                let mut hull = BoundHull::new(side);
                hull.rebuild(bounds.iter().copied(), t_s, drift_per_s);
                let values = bounds.iter().map(|bound| {
                    let age_s = t_s - bound.t_s;
                    sign * (bound.offset_s + slope * age_s) + 0.5 * drift_per_s * age_s * age_s
                });
                let expected = sign * values.fold(f64::INFINITY, f64::min);
                prop_assert!((hull.at(slope, t_s).0 - expected).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn bounds_that_no_slope_can_touch_are_left_out() {
        let mut hull = BoundHull::new(BoundSide::Upper);
        hull.rebuild(bounds(&[0.0, 0.02, 0.01, 0.03, 0.0]).into_iter(), 2.0, 0.0);
        let instants: Vec<f64> = hull.corners.iter().map(|corner| corner.t_s).collect();
        assert_eq!(instants, [0.0, 2.0]);
    }

    const DRIFT_PER_S: f64 = 2e-7;
    const LENGTH_S: f64 = 20.0;

    proptest! {
        #[test]
        fn the_hull_of_the_candidates_is_that_of_all_bounds(
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
                        window.open = Some(bound);
                        all.pop_back();
                        all.push_back(bound);
                    }
                    let is_outdated = |bound: &OffsetBound| t_s - bound.t_s > LENGTH_S;
                    window.drop_outdated(is_outdated);
                    all.retain(|bound| !is_outdated(bound));
                    prop_assert_eq!(window.oldest(), all.front().copied());
                    prop_assert_eq!(window.open, all.back().copied());
                    for drift_per_s in [0.0, DRIFT_PER_S] {
                        let (mut quick, mut complete) = (BoundHull::new(side), BoundHull::new(side));
                        quick.rebuild(window.candidates(), t_s, drift_per_s);
                        complete.rebuild(all.iter().copied(), t_s, drift_per_s);
                        for slope in [-0.01, -0.003, 0.0, 0.001, 0.0025, 0.01] {
                            prop_assert!((quick.at(slope, t_s).0 - complete.at(slope, t_s).0).abs() < 1e-15);
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
        assert_eq!(window.open, None);
        assert_eq!(window.candidates().count(), 0);
    }
}
