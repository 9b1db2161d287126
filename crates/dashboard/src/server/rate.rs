//! How fast something may come.

use std::sync::atomic::{AtomicI64, Ordering};

use posebridge_telemetry::{HostClock, Span, Stamp};

/// Lets so many through in a second, and after a pause some at once.
///
/// Keeps one instant, from which on the next one would be on time if all came evenly (the generic cell rate algorithm, ITU-T I.371).
#[derive(Debug)]
pub(crate) struct Rate {
    period: Span,
    /// So much before its time one may come.
    slack: Span,
    due_nanos: AtomicI64,
}

impl Rate {
    pub(crate) const fn new(per_s: i64, at_once: i64) -> Self {
        let period_nanos = 1_000_000_000 / per_s;
        Self {
            period: Span::from_nanos(period_nanos),
            slack: Span::from_nanos(period_nanos * (at_once - 1)),
            due_nanos: AtomicI64::new(0),
        }
    }

    /// Whether one more may come now; it then has come.
    pub(crate) fn admits(&self, now: Stamp<HostClock>) -> bool {
        let due = |due_nanos| {
            let due = Stamp::from_nanos(due_nanos).max(now);
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
        let rate = Rate::new(50, 10);
        let admitted = |from_ms: i64, to_ms: i64| {
            let instants = (from_ms..to_ms).map(Stamp::from_millis);
            instants.filter(|now| rate.admits(*now)).count()
        };
        let at_once = (0..20).filter(|_| rate.admits(Stamp::ZERO)).count();
        assert_eq!(at_once, 10);
        assert_eq!(admitted(1, 10_001), 500);
        // A pause is worth no more than what may come at once.
        let later = Stamp::from_millis(60_000);
        assert_eq!((0..100).filter(|_| rate.admits(later)).count(), 10);
    }
}
