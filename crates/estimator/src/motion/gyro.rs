//! The gyro's rate over time.

use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

use super::count_before;
use super::reading::InsertOutcome;

/// The last sample is held for this long and no longer: three periods of a 50 Hz gyro.
const SAMPLE_HOLD: TimeDelta = TimeDelta::from_millis(60);
/// Samples further apart than this leave a gap. A sample is the mean since the one before it only where the sender sums
/// the turn; elsewhere a long gap is unknown. Five lost frames in a row at 20 Hz are still bridged.
const MAX_SAMPLE_INTERVAL: TimeDelta = TimeDelta::from_millis(300);

/// The gyro's turn between two instants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroTurn {
    /// Integral of the rate, bias included.
    pub turn_rad: f64,
    /// Sum of the squared intervals of the samples: times the variance of one sample, the variance of `turn_rad`.
    pub squared_intervals_s2: f64,
}

impl GyroTurn {
    fn add(&mut self, rate_rad_per_s: f64, length: TimeDelta) {
        let secs = length.as_secs_f64();
        self.turn_rad += rate_rad_per_s * secs;
        self.squared_intervals_s2 += secs * secs;
    }
}

/// The gyro's rate over time: each sample is the mean since the one before it.
#[derive(Clone, Debug, Default)]
pub struct GyroTrack {
    samples: VecDeque<(Timestamp<BrickClock>, f64)>,
    is_truncated: bool,
}

impl GyroTrack {
    pub fn insert(&mut self, stamp: Timestamp<BrickClock>, rate_rad_per_s: f64) -> InsertOutcome {
        let index = count_before(&self.samples, |sample| sample.0 < stamp);
        if self.samples.get(index).is_some_and(|sample| sample.0 == stamp) {
            return InsertOutcome::Duplicate;
        }
        let before = index.checked_sub(1).and_then(|i| self.samples.get(i)).map(|sample| sample.0);
        if before.is_none() && self.is_truncated {
            return InsertOutcome::TooOld;
        }
        self.samples.insert(index, (stamp, rate_rad_per_s));
        InsertOutcome::Inserted(before)
    }

    /// The stamp of the last sample up to and including an instant.
    pub fn last_at_or_before(&self, stamp: Timestamp<BrickClock>) -> Option<Timestamp<BrickClock>> {
        let index = count_before(&self.samples, |sample| sample.0 <= stamp);
        let last = self.samples.get(index.checked_sub(1)?)?;
        Some(last.0)
    }

    /// The same by bisection, for an instant before most samples.
    pub fn bisect_last_at_or_before(&self, stamp: Timestamp<BrickClock>) -> Option<Timestamp<BrickClock>> {
        let index = self.samples.partition_point(|sample| sample.0 <= stamp);
        let last = self.samples.get(index.checked_sub(1)?)?;
        Some(last.0)
    }

    /// Whether the span has no gap; the last sample is held for `SAMPLE_HOLD`.
    pub fn covers(&self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) -> bool {
        let next = count_before(&self.samples, |sample| sample.0 <= from);
        let Some(first) = next.checked_sub(1).and_then(|i| self.samples.get(i)) else {
            return false;
        };
        let mut last = first.0;
        for &(stamp, _) in self.samples.range(next..) {
            if stamp - last > MAX_SAMPLE_INTERVAL {
                break;
            }
            last = stamp;
            if last >= to {
                return true;
            }
        }
        to <= last + SAMPLE_HOLD
    }

    /// The turn between two instants of a covered span.
    pub fn turn_between(&self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) -> GyroTurn {
        let mut turn = GyroTurn { turn_rad: 0.0, squared_intervals_s2: 0.0 };
        let mut at = from;
        let next = count_before(&self.samples, |sample| sample.0 <= from);
        let mut held = self.samples.back().map_or(0.0, |sample| sample.1);
        for &(stamp, rate) in self.samples.range(next..) {
            if at >= to {
                return turn;
            }
            let until = stamp.min(to);
            turn.add(rate, until - at);
            held = rate;
            at = until;
        }
        if at < to {
            turn.add(held, to - at);
        }
        turn
    }

    /// As [`Self::covers`] and [`Self::turn_between`] in one pass: the turn between two instants, the first before the
    /// second; `None` if the span has a gap.
    pub fn covered_turn(&self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) -> Option<GyroTurn> {
        let next = count_before(&self.samples, |sample| sample.0 <= from);
        let mut last = self.samples.get(next.checked_sub(1)?)?.0;
        let mut held = self.samples.back()?.1;
        let mut turn = GyroTurn { turn_rad: 0.0, squared_intervals_s2: 0.0 };
        let mut at = from;
        for &(stamp, rate) in self.samples.range(next..) {
            if stamp - last > MAX_SAMPLE_INTERVAL && to > last + SAMPLE_HOLD {
                return None;
            }
            let until = stamp.min(to);
            turn.add(rate, until - at);
            if stamp >= to {
                return Some(turn);
            }
            held = rate;
            at = until;
            last = stamp;
        }
        turn.add(held, to - at);
        (to <= last + SAMPLE_HOLD).then_some(turn)
    }

    /// Discards samples that instants from `horizon` on do not need; the sample before it stays.
    pub fn discard_before(&mut self, horizon: Timestamp<BrickClock>) {
        while self.samples.get(1).is_some_and(|second| second.0 <= horizon) {
            self.samples.pop_front();
            self.is_truncated = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    fn gyro(samples: &[(i64, f64)]) -> GyroTrack {
        let mut gyro = GyroTrack::default();
        for &(stamp, rate) in samples {
            gyro.insert(ms(stamp), rate);
        }
        gyro
    }

    #[test]
    fn the_gyro_is_held_for_a_moment_and_no_longer() {
        let gyro = gyro(&[(0, 9.0), (20, 1.0), (40, 2.0)]);
        assert!(gyro.covers(ms(0), ms(100)) && !gyro.covers(ms(0), ms(101)) && !gyro.covers(ms(-1), ms(40)));
        let turn = gyro.turn_between(ms(10), ms(50));
        assert!((turn.turn_rad - (0.01 + 0.04 + 0.02)).abs() < 1e-12);
        assert!((turn.squared_intervals_s2 - (1e-4 + 4e-4 + 1e-4)).abs() < 1e-12);
    }

    #[test]
    fn the_turn_over_a_covered_interval_is_the_turn_between_its_ends() {
        let gyro = gyro(&[(0, 9.0), (20, 1.0), (40, 2.0), (400, 3.0), (420, 4.0)]);
        for from in -10..500 {
            for to in from + 1..500 {
                let (from, to) = (ms(from), ms(to));
                let expected = gyro.covers(from, to).then(|| gyro.turn_between(from, to));
                assert_eq!(gyro.covered_turn(from, to), expected, "{from:?} {to:?}");
            }
        }
    }

    #[test]
    fn a_hole_between_two_samples_is_not_covered_until_it_is_filled() {
        let mut gyro = gyro(&[(0, 0.0), (100, 0.0), (500, 0.0), (600, 0.0)]);
        assert!(gyro.covers(ms(0), ms(160)) && gyro.covers(ms(500), ms(600)));
        assert!(!gyro.covers(ms(0), ms(161)) && !gyro.covers(ms(50), ms(550)));
        gyro.insert(ms(250), 0.0);
        assert!(gyro.covers(ms(50), ms(550)));
    }
}
