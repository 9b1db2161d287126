//! When a polled brick is asked for its battery, and what of its answers can be.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::message::Battery;

/// After connect the clock, the sensors and the size of reads come first.
const FIRST_AFTER: TimeDelta = TimeDelta::from_millis(2_000);
const PERIOD: TimeDelta = TimeDelta::from_millis(10_000);
/// Requests without an answer after which a brick that never gave one is not asked any more.
const MAX_FAILURES: u8 = 2;
/// Voltages of a battery that can run a LEGO brick: it switches off far above the lower one, and six fresh lithium cells
/// have 10.8 V.
const VOLTAGES_V: std::ops::RangeInclusive<f64> = 1.0..=12.0;

/// The battery of a brick, if its voltage can be one.
pub(super) fn plausible_battery(voltage_v: f64) -> Option<Battery> {
    VOLTAGES_V.contains(&voltage_v).then_some(Battery { voltage_v: Some(voltage_v), ..Battery::default() })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BatterySupport {
    /// Number of failures so far.
    Unknown(u8),
    /// A lost answer says something about the link and nothing about the brick.
    Answered,
    Absent,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct BatterySchedule {
    support: BatterySupport,
    next: Timestamp<HostClock>,
}

impl BatterySchedule {
    /// For a link that comes up at `now`.
    pub(super) fn new(now: Timestamp<HostClock>) -> Self {
        Self { support: BatterySupport::Unknown(0), next: now + FIRST_AFTER }
    }

    /// When the brick is to be asked; `None` if it has not answered.
    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        (self.support != BatterySupport::Absent).then_some(self.next)
    }

    /// Whether to ask now; then it is due again after the period.
    pub(super) fn take_due(&mut self, now: Timestamp<HostClock>) -> bool {
        let is_due = self.deadline().is_some_and(|due| due <= now);
        if is_due {
            self.next = now + PERIOD;
        }
        is_due
    }

    pub(super) const fn record_answer(&mut self) {
        self.support = BatterySupport::Answered;
    }

    /// A refusal, or no answer. True if the brick is not asked any more from now on.
    pub(super) const fn record_failure(&mut self) -> bool {
        let BatterySupport::Unknown(failures) = self.support else {
            return false;
        };
        let failures = failures + 1;
        let is_enough = failures >= MAX_FAILURES;
        self.support = if is_enough { BatterySupport::Absent } else { BatterySupport::Unknown(failures) };
        is_enough
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_brick_that_answered_once_is_asked_on_and_one_that_never_did_twice() {
        let at = Timestamp::from_millis;
        let mut battery = BatterySchedule::new(at(500));
        assert!(!battery.take_due(at(2_499)) && battery.take_due(at(2_500)) && !battery.take_due(at(2_500)));
        assert!(!battery.record_failure());
        assert!(battery.take_due(at(12_500)));
        let mut silent = battery;
        assert!(silent.record_failure() && !silent.record_failure());
        assert_eq!(silent.deadline(), None);
        battery.record_answer();
        assert!((0..9).all(|_| !battery.record_failure()));
        assert_eq!(battery.deadline(), Some(at(22_500)));
    }

    #[test]
    fn a_voltage_that_no_brick_runs_on_is_none() {
        let can_be = |volts: f64| plausible_battery(volts).is_some();
        assert!(can_be(7.9) && can_be(10.8));
        assert!(!can_be(0.0) && !can_be(-7.9) && !can_be(40.0) && !can_be(f64::NAN));
    }
}
