//! Slots: what arrives is handed over at the next instant of a grid.
//!
//! # Model
//! ```text
//! t' = phase + ceil((t - phase) / period) period        phase ~ U(0, period), drawn once
//! ```
//! So work a radio's connection interval and a USB adapter's latency timer.

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::draws::{millis, uniform};
use crate::random::Stream;

/// A grid of instants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slots {
    period: Span,
    phase: Span,
}

impl Slots {
    pub(super) fn new(period_ms: f64, mut stream: Stream) -> Self {
        let period = millis(period_ms);
        Self { period, phase: uniform(&mut stream, Span::ZERO, period) }
    }

    /// The next slot at or after `at`.
    pub(super) fn next(self, at: Stamp<HostClock>) -> Stamp<HostClock> {
        let period = self.period.as_nanos().max(1);
        let past = (at - self.phase).as_nanos().rem_euclid(period);
        if past == 0 { at } else { at + Span::from_nanos(period - past) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arrival_waits_for_its_slot_and_one_on_a_slot_does_not() {
        let slots = Slots::new(10.0, Stream::new(3, "slots"));
        let first = slots.next(Stamp::ZERO);
        assert!(first >= Stamp::ZERO && first < Stamp::from_millis(10));
        assert_eq!(slots.next(first), first);
        let later = first + Span::from_nanos(1);
        assert_eq!(slots.next(later), first + Span::from_millis(10));
    }
}
