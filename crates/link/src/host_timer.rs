//! The session clock: the only code of posebridge that reads a clock.
//!
//! All host timestamps come from here. It follows the runtime's clock, so a test that pauses the runtime pauses the
//! session too.

use std::pin::Pin;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use rustix::time::{ClockId, clock_gettime};
use tokio::time::{Instant, Sleep};

/// The host's clock, zero at the start of the session. Copies share it.
#[derive(Clone, Copy, Debug)]
pub struct HostTimer {
    start: Instant,
    utc_start_micros: u64,
}

impl HostTimer {
    /// Starts the session: `now()` is zero here.
    pub fn start() -> Self {
        Self { start: read_clock(), utc_start_micros: read_utc_micros() }
    }

    /// Never decreases.
    pub fn now(&self) -> Timestamp<HostClock> {
        let elapsed = read_clock().saturating_duration_since(self.start);
        Timestamp::from_nanos(i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))
    }

    /// As [`Self::now`], but also counts while the computer sleeps, where the system tells (Linux).
    pub fn now_with_sleep(&self) -> Timestamp<HostClock> {
        self.now() + read_sleep()
    }

    /// Returns when `now()` has reached `stamp`, at once if it has. The runtime's timers have a resolution of about a
    /// millisecond and wake late, never early.
    pub async fn sleep_until(self, stamp: Timestamp<HostClock>) {
        while self.now() < stamp {
            tokio::time::sleep_until(self.instant(stamp)).await;
        }
    }

    /// When the session started, in microseconds since 1970 UTC; for file names and headers only. 0 if the computer's
    /// date lies before 1970.
    pub const fn utc_start(&self) -> u64 {
        self.utc_start_micros
    }

    /// How far the computer's date has run ahead of this clock since the start of the session; jumps when the date is set.
    pub fn utc_drift(&self) -> TimeDelta {
        let elapsed = self.now() - Timestamp::ZERO;
        let since_start = i128::from(read_utc_micros()) - i128::from(self.utc_start_micros);
        let by_date = i64::try_from(since_start).unwrap_or(i64::MAX);
        TimeDelta::from_micros(by_date) - elapsed
    }

    /// The instant of a stamp of the system's monotonic clock, by which drivers of cameras stamp pictures.
    pub fn at_monotonic(&self, stamp: Duration) -> Timestamp<HostClock> {
        let ago = read_monotonic().saturating_sub(stamp);
        self.now() - TimeDelta::from_nanos(i64::try_from(ago.as_nanos()).unwrap_or(i64::MAX))
    }

    /// The runtime's instant of `stamp`; the start of the session for earlier ones.
    pub(crate) fn instant(self, stamp: Timestamp<HostClock>) -> Instant {
        let nanos = u64::try_from(stamp.as_nanos()).unwrap_or(0);
        // A stamp beyond what the runtime can express sleeps for a day and is then looked at again.
        self.start.checked_add(Duration::from_nanos(nanos)).unwrap_or_else(|| read_clock() + Duration::from_hours(24))
    }
}

/// Wakes one task at a deadline that seldom changes while inputs come.
///
/// Setting and cancelling a timer of the runtime costs more than handling a small input. So a timer that is set for an earlier instant
/// than the deadline is kept, wakes the task once too early, and is set again then.
#[derive(Debug)]
pub struct DeadlineTimer {
    timer: HostTimer,
    sleep: Pin<Box<Sleep>>,
    armed_until: Option<Timestamp<HostClock>>,
}

impl DeadlineTimer {
    pub fn new(timer: HostTimer) -> Self {
        let sleep = Box::pin(tokio::time::sleep_until(timer.instant(Timestamp::ZERO)));
        Self { timer, sleep, armed_until: None }
    }

    /// Returns once the deadline is reached, never without one. Cancel safe.
    pub async fn wait_until(&mut self, deadline: Option<Timestamp<HostClock>>) {
        let Some(deadline) = deadline else {
            return std::future::pending().await;
        };
        while self.timer.now() < deadline {
            if self.armed_until.is_none_or(|set_for| set_for > deadline) {
                self.sleep.as_mut().reset(self.timer.instant(deadline));
                self.armed_until = Some(deadline);
            }
            self.sleep.as_mut().await;
            self.armed_until = None;
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

/// For how long the computer has slept since it was started; zero where the system does not tell.
fn read_sleep() -> TimeDelta {
    #[cfg(target_os = "linux")]
    let awake_and_asleep = Duration::try_from(clock_gettime(ClockId::Boottime)).unwrap_or_default();
    #[cfg(not(target_os = "linux"))]
    let awake_and_asleep = read_monotonic();
    let asleep = awake_and_asleep.saturating_sub(read_monotonic());
    TimeDelta::from_nanos(i64::try_from(asleep.as_nanos()).unwrap_or(0))
}

fn read_monotonic() -> Duration {
    Duration::try_from(clock_gettime(ClockId::Monotonic)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_date_that_falls_behind_the_session_is_detected() {
        let timer = HostTimer::start();
        let before = timer.utc_drift();
        assert!(before < TimeDelta::from_millis(60_000) && before > TimeDelta::from_millis(-60_000));
        // The session's clock goes on by an hour, the date does not: as if it had been set back.
        tokio::time::advance(Duration::from_hours(1)).await;
        let leapt = timer.utc_drift() - before;
        assert!((leapt.as_secs_f64() + 3_600.0).abs() < 60.0, "{leapt:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_sleeper_wakes_at_its_stamp_or_later() {
        let timer = HostTimer::start();
        for nanos in [1, 999_999, 1_000_001, 20_000_000] {
            let deadline = timer.now() + TimeDelta::from_nanos(nanos);
            timer.sleep_until(deadline).await;
            let late = timer.now() - deadline;
            assert!(late >= TimeDelta::ZERO, "woke {late:?} too early");
            assert!(late <= TimeDelta::from_millis(2), "woke {late:?} late");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_alarm_fires_at_its_deadline_regardless_of_earlier_ones() {
        let timer = HostTimer::start();
        let mut alarm = DeadlineTimer::new(timer);
        for (dropped_ms, deadline_ms) in [(500, 100), (200, 400), (900, 900), (1_000, 950)] {
            let dropped = Timestamp::from_millis(dropped_ms);
            tokio::select! {
                biased;
                () = alarm.wait_until(Some(dropped)) => unreachable!("it is not time yet"),
                () = std::future::ready(()) => {}
            }
            alarm.wait_until(Some(Timestamp::from_millis(deadline_ms))).await;
            let late = timer.now() - Timestamp::from_millis(deadline_ms);
            assert!(late >= TimeDelta::ZERO && late <= TimeDelta::from_millis(2), "{late:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_stamp_in_the_past_does_not_sleep() {
        let timer = HostTimer::start();
        timer.sleep_until(Timestamp::from_millis(-5)).await;
        assert_eq!(timer.now(), Timestamp::ZERO);
    }

    #[test]
    fn the_session_starts_in_this_century() {
        let micros_per_year = 31_556_952_000_000;
        let years_since_1970 = HostTimer::start().utc_start() / micros_per_year;
        assert!((50..130).contains(&years_since_1970));
    }
}
