//! Host time of instants that a robot's clock tells, in the outputs.

use posebridge_telemetry::{BrickClock, HostClock, TimeDelta, Timestamp};

/// One instant by both clocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ClockAlignmentPoint {
    pub(crate) host: Timestamp<HostClock>,
    pub(crate) brick: Timestamp<BrickClock>,
    pub(crate) skew_ppm: f64,
}

impl ClockAlignmentPoint {
    /// Converts brick time to host time.
    pub(crate) fn host_time(self, brick: Timestamp<BrickClock>) -> Timestamp<HostClock> {
        let since_s = (brick - self.brick).as_secs_f64() / (1.0 + 1e-6 * self.skew_ppm);
        self.host + TimeDelta::from_secs_f64(since_s)
    }
}
