//! How a remote clock runs against the host's, bounded from both sides by the instants of messages.
//!
//! A message that was stamped at remote time b and arrived at host time r says: the host clock showed at most r at b. A
//! request that left at host time s and was stamped b by the answering side says: it showed at least s. With offset(b) =
//! host - remote taken as a straight line over a window, every message is a half-plane of lines:
//!
//! ```text
//! offset(b_i) <= r_i - b_i        from every message with a stamp
//! offset(b_j) >= s_j - b_j        from every answered request
//! ```
//! For a slope s the bounds at an instant t are U(s) = min_i(u_i + s (t - t_i)) and L(s) = max_j(l_j + s (t - t_j)); U - L is
//! concave in s. The line taken is the one with the most room, half-way between its bounds; what is reported as uncertainty is
//! the furthest that any line which satisfies all bounds lies from it. Half of an asymmetry of the path cannot be seen by any
//! two-way method, but it lies within these bounds.
//!
//! Sources: convex hulls for one-way delays: Zhang, Liu, Xia (2002); both sides with error bounds: TICSync (2011); docs/maths/clock.md.

use std::collections::VecDeque;

/// Bounds older than this are forgotten, so that the line can follow drift with temperature, s.
const WINDOW_S: f64 = 100.0;
/// One bound of each kind is kept per bucket of this length, s; the tightest.
const BUCKET_S: f64 = 0.5;
/// No clock of a brick is further off: resonators reach 2000 ppm and 10 ppm per degree.
const LARGEST_SKEW: f64 = 0.003;
/// Bounds may contradict each other by so much before the clock is taken to have stepped, s: a brick that reads its clock once per
/// pass of its main loop answers with a reading as old as a pass.
const CONTRADICTION_S: f64 = 0.020;
/// Bisection steps on the slope: 2^-40 of 6000 ppm is far below a nanosecond over the window.
const BISECTIONS: u32 = 40;

/// One bound: at `t_s` the offset is at most (or at least) `offset_s`.
#[derive(Clone, Copy, Debug)]
struct Bound {
    t_s: f64,
    offset_s: f64,
}

/// A straight line through the bounds, valid near the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Remote instant at which `offset_s` holds, s.
    pub at_s: f64,
    /// Host minus remote at `at_s`, s.
    pub offset_s: f64,
    /// Change of the offset per remote second.
    pub slope: f64,
    /// How far the true offset at `at_s` may lie from `offset_s`, s.
    pub uncertainty_s: f64,
}

impl Line {
    /// Host minus remote at a remote instant, s.
    #[must_use]
    pub fn offset_at(&self, remote_s: f64) -> f64 {
        self.offset_s + self.slope * (remote_s - self.at_s)
    }
}

/// The bounds within the window.
#[derive(Clone, Debug, Default)]
pub struct ClockBounds {
    upper: VecDeque<Bound>,
    lower: VecDeque<Bound>,
    slope: f64,
}

impl ClockBounds {
    /// A message stamped `remote_s` arrived at `host_s`.
    pub fn arrived(&mut self, remote_s: f64, host_s: f64) {
        let slope = self.slope;
        let bound = Bound {
            t_s: remote_s,
            offset_s: host_s - remote_s,
        };
        keep_tightest(&mut self.upper, bound, |new, old| {
            new.offset_s - old.offset_s < slope * (new.t_s - old.t_s)
        });
    }

    /// A request that left at `host_s` was stamped `remote_s`.
    pub fn left(&mut self, host_s: f64, remote_s: f64) {
        let slope = self.slope;
        let bound = Bound {
            t_s: remote_s,
            offset_s: host_s - remote_s,
        };
        keep_tightest(&mut self.lower, bound, |new, old| {
            new.offset_s - old.offset_s > slope * (new.t_s - old.t_s)
        });
    }

    /// Whether both sides are bounded.
    #[must_use]
    pub fn is_two_way(&self) -> bool {
        !self.upper.is_empty() && !self.lower.is_empty()
    }

