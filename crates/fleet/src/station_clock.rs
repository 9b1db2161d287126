//! The clock of another station, from exchanges of times with it.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// Exchanges that are kept; they are a second apart.
const WINDOW: usize = 16;
/// How fast two clocks of computers may part: 50 millionths each.
const DRIFT_PER_MILLION: i64 = 100;

/// One exchange: this station asked, the other one answered with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockExchange {
    /// On the clock of this station.
    pub sent: Timestamp<HostClock>,
    /// On the clock of this station.
    pub received: Timestamp<HostClock>,
    /// On the clock of the other station, at some instant between the two.
    pub remote: Timestamp<HostClock>,
}

impl ClockExchange {
    fn round_trip(&self) -> TimeDelta {
        self.received - self.sent
    }

    fn offset_at(&self, now: Timestamp<HostClock>) -> ClockOffset {
        let half = TimeDelta::from_nanos(self.round_trip().as_nanos() / 2);
        let age = (now - self.received).as_nanos().max(0);
        let drift = TimeDelta::from_nanos(age / 1_000_000 * DRIFT_PER_MILLION);
        ClockOffset { offset: self.remote - (self.sent + half), uncertainty: half + drift }
    }
}

/// How far ahead another station's clock is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockOffset {
    /// Time of the other station minus time of this one.
    pub offset: TimeDelta,
    /// The true offset is at most this far from it.
    pub uncertainty: TimeDelta,
}

impl ClockOffset {
    /// A time of the other station on the clock of this one.
    pub fn to_own(&self, remote: Timestamp<HostClock>) -> Timestamp<HostClock> {
        remote - self.offset
    }
}

/// The exchanges with one station.
#[derive(Clone, Debug, Default)]
pub struct StationClock {
    exchanges: VecDeque<ClockExchange>,
}

impl StationClock {
    /// Takes an exchange. One whose answer came before its question is ignored.
    pub fn push(&mut self, exchange: ClockExchange) {
        if exchange.round_trip() < TimeDelta::ZERO {
            return;
        }
        if self.exchanges.len() == WINDOW {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(exchange);
    }

    /// By the exchange that bounds the offset best now; `None` before the first one.
    pub fn offset(&self, now: Timestamp<HostClock>) -> Option<ClockOffset> {
        self.exchanges.iter().map(|exchange| exchange.offset_at(now)).min_by_key(|offset| offset.uncertainty)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The other clock is 5 s ahead; the question takes `there_ms`, the answer `back_ms`.
    fn exchange(at_ms: i64, there_ms: i64, back_ms: i64) -> ClockExchange {
        ClockExchange {
            sent: Timestamp::from_millis(at_ms),
            received: Timestamp::from_millis(at_ms + there_ms + back_ms),
            remote: Timestamp::from_millis(at_ms + there_ms + 5_000),
        }
    }

    #[test]
    fn the_quickest_exchange_bounds_the_offset_until_drift_outweighs_it() {
        let mut clock = StationClock::default();
        assert_eq!(clock.offset(Timestamp::ZERO), None);
        clock.push(exchange(0, 1, 1));
        clock.push(exchange(1_000, 40, 2));
        let now = Timestamp::from_millis(1_042);
        let offset = clock.offset(now).unwrap();
        assert_eq!(offset.offset, TimeDelta::from_millis(5_000));
        assert_eq!(offset.uncertainty, TimeDelta::from_micros(1_104), "half of 2 ms, and 1.04 s of drift");
        assert_eq!(offset.to_own(Timestamp::from_millis(6_000)), Timestamp::from_millis(1_000));
        // A slow exchange bounds the offset too: the truth is inside.
        for at_ms in (2_000..20_000).step_by(1_000) {
            clock.push(exchange(at_ms, 30, 4));
        }
        let offset = clock.offset(Timestamp::from_millis(19_034)).unwrap();
        assert_eq!(offset.offset, TimeDelta::from_millis(5_013));
        assert!(offset.uncertainty >= TimeDelta::from_millis(17) && offset.uncertainty < TimeDelta::from_millis(18));
        clock.push(exchange(21_000, -3, 1));
        assert_eq!(clock.exchanges.len(), WINDOW);
        assert_eq!(
            clock.exchanges.back().unwrap().sent,
            Timestamp::from_millis(19_000),
            "an answer before its question"
        );
    }
}
