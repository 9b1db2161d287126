//! Readings of motors and accelerometers, combined for both wheels; totals of the wheels, standstill, and the brick's clock.
//!
//! Each reading was made between its request and its reply, so the time between two readings is at most from the first
//! one's request to the second one's reply. Source of the limit: 170 rpm without load at 9 V (Philo's motor measurements,
//! philohome.com/nxtmotor), 1020 degrees per second, plus a half.

use posebridge_telemetry::{HostClock, MetersPerSecondSquared, TimeDelta, Timestamp};

use super::settings::MotorPort;
use crate::bricks::counters::{CounterUpdate, MotorCounters, MotorCounts, MotorLimits, Standstill, WheelState};
use crate::message::WireStamp;

/// Wheels whose counts have not changed for this long are at rest; a wheel that turns below this limit is slower than 4
/// degrees per second.
const STANDSTILL_TIME: TimeDelta = TimeDelta::from_millis(250);

/// The interval between a request and its reply; the value was read within it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RequestInterval {
    pub(super) sent: Timestamp<HostClock>,
    pub(super) answered: Timestamp<HostClock>,
}

impl RequestInterval {
    pub(super) fn union(self, other: Self) -> Self {
        Self { sent: self.sent.min(other.sent), answered: self.answered.max(other.answered) }
    }

    pub(super) fn middle(self) -> Timestamp<HostClock> {
        Timestamp::from_nanos(i64::midpoint(self.sent.as_nanos(), self.answered.as_nanos()))
    }

    pub(super) const fn stamp(self) -> WireStamp {
        WireStamp::HostInterval { sent: self.sent, answered: self.answered }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct MotorReading {
    count: i32,
    interval: RequestInterval,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct WheelReadings {
    pub(super) counts: MotorCounts,
    pub(super) interval: RequestInterval,
}

/// Accelerations of both wheels, each until the other arrives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PendingAccelerations {
    pub(super) left: Option<AccelerationReading>,
    pub(super) right: Option<AccelerationReading>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct AccelerationReading {
    pub(super) along: MetersPerSecondSquared,
    pub(super) interval: RequestInterval,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MotorReadings {
    readings: [Option<MotorReading>; 3],
    standstill: Standstill,
}

impl MotorReadings {
    pub(super) const fn push(&mut self, motor: MotorPort, count: i32, interval: RequestInterval) {
        self.readings[motor.index()] = Some(MotorReading { count, interval });
    }

    /// Both wheels, once both were read since the last call.
    pub(super) fn take_pair(&mut self, left: MotorPort, right: MotorPort) -> Option<WheelReadings> {
        let (first, second) = (self.readings[left.index()]?, self.readings[right.index()]?);
        let third = MotorPort::ALL
            .into_iter()
            .find(|port| *port != left && *port != right)
            .and_then(|port| self.readings[port.index()]);
        self.readings = [None; 3];
        let wheels = [first.count, second.count];
        let interval = first.interval.union(second.interval);
        self.standstill.record(wheels, interval.answered);
        Some(WheelReadings { counts: MotorCounts { wheels, third: third.map(|read| read.count) }, interval })
    }

    pub(super) fn wheel_state(&self, now: Timestamp<HostClock>) -> WheelState {
        self.standstill.wheel_state(now, STANDSTILL_TIME)
    }
}

const LIMITS: MotorLimits = MotorLimits {
    max_counts_per_s: 1_500.0,
    // What the uncertain instants of two readings are worth.
    margin: 60.0,
};

#[derive(Clone, Copy, Debug)]
pub(super) struct WheelTotals {
    counters: MotorCounters,
    last_sent: Option<Timestamp<HostClock>>,
}

impl Default for WheelTotals {
    fn default() -> Self {
        Self { counters: MotorCounters::new(LIMITS), last_sent: None }
    }
}

impl WheelTotals {
    pub(super) const fn brick_restarted(&mut self) {
        self.counters.brick_restarted();
    }

    pub(super) fn push(&mut self, both: &WheelReadings) -> CounterUpdate {
        let last_sent = self.last_sent.replace(both.interval.sent);
        let since = last_sent.map_or(TimeDelta::ZERO, |last_sent| both.interval.answered - last_sent);
        self.counters.push(since, both.counts)
    }
}

/// A tick that is further behind was read before a restart of the brick: readings come in order, and the clocks of host
/// and brick differ by far less over any silence without a restart.
const RESTART_BACK_MILLIS: i64 = 1_000;
const PERIOD_MILLIS: i64 = 1 << 32;
const PERIOD_MICROS: i64 = 1 << 32;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TickAdvance {
    /// The clock continued, or this is its first tick.
    Continuous,
    Restarted,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TickClock {
    last: Option<(u32, Timestamp<HostClock>)>,
}

impl TickClock {
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

    /// The tick nearest to the last one whose microseconds, in 32 bits, are `micros`.
    pub(super) fn millis_of(&self, micros: u32) -> u32 {
        let Some((last, _)) = self.last else {
            return micros / 1_000;
        };
        let last_micros = i64::from(last) * 1_000;
        let ahead = wrapped(i64::from(micros) - last_micros, PERIOD_MICROS);
        ((last_micros + ahead).div_euclid(1_000) & (PERIOD_MILLIS - 1)) as u32
    }
}

/// The value nearest to zero that is equal modulo the period.
const fn wrapped(value: i64, period: i64) -> i64 {
    (value + period / 2).rem_euclid(period) - period / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> RequestInterval {
        RequestInterval { sent: Timestamp::from_millis(millis), answered: Timestamp::from_millis(millis + 30) }
    }

    #[test]
    fn wheels_that_are_read_apart_are_emitted_together_and_once() {
        let mut motors = MotorReadings::default();
        motors.push(MotorPort::B, 7, at(0));
        assert_eq!(motors.take_pair(MotorPort::B, MotorPort::C), None);
        motors.push(MotorPort::C, -7, at(30));
        let both = motors.take_pair(MotorPort::B, MotorPort::C).unwrap();
        assert_eq!(both.counts.wheels, [7, -7]);
        assert_eq!(both.counts.third, None);
        assert_eq!(both.interval, at(0).union(at(30)));
        assert_eq!(motors.take_pair(MotorPort::B, MotorPort::C), None);
    }

    #[test]
    fn wheels_are_at_rest_a_quarter_of_a_second_after_they_stopped() {
        let mut motors = MotorReadings::default();
        let mut read = |count, millis| {
            motors.push(MotorPort::A, count, at(millis));
            motors.push(MotorPort::B, 0, at(millis));
            motors.push(MotorPort::C, 3, at(millis));
            let both = motors.take_pair(MotorPort::C, MotorPort::A).unwrap();
            assert_eq!(both.counts.third, Some(0));
            motors.wheel_state(Timestamp::from_millis(millis + 30))
        };
        assert_eq!(read(1, 0), WheelState::Turning);
        assert_eq!(read(2, 300), WheelState::Turning);
        assert_eq!(read(2, 549), WheelState::Turning);
        assert_eq!(read(2, 550), WheelState::Standing);
        assert_eq!(read(3, 900), WheelState::Turning);
    }

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
