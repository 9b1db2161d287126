//! Clocks of the brick and of the camera: started at some value, running at a wrong rate, read in whole ticks.
//!
//! The world's own time is a [`Span`] since the simulation began; nobody in the simulated world can read it.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{TimeDelta, Timestamp};

/// How a clock is built.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockSettings {
    /// What it shows at power-up, in microseconds.
    pub(crate) start_micros: u64,
    /// Its rate minus one, in parts per million; positive runs fast.
    pub(crate) skew_ppm: f64,
    /// Its resolution, in microseconds, at least 1.
    pub(crate) tick_micros: u32,
}

/// A clock in the simulated world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SkewedClock {
    settings: ClockSettings,
    powered_at: TimeDelta,
}

impl SkewedClock {
    /// A clock that was powered up at the beginning of the world.
    pub(crate) const fn new(settings: ClockSettings) -> Self {
        Self { settings, powered_at: TimeDelta::ZERO }
    }

    /// Powers the clock up anew at `world`; it counts from zero, whatever its first start value was.
    pub(crate) const fn restart(&mut self, world: TimeDelta) {
        self.settings.start_micros = 0;
        self.powered_at = world;
    }

    /// What the clock would show if its ticks were infinitely fine.
    pub(crate) fn exact<C: Clock>(&self, world: TimeDelta) -> Timestamp<C> {
        let powered = world - self.powered_at;
        let gained = TimeDelta::from_nanos((powered.as_nanos() as f64 * self.settings.skew_ppm * 1e-6).round() as i64);
        // Start values are 48-bit at most (checked when the scenario is read), so the cast keeps them.
        Timestamp::from_micros(self.settings.start_micros as i64) + powered + gained
    }

    /// What the clock shows, floored to its tick, before any register wraps.
    pub(crate) fn reading<C: Clock>(&self, world: TimeDelta) -> Timestamp<C> {
        let tick_nanos = i64::from(self.settings.tick_micros.max(1)) * 1_000;
        let exact = self.exact::<C>(world).as_nanos();
        Timestamp::from_nanos(exact.div_euclid(tick_nanos) * tick_nanos)
    }
}

/// The low 32 bits of a reading in microseconds, as a brick's register holds them.
pub(crate) fn register_micros<C: Clock>(reading: Timestamp<C>) -> u32 {
    reading.as_micros() as u32
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::BrickClock;

    use super::*;

    fn clock(start_micros: u64, skew_ppm: f64, tick_micros: u32) -> SkewedClock {
        SkewedClock::new(ClockSettings { start_micros, skew_ppm, tick_micros })
    }

    #[test]
    fn a_slow_clock_loses_its_parts_per_million() {
        let slow = clock(0, -2_021.0, 1);
        let after_minute = slow.exact::<BrickClock>(TimeDelta::from_millis(60_000));
        assert_eq!(after_minute.as_nanos(), 60_000_000_000 - 121_260_000);
    }

    #[test]
    fn readings_are_whole_ticks_below_the_exact_time() {
        let coarse = clock(250, 0.0, 1_000);
        assert_eq!(coarse.reading::<BrickClock>(TimeDelta::from_millis(3)), Timestamp::from_millis(3));
        assert_eq!(coarse.exact::<BrickClock>(TimeDelta::from_millis(3)), Timestamp::from_micros(3_250));
    }

    #[test]
    fn the_register_wraps_where_the_reading_does_not() {
        let late = clock(u64::from(u32::MAX) - 999, 0.0, 1);
        let before = late.reading::<BrickClock>(TimeDelta::ZERO);
        let after = late.reading::<BrickClock>(TimeDelta::from_millis(2));
        assert_eq!(register_micros(before), u32::MAX - 999);
        assert_eq!(register_micros(after), 1_000);
        assert_eq!(after - before, TimeDelta::from_millis(2));
    }

    #[test]
    fn a_restart_counts_from_zero() {
        let mut restarted = clock(5_000_000, 100.0, 1);
        restarted.restart(TimeDelta::from_millis(10_000));
        assert_eq!(restarted.reading::<BrickClock>(TimeDelta::from_millis(10_007)), Timestamp::from_micros(7_000));
    }
}
