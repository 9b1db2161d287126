//! The maximum and the zeros of a concave, piecewise linear function of the slope.
//!
//! The margin between two hulls is such a function: each piece belongs to a pair of corners. A search along the pieces'
//! own lines finds the exact result after some four evaluations; bisection took forty and was approximate.
//!
//! ```text
//!        ___o___             highest: where the lines of two pieces, one that rises and one that falls, cross on the function
//!      o‾       ‾‾o__        vanishing: Newton's method from outside never steps over the edge, because each line lies above
//!     /              ‾o      the function
//! ```
//!
//! Sources: J. E. Kelley, "The cutting-plane method for solving convex programs" (1960), in one variable; Newton's method.

/// The piece of the function at a slope, as a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LinearPiece {
    /// The slope at which the function was evaluated.
    pub(super) slope: f64,
    pub(super) value_s: f64,
    /// The function's derivative there.
    pub(super) rise_s: f64,
}

impl LinearPiece {
    /// The slope at which two lines cross; NaN if they are parallel.
    fn crossing(&self, other: &Self) -> f64 {
        let ahead_s = self.value_s - (other.value_s + other.rise_s * (self.slope - other.slope));
        self.slope + ahead_s / (other.rise_s - self.rise_s)
    }
}

/// The slope between two others at which a concave function is highest; the lower end of a plateau. `most_pieces` is an
/// upper bound of the number of pieces.
pub(super) fn argmax(low: f64, high: f64, most_pieces: usize, of: impl Fn(f64) -> LinearPiece) -> f64 {
    let (mut left, mut right) = (of(low), of(high));
    if left.rise_s <= 0.0 {
        return low;
    }
    if right.rise_s > 0.0 {
        return high;
    }
    let mut top = low;
    for _ in 0..most_pieces {
        top = left.crossing(&right).max(low).min(high);
        let found = of(top);
        let end = if found.rise_s > 0.0 { &mut left } else { &mut right };
        // The very line again: both lines hold up to where they cross.
        if end.rise_s == found.rise_s {
            break;
        }
        *end = found;
    }
    top
}

/// The slope nearest to `outside` at which a concave function is not negative; it is not negative at `inside`.
pub(super) fn nearest_nonnegative(
    outside: f64,
    inside: f64,
    most_pieces: usize,
    of: impl Fn(f64) -> LinearPiece,
) -> f64 {
    let (low, high) = (outside.min(inside), outside.max(inside));
    let mut piece = of(outside);
    for _ in 0..most_pieces {
        if piece.value_s >= 0.0 || piece.rise_s == 0.0 {
            break;
        }
        let next = of((piece.slope - piece.value_s / piece.rise_s).max(low).min(high));
        let is_same_line = next.rise_s == piece.rise_s;
        piece = next;
        if is_same_line {
            break;
        }
    }
    piece.slope
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The lowest of straight lines, each by its value at slope zero and its rise.
    fn lowest(lines: &[(f64, f64)], slope: f64) -> LinearPiece {
        let pieces = lines.iter().map(|(at_zero_s, rise_s)| LinearPiece {
            slope,
            value_s: at_zero_s + rise_s * slope,
            rise_s: *rise_s,
        });
        pieces.min_by(|a, b| a.value_s.total_cmp(&b.value_s)).unwrap()
    }

    /// By forty halvings, which need nothing but the sign of the rise.
    fn climb_by_halves(mut low: f64, mut high: f64, lines: &[(f64, f64)]) -> f64 {
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if lowest(lines, middle).rise_s > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }

    /// By forty halvings between what is negative and what is not.
    fn edge_by_halves(outside: f64, inside: f64, lines: &[(f64, f64)]) -> f64 {
        if lowest(lines, outside).value_s >= 0.0 {
            return outside;
        }
        let (mut bad, mut good) = (outside, inside);
        for _ in 0..40 {
            let middle = 0.5 * (bad + good);
            if lowest(lines, middle).value_s >= 0.0 {
                good = middle;
            } else {
                bad = middle;
            }
        }
        good
    }

    proptest! {
        #[test]
        fn it_finds_what_halving_comes_near_to(
            // Rises in whole half seconds, so that some pieces are level.
            lines in proptest::collection::vec((0.0..0.05_f64, -240..240_i32), 1..60),
        ) {
            let lines: Vec<(f64, f64)> =
                lines.iter().map(|(value_s, rise)| (*value_s, 0.5 * f64::from(*rise))).collect();
            let of = |slope| lowest(&lines, slope);
            let most = lines.len() + 2;
            let highest = argmax(-0.01, 0.01, most, of);
            prop_assert!((highest - climb_by_halves(-0.01, 0.01, &lines)).abs() < 1e-13);
            for outside in [-0.01, 0.01] {
                let found = nearest_nonnegative(outside, 0.0, most, of);
                prop_assert!((found - edge_by_halves(outside, 0.0, &lines)).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn of_a_level_top_it_takes_the_lower_end_and_at_an_end_it_stays() {
        let lines = [(3.0, 2.0), (3.5, 0.0), (4.0, -1.0)];
        let of = |slope| lowest(&lines, slope);
        assert_eq!(argmax(-1.0, 1.0, 5, of), 0.25);
        assert_eq!(argmax(0.3, 1.0, 5, of), 0.3);
        assert_eq!(argmax(-1.0, 0.1, 5, of), 0.1);
    }
}
