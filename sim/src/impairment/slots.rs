//! Slots: bytes are delivered at the next instant of a grid.
//!
//! # Model
//! ```text
//! t' = phase + ceil((t - phase) / period) period        phase ~ U(0, period), drawn once
//! ```
//! A radio's connection interval and a USB adapter's latency timer work like this.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::draws::{millis, uniform};
use crate::random::RandomStream;

/// A grid of instants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slots {
    period: TimeDelta,
    phase: TimeDelta,
}

impl Slots {
    pub(super) fn new(period_ms: f64, mut stream: RandomStream) -> Self {
        let period = millis(period_ms);
        Self { period, phase: uniform(&mut stream, TimeDelta::ZERO, period) }
    }

    /// The next slot at or after `at`.
    pub(super) fn next(self, at: Timestamp<HostClock>) -> Timestamp<HostClock> {
        let period = self.period.as_nanos().max(1);
        let past = (at - self.phase).as_nanos().rem_euclid(period);
        if past == 0 { at } else { at + TimeDelta::from_nanos(period - past) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arrival_waits_for_its_slot_and_one_on_a_slot_does_not() {
        let slots = Slots::new(10.0, RandomStream::new(3, "slots"));
        let first = slots.next(Timestamp::ZERO);
        assert!(first >= Timestamp::ZERO && first < Timestamp::from_millis(10));
        assert_eq!(slots.next(first), first);
        let later = first + TimeDelta::from_nanos(1);
        assert_eq!(slots.next(later), first + TimeDelta::from_millis(10));
    }
}
