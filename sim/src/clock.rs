//! The time step of the simulation, and the clocks of brick and camera: each with a start value, a rate error and a resolution.
//!
//! World time is a [`TimeDelta`] since the simulation began; no part of the simulated robot can read it.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{TimeDelta, Timestamp};

/// Simulation time of one `Simulation::step`: fine enough for motors and for the 1 ms encoders of the NXT.
pub const STEP: TimeDelta = TimeDelta::from_millis(1);
pub(crate) const STEP_S: f64 = STEP.as_nanos() as f64 / 1e9;

#[derive(Clone, Copy, Debug)]
pub(crate) struct SkewedClock {
    start_micros: u64,
    skew_ppm: f64,
    tick_micros: u32,
    powered_at: TimeDelta,
}

impl SkewedClock {
    /// A clock that is powered up at world time 0.
    ///
    /// It starts at `start_micros`, runs fast by `skew_ppm` parts per million, and resolves `tick_micros`, at least 1.
    pub(crate) const fn new(start_micros: u64, skew_ppm: f64, tick_micros: u32) -> Self {
        Self { start_micros, skew_ppm, tick_micros, powered_at: TimeDelta::ZERO }
    }

    /// Power cycle at `world`: counts from zero, whatever its first start value was.
    pub(crate) const fn restart(&mut self, world: TimeDelta) {
        self.start_micros = 0;
        self.powered_at = world;
    }

    pub(crate) fn exact<C: Clock>(&self, world: TimeDelta) -> Timestamp<C> {
        let powered = world - self.powered_at;
        let gained = TimeDelta::from_nanos((powered.as_nanos() as f64 * self.skew_ppm * 1e-6).round() as i64);
        // Start values are 48-bit at most (checked when the scenario is read), so the cast keeps them.
        Timestamp::from_micros(self.start_micros as i64) + powered + gained
    }

    /// Rounded down to a tick, before any register wraps.
    pub(crate) fn reading<C: Clock>(&self, world: TimeDelta) -> Timestamp<C> {
        let tick_nanos = i64::from(self.tick_micros.max(1)) * 1_000;
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

    #[test]
    fn a_clock_runs_at_its_rate_in_whole_ticks_and_its_register_wraps() {
        let at = TimeDelta::from_millis;
        let slow = SkewedClock::new(0, -2_021.0, 1);
        assert_eq!(slow.exact::<BrickClock>(at(60_000)).as_nanos(), 60_000_000_000 - 121_260_000);

        let coarse = SkewedClock::new(250, 0.0, 1_000);
        assert_eq!(coarse.reading::<BrickClock>(at(3)), Timestamp::from_millis(3));
        assert_eq!(coarse.exact::<BrickClock>(at(3)), Timestamp::from_micros(3_250));

        let late = SkewedClock::new(u64::from(u32::MAX) - 999, 0.0, 1);
        let registers = [0, 2].map(|millis| register_micros(late.reading::<BrickClock>(at(millis))));
        assert_eq!(registers, [u32::MAX - 999, 1_000]);

        let mut restarted = SkewedClock::new(5_000_000, 100.0, 1);
        restarted.restart(at(10_000));
        assert_eq!(restarted.reading::<BrickClock>(at(10_007)), Timestamp::from_micros(7_000));
    }
}
