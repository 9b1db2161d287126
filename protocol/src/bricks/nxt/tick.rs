//! The last reading of the brick's clock.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// A tick that lies further back than this was read before the brick was switched off: readings come in order, and the clocks of host and
/// brick differ by far less over any silence that is not a restart.
const RESTART_BACK_MILLIS: i64 = 1_000;
/// Milliseconds after which the tick begins anew.
const PERIOD_MILLIS: i64 = 1 << 32;
const PERIOD_MICROS: i64 = 1 << 32;

/// What a reading of the tick says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TickAdvance {
    /// The clock ran on, or is known for the first time.
    Continuous,
    /// The brick was switched off and on.
    Restarted,
}

/// The state of one brick's clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TickClock {
    last: Option<(u32, Timestamp<HostClock>)>,
}

impl TickClock {
    /// Takes a reading of the instant `at`.
    pub(super) fn push(&mut self, millis: u32, at: Timestamp<HostClock>) -> TickAdvance {
        let Some((last, then)) = self.last.replace((millis, at)) else {
            return TickAdvance::Continuous;
        };
        let elapsed = (at - then).max(TimeDelta::ZERO).as_nanos() / 1_000_000;
        let expected = i64::from(last) + elapsed;
        let ahead = wrapped(i64::from(millis) - expected, PERIOD_MILLIS);
        // A hundredth of the time that passed is five times what the worst resonator explains.
        if ahead < -(RESTART_BACK_MILLIS + elapsed / 100) { TickAdvance::Restarted } else { TickAdvance::Continuous }
    }

    /// The tick whose microseconds show this in 32 bits, next to the one that was read last.
    pub(super) fn millis_of(&self, micros: u32) -> u32 {
        let Some((last, _)) = self.last else {
            return micros / 1_000;
        };
        let last_micros = i64::from(last) * 1_000;
        let ahead = wrapped(i64::from(micros) - last_micros, PERIOD_MICROS);
        ((last_micros + ahead).div_euclid(1_000) & (PERIOD_MILLIS - 1)) as u32
    }
}

/// The value next to zero that is equal modulo the period.
const fn wrapped(value: i64, period: i64) -> i64 {
    (value + period / 2).rem_euclid(period) - period / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_that_falls_is_a_restart_and_one_that_wraps_is_not() {
        let mut clock = TickClock::default();
        assert_eq!(clock.push(u32::MAX - 10, Timestamp::ZERO), TickAdvance::Continuous);
        assert_eq!(clock.push(40, Timestamp::from_millis(50)), TickAdvance::Continuous);
        assert_eq!(clock.push(20_040, Timestamp::from_millis(20_050)), TickAdvance::Continuous);
        assert_eq!(clock.push(900, Timestamp::from_millis(23_050)), TickAdvance::Restarted);
        assert_eq!(clock.push(950, Timestamp::from_millis(23_100)), TickAdvance::Continuous);
    }

    #[test]
    fn microseconds_of_32_bits_become_the_tick_that_they_mean() {
        let mut clock = TickClock::default();
        assert_eq!(clock.millis_of(5_999), 5);
        // 10 000 000 ms are 10^10 us, 1 410 065 408 in 32 bits.
        clock.push(10_000_000, Timestamp::ZERO);
        assert_eq!(clock.millis_of(1_410_065_408 + 70_000), 10_000_070);
        assert_eq!(clock.millis_of(1_410_065_408 - 1), 9_999_999);
        clock.push(5, Timestamp::ZERO);
        assert_eq!(clock.millis_of(u32::MAX), u32::MAX);
    }
}
