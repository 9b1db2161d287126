//! The delay of a unit.
//!
//! # Model
//! ```text
//! delay = base + Exp(jitter mean) + sum over the kinds of stall: U(from, to) with probability p
//! arrival = max(departure + delay, arrival of the unit before)        order is kept
//! ```
//! One delay is drawn for each unit, so that a write that the line splits stays together. A lost unit delays the others
//! as if it were not lost, so that a loss changes no other arrival.
//!
//! # Sources
//! docs/impairment.md, section 2; the shape of the jitter is our choice.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::draws::{exponential, millis, uniform};
use super::settings::{DirectionProfile, Stall};
use crate::random::RandomStream;

/// What was drawn for one unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DelayDraw {
    /// The whole delay.
    pub(super) delay: TimeDelta,
    /// The share of stalls in it.
    pub(super) stalled: TimeDelta,
}

/// Draws delays and keeps the order.
#[derive(Clone, Debug)]
pub(super) struct Delays {
    base: TimeDelta,
    jitter_mean: TimeDelta,
    stalls: Vec<Stall>,
    jitter: RandomStream,
    stalling: RandomStream,
    last_arrival: Timestamp<HostClock>,
}

impl Delays {
    pub(super) fn new(profile: &DirectionProfile, jitter: RandomStream, stalling: RandomStream) -> Self {
        Self {
            base: millis(profile.delay.base_ms),
            jitter_mean: millis(profile.delay.jitter_mean_ms),
            stalls: profile.stalls.clone(),
            jitter,
            stalling,
            last_arrival: Timestamp::from_nanos(i64::MIN),
        }
    }

    /// The delay of the next unit.
    pub(super) fn draw(&mut self) -> DelayDraw {
        let mut stalled = TimeDelta::ZERO;
        for stall in &self.stalls {
            // Both draws are always taken, so that a changed probability shifts nothing else.
            let happens = self.stalling.bernoulli(stall.probability);
            let length = uniform(&mut self.stalling, millis(stall.from_ms), millis(stall.to_ms));
            if happens {
                stalled += length;
            }
        }
        let jitter = exponential(&mut self.jitter, self.jitter_mean);
        DelayDraw { delay: self.base + jitter + stalled, stalled }
    }

    /// When something arrives that does not pass what is before it.
    pub(super) fn arrival(&mut self, sent: Timestamp<HostClock>, delay: TimeDelta) -> Timestamp<HostClock> {
        self.last_arrival = self.last_arrival.max(sent + delay);
        self.last_arrival
    }

    /// Nothing is on the way any more.
    pub(super) fn clear(&mut self, now: Timestamp<HostClock>) {
        self.last_arrival = self.last_arrival.min(now);
    }
}
