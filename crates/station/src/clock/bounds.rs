//! Bounds of a remote clock's offset from the host's, from both sides, by the instants of messages.
//!
//! A message that was stamped at remote time b and arrived at host time r shows that the host clock was at most r at b.
//! A request that was sent at host time s and stamped b by the replying side shows that it was at least s. With
//! offset(b) = host - remote, which deviates by at most a (t - b)^2 / 2 from its tangent at t, every message is a
//! half-plane of tangents:
//!
//! ```text
//! offset(t) + s (b_i - t) <= r_i - b_i + a (t - b_i)^2 / 2      from every message with a stamp
//! offset(t) + s (b_j - t) >= s_j - b_j - a (t - b_j)^2 / 2      from every answered request
//! ```
//! For a slope s the bounds at an instant t are U(s) = min_i(u_i + s (t - t_i)) and L(s) = max_j(l_j + s (t - t_j));
//! their difference is concave in s. The chosen line is the one with the largest margin for a clock without drift
//! (a = 0), half-way between its bounds; its uncertainty is the largest distance of any tangent that satisfies all
//! bounds of a drifting clock. Half of the path's asymmetry is unobservable by any two-way method, but it lies within
//! these bounds.
//!
//! Sources: convex hulls for one-way delays: Zhang, Liu, Xia (2002); both sides with error bounds: TICSync (2011);
//! docs/maths/clock.md, sections 2 and 3.

use posebridge_estimator::RestoreError;
use posebridge_estimator::saved::finite;
use serde::{Deserialize, Serialize};

use super::MAX_SKEW;
use super::hull::{BoundHull, BoundSide, BoundWindow, OffsetBound, SavedWindow};
use super::maximize::{LinearPiece, argmax, nearest_nonnegative};

/// Window of the bounds, s. It balances the effect of the delays' jitter on the line's end, which falls with the
/// window, against the deviation of a drifting clock from a line, which grows with its square; docs/maths/clock.md,
/// equation (7).
const WINDOW_S: f64 = 120.0;
/// One bound of each kind is kept per bucket of this length, s: the tightest.
const BUCKET_S: f64 = 0.5;
/// Bounds of one kind within the window, and one on each of its ends.
const MAX_BOUNDS: usize = (WINDOW_S / BUCKET_S) as usize + 2;
/// The steepest slope of the offset, host minus remote per remote second, for a clock that is slow by [`MAX_SKEW`].
const MAX_SLOPE: f64 = MAX_SKEW / (1.0 - MAX_SKEW);
/// Steeper slopes are searched only if none up to this one fits: few clocks are so far off, and the first exchanges on
/// a jittery link fit many slopes. Resonators of bricks reach 2000 ppm and 10 ppm per degree.
const USUAL_SLOPE: f64 = 0.003;
/// Largest drift of a clock's rate, per second: 10 ppm per degree and 1.2 degrees per minute, a brick that was just
/// switched on.
const MAX_DRIFT_PER_S: f64 = 2e-7;
/// Largest contradiction of two bounds, s; a larger one means that the clock stepped. A brick that reads its clock once
/// per pass of its main loop replies with a reading as old as a pass.
const CONTRADICTION_S: f64 = 0.020;
/// Corners of both hulls, and so pieces of the margin between them.
const MAX_PIECES: usize = 2 * MAX_BOUNDS;

/// A tangent to the offset between the bounds, valid near the window's end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearOffset {
    /// Remote instant at which `offset_s` holds.
    #[serde(deserialize_with = "finite")]
    pub at_s: f64,
    /// Host minus remote at `at_s`.
    #[serde(deserialize_with = "finite")]
    pub offset_s: f64,
    /// Change of the offset per remote second.
    #[serde(deserialize_with = "finite")]
    pub slope: f64,
    /// Largest deviation of the true offset from `offset_s` at `at_s`.
    #[serde(deserialize_with = "finite")]
    pub uncertainty_s: f64,
    /// Largest deviation of the true slope from `slope` at `at_s`.
    #[serde(deserialize_with = "finite")]
    pub slope_uncertainty: f64,
}

impl LinearOffset {
    /// Host minus remote at a remote instant, s.
    pub fn offset_at(&self, remote_s: f64) -> f64 {
        self.offset_s + self.slope * (remote_s - self.at_s)
    }

    /// Largest deviation of the true offset from [`Self::offset_at`] at a remote instant, s: it grows with the distance
    /// from `at_s`, because the slope is not known exactly and may change.
    pub fn uncertainty_at(&self, remote_s: f64) -> f64 {
        let away_s = (remote_s - self.at_s).abs();
        self.uncertainty_s + self.slope_uncertainty * away_s + 0.5 * MAX_DRIFT_PER_S * away_s * away_s
    }
}

