//! The inputs of one pass of a brick's firmware.

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

use super::plugged_sensors::PluggedSensors;
use crate::firmware::Program;
use crate::sensors::SensorBoard;
use crate::wheels::PerWheel;

/// One pass of a brick's firmware, and everything that it can reach then.
pub(super) struct FirmwarePass<'a> {
    /// Time since the beginning of the world, as a part on the board would count it.
    pub(super) sim_time: TimeDelta,
    /// The brick's clock.
    pub(super) now: Timestamp<BrickClock>,
    pub(super) board: &'a mut SensorBoard,
    pub(super) senses: &'a PluggedSensors,
    pub(super) battery_v: f64,
    pub(super) program: &'a mut Program,
}

impl FirmwarePass<'_> {
    /// What the encoders have counted since power-up.
    pub(super) fn counts(&self) -> PerWheel<i64> {
        self.board.counts()
    }

    /// The brick's clock in its register of milliseconds.
    pub(super) const fn tick_ms(&self) -> u32 {
        (self.now.as_micros() / 1_000) as u32
    }
}
