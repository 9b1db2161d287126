//! The gyro's rate over time.

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use super::TimeSeries;
use super::reading::InsertOutcome;
use crate::saved::Numbers;

/// The last sample is held for this long and no longer: three periods of a 50 Hz gyro.
const SAMPLE_HOLD: TimeDelta = TimeDelta::from_millis(60);
/// Samples further apart leave a gap, because not every sender gives means. Five lost frames in a row at 20 Hz are
/// bridged.
const MAX_SAMPLE_INTERVAL: TimeDelta = TimeDelta::from_millis(300);

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
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GyroTrack {
    samples: TimeSeries<f64>,
}

impl Numbers for GyroTrack {
    fn are_finite(&self) -> bool {
        self.samples.entries.iter().all(|(_, rate)| rate.are_finite())
    }
}

impl GyroTrack {
    pub fn insert(&mut self, stamp: Timestamp<BrickClock>, rate_rad_per_s: f64) -> InsertOutcome {
        match self.samples.vacancy(stamp) {
            Err(refused) => refused,
            Ok((index, before)) => {
                self.samples.entries.insert(index, (stamp, rate_rad_per_s));
                InsertOutcome::Inserted(before)
            }
        }
    }

    pub fn last_at_or_before(&self, stamp: Timestamp<BrickClock>) -> Option<Timestamp<BrickClock>> {
        self.samples.last_at_or_before(stamp).map(|sample| sample.0)
    }

    /// The turn between two instants in their order; `None` if the span has a gap. The last sample is held for
    /// `SAMPLE_HOLD`.
    pub fn covered_turn(&self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>) -> Option<GyroTurn> {
        let samples = &self.samples.entries;
        let next = self.samples.count_until(from);
        let mut last = samples.get(next.checked_sub(1)?)?.0;
        let mut held = samples.back()?.1;
        let mut turn = GyroTurn { turn_rad: 0.0, squared_intervals_s2: 0.0 };
        let mut at = from;
        for &(stamp, rate) in samples.range(next..) {
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
        self.samples.discard_before(horizon);
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

    fn covers(gyro: &GyroTrack, from: i64, to: i64) -> bool {
        gyro.covered_turn(ms(from), ms(to)).is_some()
    }

    #[test]
    fn the_gyro_is_held_for_a_moment_and_no_longer() {
        let gyro = gyro(&[(0, 9.0), (20, 1.0), (40, 2.0)]);
        assert!(covers(&gyro, 0, 100) && !covers(&gyro, 0, 101) && !covers(&gyro, -1, 40));
        let turn = gyro.covered_turn(ms(10), ms(50)).unwrap();
        assert!((turn.turn_rad - (0.01 + 0.04 + 0.02)).abs() < 1e-12);
        assert!((turn.squared_intervals_s2 - (1e-4 + 4e-4 + 1e-4)).abs() < 1e-12);
        // The end lies within an interval, or at its end.
        for (to, expected) in [(30, 0.01 + 0.02), (40, 0.01 + 0.04)] {
            assert!((gyro.covered_turn(ms(10), ms(to)).unwrap().turn_rad - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn a_hole_between_two_samples_is_not_covered_until_it_is_filled() {
        let mut gyro = gyro(&[(0, 0.0), (100, 0.0), (500, 0.0), (600, 0.0)]);
        assert!(covers(&gyro, 0, 160) && covers(&gyro, 500, 600) && covers(&gyro, 550, 550));
        assert!(!covers(&gyro, 0, 161) && !covers(&gyro, 50, 550));
        gyro.insert(ms(250), 0.0);
        assert!(covers(&gyro, 50, 550));
    }
}
