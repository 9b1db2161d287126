//! Wheel travel and gyro rate over time, independent of any filter state. The travel of a track depends on the readings
//! that it holds, linear between two, and not on the order in which they came.

mod backlash;
mod gyro;
mod reading;
mod track;

use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::saved;

pub use backlash::BacklashCrossing;
pub use gyro::{GyroTrack, GyroTurn};
pub use reading::{InsertOutcome, MotionReading, MotionSource};
pub(crate) use track::SavedTrack;
pub use track::{MotionTrack, TravelSegment};

/// Speeds are held for this long after the last motion observation, and are stale after that.
pub(crate) const SPEED_HOLD: TimeDelta = TimeDelta::from_millis(500);
/// Random walk of a robot whose motion is not observed, m/s per sqrt(s): a LEGO robot's usual speed.
pub(crate) const UNOBSERVED_M_PER_SQRT_S: f64 = 0.3;
/// The same for its heading, rad per sqrt(s).
pub(crate) const UNOBSERVED_RAD_PER_SQRT_S: f64 = 1.0;

/// Values with their instants, oldest first.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "SavedSeries<T>", bound(deserialize = "T: Deserialize<'de>"))]
pub(crate) struct TimeSeries<T> {
    entries: VecDeque<(Timestamp<BrickClock>, T)>,
    is_truncated: bool,
}

/// A series as it is read, perhaps out of order.
#[derive(Deserialize)]
struct SavedSeries<T> {
    entries: VecDeque<(Timestamp<BrickClock>, T)>,
    is_truncated: bool,
}

impl<T> TryFrom<SavedSeries<T>> for TimeSeries<T> {
    type Error = &'static str;

    fn try_from(saved: SavedSeries<T>) -> Result<Self, Self::Error> {
        let SavedSeries { entries, is_truncated } = saved;
        let is_sound = saved::is_ordered(&entries, |(at, _)| *at, |one, next| one < next);
        is_sound.then_some(Self { entries, is_truncated }).ok_or("instants out of order")
    }
}

impl<T> Default for TimeSeries<T> {
    fn default() -> Self {
        Self { entries: VecDeque::new(), is_truncated: false }
    }
}

impl<T> TimeSeries<T> {
    /// The index for a value of this instant, and the instant before it. Errors: it would be a duplicate or too old.
    fn vacancy(&self, stamp: Timestamp<BrickClock>) -> Result<(usize, Option<Timestamp<BrickClock>>), InsertOutcome> {
        let index = count_before(&self.entries, |(at, _)| *at < stamp);
        let before = index.checked_sub(1).and_then(|i| self.entries.get(i)).map(|(at, _)| *at);
        if self.entries.get(index).is_some_and(|(at, _)| *at == stamp) {
            Err(InsertOutcome::Duplicate)
        } else if before.is_none() && self.is_truncated {
            Err(InsertOutcome::TooOld)
        } else {
            Ok((index, before))
        }
    }

    /// The same instants with other values.
    pub(crate) fn map<U>(&self, change: impl Fn(&T) -> U) -> TimeSeries<U> {
        let entries = self.entries.iter().map(|(at, value)| (*at, change(value)));
        TimeSeries { entries: entries.collect(), is_truncated: self.is_truncated }
    }

    fn count_until(&self, stamp: Timestamp<BrickClock>) -> usize {
        count_before(&self.entries, |(at, _)| *at <= stamp)
    }

    pub(crate) fn last_at_or_before(&self, stamp: Timestamp<BrickClock>) -> Option<&(Timestamp<BrickClock>, T)> {
        self.entries.get(self.count_until(stamp).checked_sub(1)?)
    }

    /// Appends the value of an instant that is not before the last one, or replaces the one of the same instant, and
    /// discards what is older than `length`.
    pub(crate) fn push(&mut self, stamp: Timestamp<BrickClock>, value: T, length: TimeDelta) {
        if self.entries.back().is_some_and(|(last, _)| *last == stamp) {
            self.entries.pop_back();
        }
        self.entries.push_back((stamp, value));
        self.discard_before(stamp - length);
    }

    /// Discards values that instants from `horizon` on do not need; the one before it stays.
    pub(crate) fn discard_before(&mut self, horizon: Timestamp<BrickClock>) {
        while self.entries.get(1).is_some_and(|(second, _)| *second <= horizon) {
            self.entries.pop_front();
            self.is_truncated = true;
        }
    }
}

/// Number of elements at the front for which `belongs` holds, as [`VecDeque::partition_point`], but by a search from
/// the back in doubling steps: recent elements are the likely ones, and in the cache.
pub fn count_before<T>(queue: &VecDeque<T>, belongs: impl Fn(&T) -> bool) -> usize {
    // All from here on do not belong.
    let mut end = queue.len();
    let mut step = 1;
    // All before here belong.
    let mut start = loop {
        let Some(index) = end.checked_sub(step) else {
            break 0;
        };
        if queue.get(index).is_some_and(&belongs) {
            break index + 1;
        }
        end = index;
        step *= 2;
    };
    while start < end {
        let middle = usize::midpoint(start, end);
        if queue.get(middle).is_some_and(&belongs) {
            start = middle + 1;
        } else {
            end = middle;
        }
    }
    start
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_reaches_back_by_its_length_and_no_further() {
        let mut series = TimeSeries::default();
        let length = TimeDelta::from_millis(250);
        for k in 0..10_i64 {
            series.push(Timestamp::from_millis(100 * k), k, length);
        }
        series.push(Timestamp::from_millis(900), 90, length);
        let at = |millis| series.last_at_or_before(Timestamp::from_millis(millis)).map(|(_, value)| *value);
        assert_eq!(
            [5_000, 899, 650, 599].map(at),
            [Some(90), Some(8), Some(6), None],
            "the third is kept to start from"
        );
    }

    #[test]
    fn it_counts_what_halving_counts() {
        for length in 0..40 {
            let mut queue: VecDeque<i32> = (0..length).collect();
            // Wrapped around the end of its storage.
            for next in length..length + 7 {
                queue.pop_front();
                queue.push_back(next);
            }
            for limit in -1..=length + 8 {
                let expected = queue.partition_point(|element| *element < limit);
                assert_eq!(count_before(&queue, |element| *element < limit), expected);
            }
        }
    }
}
