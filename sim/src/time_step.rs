//! The time step of the simulation.

use posebridge_telemetry::TimeDelta;

/// Simulation time of one [`Simulation::step`](crate::Simulation::step): fine enough for motors and for the 1 ms encoders of the NXT.
pub const STEP: TimeDelta = TimeDelta::from_millis(1);
/// [`STEP`] in seconds.
pub(crate) const STEP_S: f64 = STEP.as_nanos() as f64 / 1e9;
