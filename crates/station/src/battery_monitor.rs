//! What is known of a robot's battery: each quantity as it was last reported, while it is recent.
//!
//! A robot may report them in several messages, each with some of them.

use posebridge_protocol::message::Battery;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::host_times::ShiftHostTimes;

/// Age after which a quantity is unknown again: three requests to a brick that is asked for it.
const MAX_AGE: TimeDelta = TimeDelta::from_millis(30_000);

type Reading = Option<(f64, Timestamp<HostClock>)>;

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct BatteryMonitor {
    voltage_v: Reading,
    current_a: Reading,
    remaining: Reading,
}

impl ShiftHostTimes for BatteryMonitor {
    fn shift_host_times(&mut self, by: TimeDelta) {
        let Self { voltage_v, current_a, remaining } = self;
        for reading in [voltage_v, current_a, remaining] {
            reading.shift_host_times(by);
        }
    }
}

impl BatteryMonitor {
    pub(crate) fn observe(&mut self, now: Timestamp<HostClock>, reported: &Battery) {
        let Battery { voltage_v, current_a, remaining } = *reported;
        let readings = [&mut self.voltage_v, &mut self.current_a, &mut self.remaining];
        for (reading, value) in readings.into_iter().zip([voltage_v, current_a, remaining]) {
            *reading = value.map(|value| (value, now)).or(*reading);
        }
    }

    /// Whether the robot has ever reported something of its battery.
    pub(crate) const fn is_known(&self) -> bool {
        self.voltage_v.is_some() || self.current_a.is_some() || self.remaining.is_some()
    }

    /// `None` while nothing is recent.
    pub(crate) fn current(&self, now: Timestamp<HostClock>) -> Option<Battery> {
        let [voltage_v, current_a, remaining] = [self.voltage_v, self.current_a, self.remaining]
            .map(|reading| reading.filter(|(_, at)| now - *at < MAX_AGE).map(|(value, _)| value));
        let battery = Battery { voltage_v, current_a, remaining };
        (battery != Battery::default()).then_some(battery)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_quantity_is_kept_beside_the_others_until_it_is_old() {
        let at = Timestamp::from_millis;
        let mut battery = BatteryMonitor::default();
        assert!(!battery.is_known() && battery.current(at(0)).is_none());
        battery.observe(at(0), &Battery { remaining: Some(0.8), ..Battery::default() });
        battery.observe(at(20_000), &Battery { voltage_v: Some(7.9), ..Battery::default() });
        let shown = |millis| battery.current(at(millis)).map(|battery| (battery.voltage_v, battery.remaining));
        assert_eq!(shown(29_999), Some((Some(7.9), Some(0.8))));
        assert_eq!(shown(30_000), Some((Some(7.9), None)));
        assert_eq!(shown(50_000), None);
        assert!(battery.is_known());
    }
}
