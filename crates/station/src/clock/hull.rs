//! The bounds of one side of a clock, reduced to those that can ever matter.
//!
//! For a slope s the bounds of the upper side at an instant t are U(s) = min_i(u_i + s (t - t_i)), those of the lower side
//! L(s) = max_j(l_j + s (t - t_j)). Only the corners of the convex hull of the points (t_i, u_i), seen from below, can make the
//! minimum for any s at all, so a search over the slope visits some ten points instead of hundreds.
//!
//! ```text
//!   u  .    .  .      points: delays of messages        corners: the quickest ones
//!      o__  .    .
//!         ‾‾o___.___o
//! ```
//!
//! Sources: Zhang, Liu, Xia (2002), section III; the hull by A. M. Andrew, "Another efficient algorithm for convex hulls in two
//! dimensions" (1979).

/// On which side of the true offset the bounds lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BoundSide {
    /// The offset is at most this much.
    Upper,
    /// The offset is at least this much.
    Lower,
}

impl BoundSide {
    /// Turns the lower side into an upper one: its bounds are mirrored.
    const fn sign(self) -> f64 {
        match self {
            Self::Upper => 1.0,
            Self::Lower => -1.0,
        }
    }
}

/// One bound: at the remote instant `t_s` the offset is at most (or at least) `offset_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OffsetBound {
    pub(super) t_s: f64,
    pub(super) offset_s: f64,
}

impl OffsetBound {
    /// As a point of the hull at `t_s`: that of the lower side mirrored, and loosened by what the rate may have changed since,
    /// `drift_per_s` (t - t_i)^2 / 2.
    pub(super) fn loosened(self, side: BoundSide, t_s: f64, drift_per_s: f64) -> Self {
        let age_s = t_s - self.t_s;
        Self { t_s: self.t_s, offset_s: side.sign() * self.offset_s + 0.5 * drift_per_s * age_s * age_s }
    }
}

/// Corners of the hull of one side. Its memory is kept from one set of bounds to the next.
#[derive(Clone, Debug)]
pub(super) struct BoundHull {
    side: BoundSide,
    /// In the order of time; offsets of the lower side are mirrored.
    corners: Vec<OffsetBound>,
}

impl BoundHull {
    pub(super) const fn new(side: BoundSide) -> Self {
        Self { side, corners: Vec::new() }
    }

    /// Takes the bounds anew, in the order of time, each loosened by what the rate may have changed since.
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

    /// U(s) or L(s) at `t_s`, and the instant of the bound that makes it.
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

/// Whether `middle` lies below the straight line from `left` to `right`.
pub(super) fn is_below(left: &OffsetBound, middle: &OffsetBound, right: &OffsetBound) -> bool {
    let rise_to_middle = (middle.offset_s - left.offset_s) * (right.t_s - left.t_s);
    let rise_to_right = (right.offset_s - left.offset_s) * (middle.t_s - left.t_s);
    rise_to_middle < rise_to_right
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bounds(offsets: &[f64]) -> Vec<OffsetBound> {
        let places = offsets.iter().enumerate();
        let bound = |(k, offset_s): (usize, &f64)| OffsetBound { t_s: k as f64 * 0.5, offset_s: *offset_s };
        places.map(bound).collect()
    }

    proptest! {
        #[test]
        fn the_hull_says_what_all_bounds_say(
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
}
