//! Instants of the host's clock in states that another station continues, whose clock shows another time.

use std::collections::BTreeMap;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// A state with instants of the host's clock.
pub(crate) trait ShiftHostTimes {
    /// Adds the same to every instant of the host's clock. Differences between them stay as they are, to the nanosecond.
    fn shift_host_times(&mut self, by: TimeDelta);
}

impl ShiftHostTimes for Timestamp<HostClock> {
    fn shift_host_times(&mut self, by: TimeDelta) {
        *self = *self + by;
    }
}

impl<T: ShiftHostTimes> ShiftHostTimes for Option<T> {
    fn shift_host_times(&mut self, by: TimeDelta) {
        if let Some(state) = self {
            state.shift_host_times(by);
        }
    }
}

/// A value with its instant.
impl<T> ShiftHostTimes for (T, Timestamp<HostClock>) {
    fn shift_host_times(&mut self, by: TimeDelta) {
        self.1.shift_host_times(by);
    }
}

impl<K, T: ShiftHostTimes> ShiftHostTimes for BTreeMap<K, T> {
    fn shift_host_times(&mut self, by: TimeDelta) {
        for state in self.values_mut() {
            state.shift_host_times(by);
        }
    }
}