/// A line half-way between the bounds.
#[derive(Clone, Copy, Debug)]
struct CentralOffset {
    slope: f64,
    offset_s: f64,
    margin_s: f64,
}

/// The bounds within the window, without what follows from them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedBounds {
    upper: SavedWindow,
    lower: SavedWindow,
    #[serde(deserialize_with = "finite")]
    slope: f64,
}

/// The bounds within the window.
#[derive(Clone, Debug)]
pub struct ClockBounds {
    upper: BoundWindow,
    lower: BoundWindow,
    upper_hull: BoundHull,
    lower_hull: BoundHull,
    slope: f64,
}

impl Default for ClockBounds {
    fn default() -> Self {
        Self {
            upper: BoundWindow::new(BoundSide::Upper, MAX_DRIFT_PER_S, MAX_BOUNDS),
            lower: BoundWindow::new(BoundSide::Lower, MAX_DRIFT_PER_S, MAX_BOUNDS),
            upper_hull: BoundHull::new(BoundSide::Upper),
            lower_hull: BoundHull::new(BoundSide::Lower),
            slope: 0.0,
        }
    }
}

impl ClockBounds {
    pub(super) fn save(&self) -> SavedBounds {
        // The hulls are made anew for every question.
        let Self { upper, lower, upper_hull: _, lower_hull: _, slope } = self;
        SavedBounds { upper: upper.save(), lower: lower.save(), slope: *slope }
    }

    pub(super) fn restored(saved: SavedBounds) -> Result<Self, RestoreError> {
        let Self { upper, lower, upper_hull, lower_hull, .. } = Self::default();
        let SavedBounds { upper: of_upper, lower: of_lower, slope } = saved;
        let upper = upper.restore(of_upper, MAX_BOUNDS)?;
        let lower = lower.restore(of_lower, MAX_BOUNDS)?;
        Ok(Self { upper, lower, upper_hull, lower_hull, slope })
    }

    pub fn add_arrival(&mut self, remote_s: f64, host_s: f64) {
        keep_tightest(&mut self.upper, self.slope, OffsetBound { t_s: remote_s, offset_s: host_s - remote_s });
    }

    pub fn add_departure(&mut self, host_s: f64, remote_s: f64) {
        keep_tightest(&mut self.lower, self.slope, OffsetBound { t_s: remote_s, offset_s: host_s - remote_s });
    }

    /// Discards bounds that are a window older than `t_s`.
    pub fn discard_before(&mut self, t_s: f64) {
        for bounds in [&mut self.upper, &mut self.lower] {
            bounds.drop_outdated(|bound| t_s - bound.t_s > WINDOW_S);
        }
    }

    pub fn is_two_way(&self) -> bool {
        self.upper.open.is_some() && self.lower.open.is_some()
    }

    /// The line with the largest margin at the remote instant `t_s`; `None` when a side is missing, or when no line
    /// satisfies all bounds because the clock stepped.
    pub fn two_way_offset(&mut self, t_s: f64) -> Option<LinearOffset> {
        if !self.is_two_way() {
            return None;
        }
        self.rebuild_hulls(t_s, 0.0);
        let mut middle = self.central_offset(t_s, USUAL_SLOPE);
        if middle.margin_s < 0.0 {
            middle = self.central_offset(t_s, MAX_SLOPE);
        }
        self.rebuild_hulls(t_s, MAX_DRIFT_PER_S);
        if middle.margin_s < 0.0 {
            // On a link as quick as a cable a drift of minutes is larger than the room: then only a bent clock fits.
            middle = self.central_offset(t_s, MAX_SLOPE);
        }
        if middle.margin_s < -CONTRADICTION_S {
            return None;
        }
        self.slope = middle.slope;
        Some(self.offset_around(t_s, middle))
    }

