//! How long a unit is on the way.
//!
//! # Model
//! ```text
//! delay = base + Exp(jitter mean) + sum over the kinds of stall: U(from, to) with probability p
//! arrival = max(departure + delay, arrival of the unit before)        order is kept
//! ```
//! One delay is drawn for each unit, so that a write that the line cuts into pieces stays together. A unit that is lost holds
//! up the others as if it were not, so that a loss changes nobody else's arrival.
//!
//! # Sources
//! docs/impairment.md, section 2; the shape of the jitter is our choice.

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::draws::{exponential, millis, uniform};
use super::settings::{DirectionProfile, Stall};
use crate::random::Stream;

/// What was drawn for one unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Drawn {
    /// The whole delay.
    pub(super) delay: Span,
    /// The share of stalls in it.
    pub(super) stalled: Span,
}

/// Draws delays and keeps the order.
#[derive(Clone, Debug)]
pub(super) struct Delays {
    base: Span,
    jitter_mean: Span,
    stalls: Vec<Stall>,
    jitter: Stream,
    stalling: Stream,
    last_arrival: Stamp<HostClock>,
}

impl Delays {
    pub(super) fn new(profile: &DirectionProfile, jitter: Stream, stalling: Stream) -> Self {
        Self {
            base: millis(profile.delay.base_ms),
            jitter_mean: millis(profile.delay.jitter_mean_ms),
            stalls: profile.stalls.clone(),
            jitter,
            stalling,
            last_arrival: Stamp::from_nanos(i64::MIN),
        }
    }

    /// The delay of the next unit.
    pub(super) fn draw(&mut self) -> Drawn {
        let mut stalled = Span::ZERO;
        for stall in &self.stalls {
            // Both draws are always taken, so that a changed probability shifts nothing else.
            let happens = self.stalling.happens(stall.probability);
            let length = uniform(&mut self.stalling, millis(stall.from_ms), millis(stall.to_ms));
            if happens {
                stalled += length;
            }
        }
        let jitter = exponential(&mut self.jitter, self.jitter_mean);
        Drawn { delay: self.base + jitter + stalled, stalled }
    }

    /// When something arrives that does not pass what is before it.
    pub(super) fn arrival(&mut self, sent: Stamp<HostClock>, delay: Span) -> Stamp<HostClock> {
        self.last_arrival = self.last_arrival.max(sent + delay);
        self.last_arrival
    }

    /// Nothing is on the way any more.
    pub(super) fn clear(&mut self, now: Stamp<HostClock>) {
        self.last_arrival = self.last_arrival.min(now);
    }
}
