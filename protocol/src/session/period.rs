//! The schedule of periodic actions.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{TimeDelta, Timestamp};

/// Shortest period, so that a zero in a configuration does not busy-loop.
pub(super) const MIN_PERIOD: TimeDelta = TimeDelta::from_millis(1);

/// The next time of a periodic action: in step with the last one, or from now on when whole periods were missed.
pub(super) fn next_period<C: Clock>(due: Timestamp<C>, period: TimeDelta, now: Timestamp<C>) -> Timestamp<C> {
    let next = due + period;
    if next > now { next } else { now + period }
}