    /// The line below all arrivals that is highest in the middle of the window, for a clock that never replies. Its
    /// offset is late by the link's smallest delay, which one-way messages cannot show; `assumed_delay_s` replaces it,
    /// and is its uncertainty.
    pub fn one_way_offset(&mut self, t_s: f64, assumed_delay_s: f64) -> Option<LinearOffset> {
        let (first, last) = (self.upper.oldest()?, self.upper.open?);
        let (middle_s, half_s) = (0.5 * (first.t_s + last.t_s), 0.5 * (last.t_s - first.t_s));
        self.upper_hull.rebuild(self.upper.candidates(), t_s, 0.0);
        let slope = argmax(-MAX_SLOPE, MAX_SLOPE, MAX_PIECES, |slope| {
            let (value_s, touched_s) = self.upper_hull.at(slope, middle_s);
            LinearPiece { slope, value_s, rise_s: middle_s - touched_s }
        });
        self.slope = slope;
        let offset_s = self.upper_hull.at(slope, middle_s).0 + slope * (t_s - middle_s) - assumed_delay_s;
        Some(LinearOffset {
            at_s: t_s,
            offset_s,
            slope,
            uncertainty_s: assumed_delay_s,
            // By so much a line can turn about its middle before an end leaves the assumed band.
            slope_uncertainty: MAX_SLOPE.min(assumed_delay_s / half_s),
        })
    }

    fn rebuild_hulls(&mut self, t_s: f64, drift_per_s: f64) {
        self.upper_hull.rebuild(self.upper.candidates(), t_s, drift_per_s);
        self.lower_hull.rebuild(self.lower.candidates(), t_s, drift_per_s);
    }

    /// The margin at a slope; its derivative is the distance in time between the two bounds that determine it.
    fn margin(&self, slope: f64, t_s: f64) -> LinearPiece {
        let (upper_s, upper_at_s) = self.upper_hull.at(slope, t_s);
        let (lower_s, lower_at_s) = self.lower_hull.at(slope, t_s);
        LinearPiece { slope, value_s: upper_s - lower_s, rise_s: lower_at_s - upper_at_s }
    }

    /// The line with the largest margin.
    fn central_offset(&self, t_s: f64, steepest: f64) -> CentralOffset {
        let margin = |slope| self.margin(slope, t_s);
        let slope = argmax(-steepest, steepest, MAX_PIECES, margin);
        let (upper_s, lower_s) = (self.upper_hull.at(slope, t_s).0, self.lower_hull.at(slope, t_s).0);
        CentralOffset { slope, offset_s: 0.5 * (upper_s + lower_s), margin_s: upper_s - lower_s }
    }

    /// The line, with the largest distance of any other line that satisfies the bounds of the hulls.
    fn offset_around(&self, t_s: f64, middle: CentralOffset) -> LinearOffset {
        let CentralOffset { slope, offset_s, margin_s } = middle;
        if margin_s < 0.0 {
            return LinearOffset { at_s: t_s, offset_s, slope, uncertainty_s: -margin_s, slope_uncertainty: 0.0 };
        }
        let (upper, lower) = (&self.upper_hull, &self.lower_hull);
        // All slopes that leave room: from the best one outwards to where it vanishes.
        let margin = |slope| self.margin(slope, t_s);
        let lowest = nearest_nonnegative(-MAX_SLOPE, slope, MAX_PIECES, margin);
        let highest = nearest_nonnegative(MAX_SLOPE, slope, MAX_PIECES, margin);
        // U is concave and L convex in the slope.
        let at_highest = argmax(lowest, highest, MAX_PIECES, |slope| {
            let (value_s, touched_s) = upper.at(slope, t_s);
            LinearPiece { slope, value_s, rise_s: t_s - touched_s }
        });
        let at_lowest = argmax(lowest, highest, MAX_PIECES, |slope| {
            let (value_s, touched_s) = lower.at(slope, t_s);
            LinearPiece { slope, value_s: -value_s, rise_s: touched_s - t_s }
        });
        let uncertainty_s = (upper.at(at_highest, t_s).0 - offset_s).max(offset_s - lower.at(at_lowest, t_s).0);
        LinearOffset {
            at_s: t_s,
            offset_s,
            slope,
            uncertainty_s,
            slope_uncertainty: (highest - slope).max(slope - lowest),
        }
    }
}

fn keep_tightest(bounds: &mut BoundWindow, slope: f64, new: OffsetBound) {
    let bucket = |bound: &OffsetBound| (bound.t_s / BUCKET_S).floor();
    match bounds.open {
        // Overtaken by half a second: the bounds stay in the order of time.
        Some(last) if bucket(&last) > bucket(&new) => {}
        Some(last) if bucket(&last) == bucket(&new) => {
            let (rise_s, expected_s) = (new.offset_s - last.offset_s, slope * (new.t_s - last.t_s));
            let is_tighter = match bounds.side {
                BoundSide::Upper => rise_s < expected_s,
                BoundSide::Lower => rise_s > expected_s,
            };
            if is_tighter {
                bounds.open = Some(new);
            }
        }
        _ => bounds.append(new),
    }
}
