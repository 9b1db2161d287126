//! The conversion between two clocks, which follows the fitted lines and never runs backwards.
//!
//! Every exchange gives a slightly different line. If stamps were converted by the latest one, two stamps in order
//! could come out in the wrong order, and one stamp could mean two instants. Therefore the conversion is one continuous
//! function of remote time, linear between knots. It changes only from the instant of a new line on: earlier values
//! stay. It turns towards the line at a limited rate and then follows it.
//!
//! ```text
//! H(b) = b + o(b)              host instant of the remote instant b
//! o'(b) = slope ± SLEW         until the line is reached, then slope
//! H'(b) >= 1 - LARGEST_SKEW - SLEW > 0      LARGEST_SKEW = 0.01
//! ```
//!
//! Source: the slewing of the Network Time Protocol (RFC 5905, section 12), with a rate for bricks; docs/maths/clock.md, section 4.

use std::collections::VecDeque;

use posebridge_estimator::RestoreError;
use posebridge_estimator::saved::{finite, is_ordered};
use serde::{Deserialize, Serialize};

use super::bounds::LinearOffset;

/// Rate at which the conversion turns towards a new line. 15 ms, the first error on a Bluetooth link, are corrected in
/// 0.3 s, and an interval is wrong by a twentieth meanwhile. The Network Time Protocol uses 500 ppm, but no robot
/// drives by its clock.
const SLEW_RATE: f64 = 0.05;
/// More than any clock and the turn towards its line: beyond -1 time would run backwards.
const LARGEST_SLOPE: f64 = 0.5;
/// Two per line; with ten lines per second, the highest configured rate, they reach back 12 s: longer than the delay of
/// any fix.
const MAX_KNOTS: usize = 256;

/// From `at_s` on the offset is `offset_s + slope (b - at_s)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct ConversionKnot {
    #[serde(deserialize_with = "finite")]
    at_s: f64,
    #[serde(deserialize_with = "finite")]
    offset_s: f64,
    #[serde(deserialize_with = "finite")]
    slope: f64,
}

impl ConversionKnot {
    fn offset_at(&self, remote_s: f64) -> f64 {
        self.offset_s + self.slope * (remote_s - self.at_s)
    }

    /// The instant whose converted value is `host_s`.
    fn remote_at(&self, host_s: f64) -> f64 {
        let since_s = host_s - self.at_s - self.offset_s;
        self.at_s + since_s / (1.0 + self.slope)
    }
}

/// A continuous, strictly increasing function from remote to host seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockConversion {
    /// In the order of time.
    knots: VecDeque<ConversionKnot>,
}

impl ClockConversion {
    pub(super) fn check(&self) -> Result<(), RestoreError> {
        let is_sound = self.knots.len() <= MAX_KNOTS
            && is_ordered(&self.knots, |knot| knot.at_s, |one, next| one <= next)
            && self.knots.iter().all(|knot| knot.slope.abs() <= LARGEST_SLOPE);
        is_sound.then_some(()).ok_or(RestoreError::Implausible("the conversion of its clock has knots that cannot be"))
    }

    /// Follows `line` from the remote instant `from_s` on; earlier values stay. The first line is used without a turn.
    pub fn steer(&mut self, line: &LinearOffset, from_s: f64) {
        let on_line = |at_s: f64| ConversionKnot { at_s, offset_s: line.offset_at(at_s), slope: line.slope };
        let Some(offset_s) = self.offset_at(from_s) else {
            self.knots.push_back(on_line(from_s));
            return;
        };
        while self.knots.back().is_some_and(|knot| knot.at_s >= from_s) {
            self.knots.pop_back();
        }
        let gap_s = line.offset_at(from_s) - offset_s;
        self.knots.push_back(ConversionKnot { at_s: from_s, offset_s, slope: line.slope + SLEW_RATE * gap_s.signum() });
        self.knots.push_back(on_line(from_s + gap_s.abs() / SLEW_RATE));
        while self.knots.len() > MAX_KNOTS {
            self.knots.pop_front();
        }
    }

