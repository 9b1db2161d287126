//! Tells when the station loop has stood still, though it should turn several times a second.
//!
//! A thread looks at the loop's last turn and speaks while it stands; the loop itself reports how long it stood when it goes on. A computer
//! that was suspended, or a stopped process, stops the thread as well: the loop reports that, the thread does not.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use posebridge_link::HostTimer;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::console::print_line;
use crate::exit::EXIT_CODE_OF_WATCHDOG;

/// How long the loop may stand before it is told.
const STALL_LIMIT: TimeDelta = TimeDelta::from_millis(1_000);
/// The longest wait of a loop that has nothing to do, and the period of the thread.
pub const TURN_PERIOD: TimeDelta = TimeDelta::from_millis(250);

/// What happens beside a message when the loop stands still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnStall {
    #[default]
    Tell,
    /// The process ends with [`EXIT_CODE_OF_WATCHDOG`], for a supervisor that starts it again.
    Exit,
}

/// The loop's side.
#[derive(Debug)]
pub struct Watchdog {
    /// Nanoseconds of the session's clock.
    last_turn: Arc<AtomicI64>,
    stalls: u64,
    /// Its end ends the thread.
    _running: Sender<()>,
}

impl Watchdog {
    pub fn start(timer: HostTimer, on_stall: OnStall) -> Result<Self> {
        let last_turn = Arc::new(AtomicI64::new(timer.now().as_nanos()));
        let (running, is_running) = bounded::<()>(0);
        let seen = Arc::clone(&last_turn);
        let watch = move || {
            let mut monitor = StallMonitor::new(timer.now());
            let period = Duration::from_nanos(TURN_PERIOD.as_nanos().unsigned_abs());
            while is_running.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                let turned = Timestamp::from_nanos(seen.load(Ordering::Relaxed));
                if let Some(stall) = monitor.check(timer.now(), turned) {
                    print_line(&format!(
                        "the station has stood still for {:.1} s: no robot gets an estimate",
                        stall.as_secs_f64()
                    ));
                    if on_stall == OnStall::Exit {
                        crate::stderr_writer::flush();
                        std::process::exit(i32::from(EXIT_CODE_OF_WATCHDOG));
                    }
                }
            }
        };
        std::thread::Builder::new()
            .name("watchdog".to_owned())
            .spawn(watch)
            .context("starting the watchdog's thread")?;
        Ok(Self { last_turn, stalls: 0, _running: running })
    }

    /// Notes a turn of the loop; returns how long it stood, if that was too long.
    pub fn turn(&mut self, now: Timestamp<HostClock>) -> Option<TimeDelta> {
        let before = self.last_turn.swap(now.as_nanos(), Ordering::Relaxed);
        let stood = now - Timestamp::from_nanos(before);
        let is_stall = stood > STALL_LIMIT;
        self.stalls += u64::from(is_stall);
        is_stall.then_some(stood)
    }

    /// How often the loop stood too long.
    pub const fn stalls(&self) -> u64 {
        self.stalls
    }
}

/// Decides when a stall is told: once, and only of a loop that stands while the thread itself runs.
#[derive(Debug)]
struct StallMonitor {
    last_check: Timestamp<HostClock>,
    /// Since when the thread has run without a gap.
    running_since: Timestamp<HostClock>,
    told: Option<Timestamp<HostClock>>,
}

impl StallMonitor {
    const fn new(now: Timestamp<HostClock>) -> Self {
        Self { last_check: now, running_since: now, told: None }
    }

    fn check(&mut self, now: Timestamp<HostClock>, last_turn: Timestamp<HostClock>) -> Option<TimeDelta> {
        if now - self.last_check > STALL_LIMIT {
            self.running_since = now;
        }
        self.last_check = now;
        let stood = now - last_turn.max(self.running_since);
        if stood <= STALL_LIMIT || self.told == Some(last_turn) {
            return None;
        }
        self.told = Some(last_turn);
        Some(now - last_turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn a_loop_that_stands_is_told_once_for_each_stall() {
        let mut monitor = StallMonitor::new(at(0));
        let mut told = Vec::new();
        for step in 0..40 {
            let now = 250 * step;
            // It stands from 2 s to 5 s and from 6 s on.
            let turned = if now < 2_000 {
                now
            } else if now < 5_000 {
                2_000
            } else {
                now.min(6_000)
            };
            told.extend(monitor.check(at(now), at(turned)).map(|stood| (now, stood)));
        }
        let long = TimeDelta::from_millis(1_250);
        assert_eq!(told, [(3_250, long), (7_250, long)]);
    }

    #[test]
    fn a_stopped_process_is_no_stall_of_the_loop_alone() {
        let mut monitor = StallMonitor::new(at(0));
        // Both stood for an hour; the loop turns again after half a second.
        for (now, turned) in [(250, 240), (3_600_250, 240), (3_600_500, 240), (3_600_750, 3_600_700)] {
            assert_eq!(monitor.check(at(now), at(turned)), None, "{now}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_loop_that_goes_on_says_how_long_it_stood() {
        let mut watchdog = Watchdog::start(HostTimer::start(), OnStall::Tell).unwrap();
        assert_eq!(watchdog.turn(at(1_000)), None);
        assert_eq!(watchdog.turn(at(2_001)), Some(TimeDelta::from_millis(1_001)));
        assert_eq!(watchdog.turn(at(2_251)), None);
        assert_eq!(watchdog.stalls(), 1);
    }
}
