//! The session clock: the one place in the house that reads a clock.
//!
//! Everybody else is handed the stamps that come from here. It follows the runtime's clock, so a test that pauses the
//! runtime pauses the session with it. It does not know brick or camera time.

use std::pin::Pin;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use posebridge_telemetry::{HostClock, Span, Stamp};
use tokio::time::{Instant, Sleep};

/// A handle to the host's clock, zero at the start of the session. Copies tell the same time.
#[derive(Clone, Copy, Debug)]
pub struct HostTimer {
    start: Instant,
    utc_start_micros: u64,
}

impl HostTimer {
    /// Starts the session: `now()` counts from here.
    #[must_use]
    pub fn start() -> Self {
        Self { start: read_clock(), utc_start_micros: read_utc_micros() }
    }

    /// The time since the start of the session; never falls.
    #[must_use]
    pub fn now(&self) -> Stamp<HostClock> {
        let elapsed = read_clock().saturating_duration_since(self.start);
        Stamp::from_nanos(i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Returns when `now()` has reached `stamp`, at once if it has. The runtime's timers are about a millisecond wide
    /// and wake late, never early.
    pub async fn sleep_until(self, stamp: Stamp<HostClock>) {
        while self.now() < stamp {
            tokio::time::sleep_until(self.instant(stamp)).await;
        }
    }

    /// When the session started, in microseconds since 1970 UTC; for file names and headers only. 0 if the computer's
    /// date lies before 1970.
    #[must_use]
    pub const fn utc_start(&self) -> u64 {
        self.utc_start_micros
    }

    /// How far the computer's date runs ahead of this clock since the start of the session: it leaps when somebody sets the date.
    #[must_use]
    pub fn calendar_ahead(&self) -> Span {
        let elapsed = self.now() - Stamp::ZERO;
        let since_start = i128::from(read_utc_micros()) - i128::from(self.utc_start_micros);
        let by_date = i64::try_from(since_start).unwrap_or(i64::MAX);
        Span::from_micros(by_date) - elapsed
    }

    /// The runtime's name for `stamp`; the start of the session for stamps before it.
    pub(crate) fn instant(self, stamp: Stamp<HostClock>) -> Instant {
        let nanos = u64::try_from(stamp.as_nanos()).unwrap_or(0);
        // A stamp beyond what the runtime can express sleeps for a day and is then looked at again.
        self.start
            .checked_add(Duration::from_nanos(nanos))
            .unwrap_or_else(|| read_clock() + Duration::from_secs(86_400))
    }
}

/// Wakes one task at deadlines that mostly stay where they are while inputs come.
///
/// To set a timer of the runtime and to take it back costs more than to handle a small input. So an alarm that is set for an earlier
/// instant than the deadline stays set, rings once in vain, and is set anew then.
#[derive(Debug)]
pub struct Alarm {
    timer: HostTimer,
    sleep: Pin<Box<Sleep>>,
    set_for: Option<Stamp<HostClock>>,
}

impl Alarm {
    /// An alarm that is not set.
    #[must_use]
    pub fn new(timer: HostTimer) -> Self {
        let sleep = Box::pin(tokio::time::sleep_until(timer.instant(Stamp::ZERO)));
        Self { timer, sleep, set_for: None }
    }

    /// Returns once the deadline is reached, never without one. Cancel safe.
    pub async fn reached(&mut self, deadline: Option<Stamp<HostClock>>) {
        let Some(deadline) = deadline else {
            return std::future::pending().await;
        };
        while self.timer.now() < deadline {
            if self.set_for.is_none_or(|set_for| set_for > deadline) {
                self.sleep.as_mut().reset(self.timer.instant(deadline));
                self.set_for = Some(deadline);
            }
            self.sleep.as_mut().await;
            self.set_for = None;
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "this module is the session clock that everybody else is handed")]
fn read_clock() -> Instant {
    Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "this module is the session clock that everybody else is handed")]
fn read_utc_micros() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_1970.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_date_that_stays_behind_the_session_is_seen_to() {
        let timer = HostTimer::start();
        let before = timer.calendar_ahead();
        assert!(before < Span::from_millis(60_000) && before > Span::from_millis(-60_000));
        // The session's clock goes on by an hour, the date does not: as if it had been set back.
        tokio::time::advance(Duration::from_secs(3_600)).await;
        let leapt = timer.calendar_ahead() - before;
        assert!((leapt.as_secs_f64() + 3_600.0).abs() < 60.0, "{leapt:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_sleeper_wakes_at_its_stamp_or_later() {
        let timer = HostTimer::start();
        for nanos in [1, 999_999, 1_000_001, 20_000_000] {
            let wanted = timer.now() + Span::from_nanos(nanos);
            timer.sleep_until(wanted).await;
            let late = timer.now() - wanted;
            assert!(late >= Span::ZERO, "woke {late:?} too early");
            assert!(late <= Span::from_millis(2), "woke {late:?} late");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_alarm_rings_at_its_deadline_whatever_it_was_set_for_before() {
        let timer = HostTimer::start();
        let mut alarm = Alarm::new(timer);
        for (dropped_ms, wanted_ms) in [(500, 100), (200, 400), (900, 900), (1_000, 950)] {
            let dropped = Stamp::from_millis(dropped_ms);
            tokio::select! {
                biased;
                () = alarm.reached(Some(dropped)) => unreachable!("it is not time yet"),
                () = std::future::ready(()) => {}
            }
            alarm.reached(Some(Stamp::from_millis(wanted_ms))).await;
            let late = timer.now() - Stamp::from_millis(wanted_ms);
            assert!(late >= Span::ZERO && late <= Span::from_millis(2), "{late:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_stamp_in_the_past_does_not_sleep() {
        let timer = HostTimer::start();
        timer.sleep_until(Stamp::from_millis(-5)).await;
        assert_eq!(timer.now(), Stamp::ZERO);
    }

    #[tokio::test(start_paused = true)]
    async fn copies_tell_the_same_time() {
        let timer = HostTimer::start();
        let copy = timer;
        tokio::time::advance(Duration::from_millis(1_500)).await;
        assert_eq!(timer.now(), Stamp::from_millis(1_500));
        assert_eq!(copy.now(), timer.now());
    }

    #[test]
    fn the_real_clock_does_not_fall() {
        let timer = HostTimer::start();
        let stamps: Vec<_> = (0..1_000).map(|_| timer.now()).collect();
        assert!(stamps.is_sorted());
    }

    #[test]
    fn the_session_starts_in_this_century() {
        let micros_per_year = 31_556_952_000_000;
        let years_since_1970 = HostTimer::start().utc_start() / micros_per_year;
        assert!((50..130).contains(&years_since_1970));
    }
}
