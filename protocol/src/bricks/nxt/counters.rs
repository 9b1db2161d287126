//! What the wheels have turned, by counters that begin anew with each program.
//!
//! The rule is that of [`crate::bricks::counters`]. Here stand what an NXT's motors can do, and how long it is between two readings: each was made
//! somewhere between its question and its answer, so at most from the first one's question to the second one's answer.
//!
//! # Sources
//! 170 rpm without load at 9 V (Philo's motor measurements, philohome.com/nxtmotor): 1020 degrees per second, and a half on top.

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::motion::BothWheels;
use crate::bricks::counters::{Counted, Counters, Limits};

const LIMITS: Limits = Limits {
    fastest_per_s: 1_500.0,
    // What the uncertain instants of two readings are worth.
    margin: 60.0,
};

/// The totals of one brick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Totals {
    counters: Counters,
    last_sent: Option<Stamp<HostClock>>,
}

impl Default for Totals {
    fn default() -> Self {
        Self { counters: Counters::new(LIMITS), last_sent: None }
    }
}

impl Totals {
    /// The brick was switched off and on.
    pub(super) const fn brick_restarted(&mut self) {
        self.counters.brick_restarted();
    }

    /// Takes a reading of both wheels.
    pub(super) fn take(&mut self, both: &BothWheels) -> Counted {
        let last_sent = self.last_sent.replace(both.sent);
        let since = last_sent.map_or(Span::ZERO, |last_sent| both.answered - last_sent);
        self.counters.take(since, both.counts)
    }
}
