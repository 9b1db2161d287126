//! Totals of a sensor over time: a ring of samples, thinned by motion, so that a robot at rest fills no memory and a rare fix
//! finds the motion since the one before it.

use std::collections::VecDeque;

use nalgebra::SVector;
use posebridge_telemetry::{BrickClock, Timestamp};
use serde::{Deserialize, Serialize};

use crate::saved::{Numbers, RestoreError, is_ordered};

/// Samples in a log. With one for each 0.15 rad of a wheel this is 2 m of a small robot.
const CAPACITY: usize = 512;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LogSample<const N: usize> {
    pub(super) time: Timestamp<BrickClock>,
    pub(super) totals: [f64; N],
}

/// A log without its spacing: the instants, and the totals of each.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SavedLog<const N: usize>(Vec<(Timestamp<BrickClock>, SVector<f64, N>)>);

/// Totals that grow with motion; linear between two samples.
#[derive(Clone, Debug)]
pub(super) struct MotionLog<const N: usize> {
    samples: VecDeque<LogSample<N>>,
    /// A smaller change of every total needs no sample of its own.
    spacing: f64,
}

impl<const N: usize> MotionLog<N> {
    pub(super) fn new(spacing: f64) -> Self {
        Self { samples: VecDeque::with_capacity(CAPACITY), spacing }
    }

    pub(super) fn save(&self) -> SavedLog<N> {
        SavedLog(self.samples.iter().map(|sample| (sample.time, sample.totals.into())).collect())
    }

    /// This log with the samples of another one.
    pub(super) fn with_saved(mut self, saved: &SavedLog<N>) -> Result<Self, RestoreError> {
        let samples = saved.0.iter().map(|(time, totals)| LogSample { time: *time, totals: (*totals).into() });
        self.samples.clear();
        self.samples.extend(samples.take(CAPACITY));
        let is_sound = saved.0.len() <= CAPACITY
            && is_ordered(&self.samples, |sample| sample.time, |one, next| one < next)
            && self.samples.iter().all(|sample| sample.totals.are_finite());
        is_sound
            .then_some(())
            .ok_or(RestoreError::Implausible("its record of the wheels or the gyro is too long, or out of order"))?;
        Ok(self)
    }

    pub(super) fn clear(&mut self) {
        self.samples.clear();
    }

    pub(super) fn first(&self) -> Option<&LogSample<N>> {
        self.samples.front()
    }

    pub(super) fn last(&self) -> Option<&LogSample<N>> {
        self.samples.back()
    }

    /// `time` is later than that of the last sample.
    pub(super) fn push(&mut self, time: Timestamp<BrickClock>, totals: [f64; N]) {
        let is_near = |earlier: &LogSample<N>| {
            earlier.totals.iter().zip(&totals).all(|(before, now)| (now - before).abs() < self.spacing)
        };
        if self.samples.len() >= 2 && self.samples.iter().rev().nth(1).is_some_and(is_near) {
            self.samples.pop_back();
        } else if self.samples.len() == CAPACITY {
            self.samples.pop_front();
        }
        self.samples.push_back(LogSample { time, totals });
    }

    /// `None` outside of what the log holds.
    pub(super) fn at(&self, time: Timestamp<BrickClock>) -> Option<[f64; N]> {
        let after = self.index_after(time);
        let before = self.samples.get(after.checked_sub(1)?)?;
        let Some(next) = self.samples.get(after) else {
            return (before.time == time).then_some(before.totals);
        };
        let share = (time - before.time).as_secs_f64() / (next.time - before.time).as_secs_f64();
        Some(std::array::from_fn(|i| before.totals[i] + share * (next.totals[i] - before.totals[i])))
    }

    /// The totals at the samples after `from` and before `to`.
    pub(super) fn between(
        &self,
        from: Timestamp<BrickClock>,
        to: Timestamp<BrickClock>,
    ) -> impl Iterator<Item = [f64; N]> + Clone {
        let samples = self.samples.range(self.index_after(from)..);
        samples.take_while(move |sample| sample.time < to).map(|sample| sample.totals)
    }

    /// Index of the first sample after `time`; recent instants are the likely ones.
    fn index_after(&self, time: Timestamp<BrickClock>) -> usize {
        crate::motion::count_before(&self.samples, |sample| sample.time <= time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn a_rest_takes_two_samples_and_motion_is_linear_between_samples() {
        let mut log = MotionLog::<1>::new(0.1);
        for n in 0..1_000 {
            log.push(ms(10 * n), [0.0]);
        }
        assert_eq!(log.samples.len(), 2);
        log.push(ms(10_000), [1.0]);
        log.push(ms(10_010), [2.0]);
        assert_eq!(log.at(ms(10_005)), Some([1.5]));
        assert_eq!(log.at(ms(5_000)), Some([0.0]));
        assert_eq!(log.at(ms(10_011)), None);
        assert_eq!(log.between(ms(9_995), ms(10_010)).collect::<Vec<_>>(), [[1.0]]);
    }

    #[test]
    fn a_full_log_forgets_the_oldest_and_grows_no_more() {
        let mut log = MotionLog::<1>::new(0.1);
        let capacity = log.samples.capacity();
        for n in 0..2_000_i64 {
            log.push(ms(n), [n as f64]);
        }
        assert_eq!((log.samples.len(), log.samples.capacity()), (CAPACITY, capacity));
        assert_eq!(log.at(ms(1_000)), None);
        assert_eq!(log.at(ms(1_900)), Some([1_900.0]));
    }
}
