//! A rate limiter.

use std::sync::atomic::{AtomicI64, Ordering};

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// Limits the rate of requests, and allows a burst after a pause.
///
/// Stores the instant at which the next request would be due at an even rate (the generic cell rate algorithm, ITU-T
/// I.371).
#[derive(Debug)]
pub(crate) struct RateLimiter {
    period: TimeDelta,
    /// How much earlier than due a request may come.
    slack: TimeDelta,
    due_nanos: AtomicI64,
}

impl RateLimiter {
    pub(crate) const fn new(per_s: i64, at_once: i64) -> Self {
        let period_nanos = 1_000_000_000 / per_s;
        Self {
            period: TimeDelta::from_nanos(period_nanos),
            slack: TimeDelta::from_nanos(period_nanos * (at_once - 1)),
            due_nanos: AtomicI64::new(0),
        }
    }

    /// Whether one more request may come now; if so, it counts.
    pub(crate) fn admits(&self, now: Timestamp<HostClock>) -> bool {
        let due = |due_nanos| {
            let due = Timestamp::from_nanos(due_nanos).max(now);
            (due - now <= self.slack).then(|| (due + self.period).as_nanos())
        };
        let taken = self.due_nanos.fetch_update(Ordering::Relaxed, Ordering::Relaxed, due);
        taken.is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn so_many_come_at_once_and_then_so_many_a_second() {
        let rate = RateLimiter::new(50, 10);
        let admitted = |from_ms: i64, to_ms: i64| {
            let instants = (from_ms..to_ms).map(Timestamp::from_millis);
            instants.filter(|now| rate.admits(*now)).count()
        };
        let at_once = (0..20).filter(|_| rate.admits(Timestamp::ZERO)).count();
        assert_eq!(at_once, 10);
        assert_eq!(admitted(1, 10_001), 500);
        // A pause earns no more than one burst.
        let later = Timestamp::from_millis(60_000);
        assert_eq!((0..100).filter(|_| rate.admits(later)).count(), 10);
    }
}
