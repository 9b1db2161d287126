//! Validates the time in a line, and substitutes it for lines without one (SPEC.md, "Time").
//!
//! ```text
//! -0.5 s  <=  (time2 - time1) mod period  <=  1.01 (arrival2 - arrival1) + held back + 0.5 s
//! held back := max(0, held back + (arrival2 - arrival1) - (time2 - time1)),  less 1 % of the time between
//! ```
//! A time that decreases by less than that is accepted: perhaps the line before was damaged. A time that does not fit is
//! rejected once. If the next line fits the rejected one and not the one before, the board was restarted.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::message::WireStamp;

const PERIOD: i128 = 1 << 32;
/// Largest rate error of a clock: one part in this number: the station's limit for any brick.
const SKEW_PARTS: i64 = 100;
/// Unexplained error of a clock, either way: less than the pipeline's threshold of a restart.
const MAX_CLOCK_ERROR: TimeDelta = TimeDelta::from_millis(500);
/// Longest delay of a line by a link.
const MAX_DELAY: TimeDelta = TimeDelta::from_millis(60_000);
/// Number of lines without a time that are each followed by a time exchange: the pipeline needs three to know a clock.
const EXCHANGES_AT_ONCE: u32 = 4;
const EXCHANGE_PERIOD: TimeDelta = TimeDelta::from_millis(500);

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BoardClock {
    last: Option<LineTime>,
    suspect: Option<LineTime>,
}

#[derive(Clone, Copy, Debug)]
struct LineTime {
    time: WireStamp,
    arrival: Timestamp<HostClock>,
    delay: TimeDelta,
}

impl BoardClock {
    /// Whether the time of a line that arrived at `arrival` is plausible.
    pub(super) fn accept(&mut self, time: WireStamp, arrival: Timestamp<HostClock>) -> bool {
        let Some(last) = self.last else {
            self.last = Some(LineTime::new(time, arrival));
            return true;
        };
        let follows_suspect = || self.suspect.and_then(|line_time| line_time.advance(time, arrival));
        if let Some(line_time) = last.advance(time, arrival).or_else(follows_suspect) {
            self.last = Some(line_time);
            self.suspect = None;
            return true;
        }
        self.suspect = Some(LineTime::new(time, arrival));
        false
    }

    pub(super) fn last_accepted(&self) -> Option<WireStamp> {
        self.last.map(|line_time| line_time.time)
    }
}

impl LineTime {
    const fn new(time: WireStamp, arrival: Timestamp<HostClock>) -> Self {
        Self { time, arrival, delay: TimeDelta::ZERO }
    }

    /// The state after a later line of the same clock; `None` if it cannot be one.
    fn advance(&self, time: WireStamp, arrival: Timestamp<HostClock>) -> Option<Self> {
        let on_host = (arrival - self.arrival).max(TimeDelta::ZERO);
        let skew = TimeDelta::from_nanos(on_host.as_nanos() / SKEW_PARTS);
        let most = on_host + skew + self.delay + MAX_CLOCK_ERROR;
        let (ran, step) = match (self.time, time) {
            (WireStamp::Millis32(from), WireStamp::Millis32(to)) => (to.wrapping_sub(from), 1_000_000),
            (WireStamp::Micros32(from), WireStamp::Micros32(to)) => (to.wrapping_sub(from), 1_000),
            _ => return None,
        };
        // The counter may have wrapped in a silence: of all that it may mean, the latest that can be.
        let most_steps = i128::from(most.as_nanos()) / step;
        let behind = (most_steps - i128::from(ran)).rem_euclid(PERIOD);
        let steps = most_steps - behind;
        let on_board = TimeDelta::from_nanos((steps * step) as i64);
        if on_board < -MAX_CLOCK_ERROR {
            return None;
        }
        let decayed = (self.delay - skew).max(TimeDelta::ZERO);
        let held_back = (decayed + on_host - on_board).max(TimeDelta::ZERO).min(MAX_DELAY);
        Some(Self { time, arrival, delay: held_back })
    }
}

/// Passes the host's clock to the station as that of a board without one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SubstituteClock {
    exchanges: u32,
    last: Option<Timestamp<HostClock>>,
}

impl SubstituteClock {
    /// A line arrived: returns whether a time exchange is due.
    pub(super) fn is_due(&mut self, now: Timestamp<HostClock>) -> bool {
        let is_due = self.exchanges < EXCHANGES_AT_ONCE || self.last.is_none_or(|last| now - last >= EXCHANGE_PERIOD);
        if is_due {
            self.exchanges = self.exchanges.saturating_add(1);
            self.last = Some(now);
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted(lines: &[(i64, u32)]) -> Vec<bool> {
        let mut clock = BoardClock::default();
        let accept = |(arrival_ms, time_ms): &(i64, u32)| {
            clock.accept(WireStamp::Millis32(*time_ms), Timestamp::from_millis(*arrival_ms))
        };
        lines.iter().map(accept).collect()
    }

    #[test]
    fn a_time_with_a_lost_digit_is_refused_once_and_a_restart_is_followed() {
        let lines = [(1_000, 12_345), (1_050, 1_395), (1_100, 12_445), (1_150, 812_495)];
        assert_eq!(accepted(&lines), [true, false, true, false]);
        let lines = [(1_000, 90_000), (3_000, 10), (3_050, 60), (3_100, 110)];
        assert_eq!(accepted(&lines), [true, false, true, true]);
    }

    #[test]
    fn a_stall_its_burst_and_the_wrap_are_accepted() {
        let stall = [(0, 0), (50, 50), (3_000, 100), (3_000, 1_500), (3_001, 2_950), (3_050, 3_050)];
        assert_eq!(accepted(&stall), [true; 6]);
        let wrap = [(0, u32::MAX - 20), (50, 29), (5_000_000, 5_000_029)];
        assert_eq!(accepted(&wrap), [true; 3]);
    }

    #[test]
    fn a_silence_longer_than_the_period_of_microseconds_is_no_restart() {
        let mut clock = BoardClock::default();
        assert!(clock.accept(WireStamp::Micros32(5), Timestamp::ZERO));
        // Twice the period and a second.
        let later = Timestamp::from_micros(2 * (1 << 32) + 1_000_000);
        assert!(clock.accept(WireStamp::Micros32(1_000_005), later));
        assert!(!clock.accept(WireStamp::Micros32(300_000), later + TimeDelta::from_millis(20)));
    }
}