    /// The line with the most room at the remote instant `t_s`; `None` when a side is missing or when no line satisfies all bounds,
    /// because the clock stepped.
    pub fn two_way_line(&mut self, t_s: f64) -> Option<Line> {
        if !self.is_two_way() {
            return None;
        }
        let room = |slope: f64| self.upper_at(slope, t_s).0 - self.lower_at(slope, t_s).0;
        let slope = self.slope_with_most_room(t_s);
        let most_room_s = room(slope);
        if most_room_s < -CONTRADICTION_S {
            return None;
        }
        if most_room_s < 0.0 {
            let offset_s = 0.5 * (self.upper_at(slope, t_s).0 + self.lower_at(slope, t_s).0);
            self.slope = slope;
            return Some(Line {
                at_s: t_s,
                offset_s,
                slope,
                uncertainty_s: -most_room_s,
            });
        }
        // All slopes that leave room: from the best one outwards to where it vanishes.
        let lowest = bisect(-LARGEST_SKEW, slope, |slope| room(slope) >= 0.0);
        let highest = bisect(LARGEST_SKEW, slope, |slope| room(slope) >= 0.0);
        let offset_s = 0.5 * (self.upper_at(slope, t_s).0 + self.lower_at(slope, t_s).0);
        // U is concave and L convex in the slope: their extremes over an interval lie at its ends or at the best slope.
        let furthest_up = [lowest, slope, highest]
            .map(|slope| self.upper_at(slope, t_s).0)
            .into_iter()
            .fold(self.highest_upper(lowest, highest, t_s), f64::max);
        let furthest_down = [lowest, slope, highest]
            .map(|slope| self.lower_at(slope, t_s).0)
            .into_iter()
            .fold(self.lowest_lower(lowest, highest, t_s), f64::min);
        let uncertainty_s = (furthest_up - offset_s).max(offset_s - furthest_down);
        self.slope = slope;
        Some(Line {
            at_s: t_s,
            offset_s,
            slope,
            uncertainty_s,
        })
    }

    /// The line below all arrivals that is highest in the middle of the window, for a clock that never answers. Its offset is late by the
    /// link's smallest delay, which a one-way observer cannot know; `assumed_delay_s` stands in for it, and for its uncertainty.
    pub fn one_way_line(&mut self, t_s: f64, assumed_delay_s: f64) -> Option<Line> {
        let (first, last) = (self.upper.front()?, self.upper.back()?);
        let middle_s = 0.5 * (first.t_s + last.t_s);
        let slope = self.highest_slope(-LARGEST_SKEW, LARGEST_SKEW, middle_s);
        self.slope = slope;
        let offset_s =
            self.upper_at(slope, middle_s).0 + slope * (t_s - middle_s) - assumed_delay_s;
        Some(Line {
            at_s: t_s,
            offset_s,
            slope,
            uncertainty_s: assumed_delay_s,
        })
    }

    /// U(s) at `t_s`, and the instant of the bound that makes it.
    fn upper_at(&self, slope: f64, t_s: f64) -> (f64, f64) {
        self.upper.iter().fold((f64::INFINITY, t_s), |best, bound| {
            let value = bound.offset_s + slope * (t_s - bound.t_s);
            if value < best.0 {
                (value, bound.t_s)
            } else {
                best
            }
        })
    }

    /// L(s) at `t_s`, and the instant of the bound that makes it.
    fn lower_at(&self, slope: f64, t_s: f64) -> (f64, f64) {
        self.lower
            .iter()
            .fold((f64::NEG_INFINITY, t_s), |best, bound| {
                let value = bound.offset_s + slope * (t_s - bound.t_s);
                if value > best.0 {
                    (value, bound.t_s)
                } else {
                    best
                }
            })
    }

    /// Where the concave room is largest: its derivative is the distance in time between the two bounds that make it.
    fn slope_with_most_room(&self, t_s: f64) -> f64 {
        let rises = |slope: f64| self.lower_at(slope, t_s).1 > self.upper_at(slope, t_s).1;
        climb(-LARGEST_SKEW, LARGEST_SKEW, rises)
    }

    fn highest_slope(&self, low: f64, high: f64, t_s: f64) -> f64 {
        climb(low, high, |slope| self.upper_at(slope, t_s).1 < t_s)
    }

    fn highest_upper(&self, low: f64, high: f64, t_s: f64) -> f64 {
        self.upper_at(self.highest_slope(low, high, t_s), t_s).0
    }

    fn lowest_lower(&self, low: f64, high: f64, t_s: f64) -> f64 {
        let slope = climb(low, high, |slope| self.lower_at(slope, t_s).1 > t_s);
        self.lower_at(slope, t_s).0
    }
}

fn keep_tightest(
    bounds: &mut VecDeque<Bound>,
    new: Bound,
    is_tighter: impl Fn(&Bound, &Bound) -> bool,
) {
    let bucket = |bound: &Bound| (bound.t_s / BUCKET_S).floor();
    match bounds.back_mut() {
        Some(last) if bucket(last) >= bucket(&new) => {
            if is_tighter(&new, last) {
                *last = new;
            }
        }
        _ => bounds.push_back(new),
    }
    while bounds
        .front()
        .is_some_and(|first| new.t_s - first.t_s > WINDOW_S)
    {
        bounds.pop_front();
    }
}

/// The highest point of a concave function between two slopes, by the sign of its derivative.
fn climb(mut low: f64, mut high: f64, rises: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if rises(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// The point nearest to `outside` at which a condition that holds at `inside` still holds.
fn bisect(outside: f64, inside: f64, holds: impl Fn(f64) -> bool) -> f64 {
    if holds(outside) {
        return outside;
    }
    let (mut bad, mut good) = (outside, inside);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (bad + good);
        if holds(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}