    /// Host minus remote at a remote instant, s; `None` before the first line.
    pub fn offset_at(&self, remote_s: f64) -> Option<f64> {
        let knot = self.knot(|knot| knot.at_s <= remote_s)?;
        Some(knot.offset_at(remote_s))
    }

    /// The remote instant that is converted to `host_s`; `None` before the first line.
    pub fn remote_at(&self, host_s: f64) -> Option<f64> {
        let knot = self.knot(|knot| knot.at_s + knot.offset_s <= host_s)?;
        Some(knot.remote_at(host_s))
    }

    /// The last knot for which `is_before` holds; before all knots the first one's line is used.
    fn knot(&self, is_before: impl Fn(&ConversionKnot) -> bool) -> Option<&ConversionKnot> {
        let before = self.knots.iter().rev().find(|knot| is_before(knot));
        before.or_else(|| self.knots.front())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn line(at_s: f64, offset_s: f64, slope: f64) -> LinearOffset {
        LinearOffset { at_s, offset_s, slope, uncertainty_s: 0.0, slope_uncertainty: 0.0 }
    }

    /// A conversion that was steered ten times a second towards lines that all differ.
    fn steered(lines: &[(f64, f64)]) -> ClockConversion {
        let mut conversion = ClockConversion::default();
        for (k, (offset_s, slope)) in lines.iter().enumerate() {
            let at_s = k as f64 * 0.1;
            conversion.steer(&line(at_s, *offset_s, *slope), at_s);
        }
        conversion
    }

    const LINES: std::ops::Range<usize> = 1..60;

    proptest! {
        #[test]
        fn converted_instants_keep_their_order_and_the_round_trip_is_the_identity(
            lines in proptest::collection::vec((-0.02..0.02_f64, -0.0101..0.0101_f64), LINES),
            remotes in proptest::collection::vec(-1.0..8.0_f64, 2..40),
        ) {
            let conversion = steered(&lines);
            let mut remotes = remotes;
            remotes.sort_by(f64::total_cmp);
            let mut before = f64::NEG_INFINITY;
            for remote_s in remotes {
                let host_s = remote_s + conversion.offset_at(remote_s).unwrap();
                prop_assert!(host_s >= before);
                before = host_s;
                let back_s = conversion.remote_at(host_s).unwrap();
                prop_assert!((back_s - remote_s).abs() < 1e-12, "{back_s} {remote_s}");
            }
        }

        #[test]
        fn a_new_line_changes_nothing_that_was(
            lines in proptest::collection::vec((-0.02..0.02_f64, -0.0101..0.0101_f64), LINES),
            ago_s in 0.0..3.0_f64,
        ) {
            let mut conversion = steered(&lines);
            let now_s = lines.len() as f64 * 0.1;
            let query_s = now_s - ago_s;
            let before_s = conversion.offset_at(query_s);
            conversion.steer(&line(now_s, 0.5, 0.0), now_s);
            let after_s = conversion.offset_at(query_s);
            prop_assert!((before_s.unwrap() - after_s.unwrap()).abs() < 1e-15);
        }
    }

    #[test]
    fn a_line_15_ms_away_is_reached_after_three_tenths_of_a_second_and_followed() {
        let mut conversion = ClockConversion::default();
        conversion.steer(&line(0.0, 0.0, 1e-4), 0.0);
        conversion.steer(&line(1.0, 0.0151, 1e-4), 1.0);
        for (remote_s, offset_s) in [(0.5, 0.000_05), (1.0, 0.0001), (1.1, 0.005_11), (1.3, 0.015_13), (9.0, 0.0159)] {
            let found_s = conversion.offset_at(remote_s).unwrap();
            assert!((found_s - offset_s).abs() < 1e-12, "{found_s}");
        }
    }

    #[test]
    fn it_does_not_grow_without_bound() {
        let conversion = steered(&[(0.0, 0.0); 1_000]);
        assert_eq!(conversion.knots.len(), MAX_KNOTS);
        assert_eq!(ClockConversion::default().remote_at(0.0), None);
    }
}
