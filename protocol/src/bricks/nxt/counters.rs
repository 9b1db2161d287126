//! The rotation of the wheels, from counters that start again with each program.
//!
//! The rule is that of [`crate::bricks::counters`]. This module adds the limits of an NXT's motors and the time between
//! two readings: each was made between its request and its reply, so the time is at most from the first one's request
//! to the second one's reply.
//!
//! # Sources
//! 170 rpm without load at 9 V (Philo's motor measurements, philohome.com/nxtmotor): 1020 degrees per second, plus a
//! half.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::motion::WheelReadings;
use crate::bricks::counters::{CounterUpdate, MotorCounters, MotorLimits};

const LIMITS: MotorLimits = MotorLimits {
    max_counts_per_s: 1_500.0,
    // What the uncertain instants of two readings are worth.
    margin: 60.0,
};

/// The totals of one brick.
#[derive(Clone, Copy, Debug)]
pub(super) struct WheelTotals {
    counters: MotorCounters,
    last_sent: Option<Timestamp<HostClock>>,
}

impl Default for WheelTotals {
    fn default() -> Self {
        Self { counters: MotorCounters::new(LIMITS), last_sent: None }
    }
}

impl WheelTotals {
    /// The brick was switched off and on.
    pub(super) const fn brick_restarted(&mut self) {
        self.counters.brick_restarted();
    }

    /// Takes a reading of both wheels.
    pub(super) fn push(&mut self, both: &WheelReadings) -> CounterUpdate {
        let last_sent = self.last_sent.replace(both.interval.sent);
        let since = last_sent.map_or(TimeDelta::ZERO, |last_sent| both.interval.answered - last_sent);
        self.counters.push(since, both.counts)
    }
}
