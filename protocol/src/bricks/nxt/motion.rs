//! Readings of motors and accelerometers, combined for both wheels, and the detection of standstill.

use posebridge_telemetry::{HostClock, MetersPerSecondSquared, TimeDelta, Timestamp};

use super::gyro::WheelState;
use super::settings::MotorPort;
use crate::bricks::counters::MotorCounts;
use crate::message::WireStamp;

/// So long the counts must not have changed for wheels to stand; a wheel that turns slower than this allows is slower than 4 degrees
/// per second.
const STANDSTILL_TIME: TimeDelta = TimeDelta::from_millis(250);

/// The interval between a request and its reply; the value was read within it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RequestInterval {
    pub(super) sent: Timestamp<HostClock>,
    pub(super) answered: Timestamp<HostClock>,
}

impl RequestInterval {
    /// The interval that covers both.
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

/// One reading of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct MotorReading {
    count: i32,
    interval: RequestInterval,
}

/// The readings of both wheels, and the interval within which they were read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct WheelReadings {
    pub(super) counts: MotorCounts,
    pub(super) interval: RequestInterval,
}

/// Accelerations at the wheels, each waiting for the other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PendingAccelerations {
    pub(super) left: Option<AccelerationReading>,
    pub(super) right: Option<AccelerationReading>,
}

/// One reading of an accelerometer.
#[derive(Clone, Copy, Debug)]
pub(super) struct AccelerationReading {
    pub(super) along: MetersPerSecondSquared,
    pub(super) interval: RequestInterval,
}

/// The motors of one brick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MotorReadings {
    readings: [Option<MotorReading>; 3],
    last_counts: Option<[i32; 2]>,
    standstill_since: Option<Timestamp<HostClock>>,
}

impl MotorReadings {
    /// A motor was read.
    pub(super) const fn push(&mut self, motor: MotorPort, count: i32, interval: RequestInterval) {
        self.readings[motor.index()] = Some(MotorReading { count, interval });
    }

    /// Both wheels, once both were read since the last time.
    pub(super) fn take_pair(&mut self, left: MotorPort, right: MotorPort) -> Option<WheelReadings> {
        let (first, second) = (self.readings[left.index()]?, self.readings[right.index()]?);
        let third = MotorPort::ALL
            .into_iter()
            .find(|port| *port != left && *port != right)
            .and_then(|port| self.readings[port.index()]);
        self.readings = [None; 3];
        let wheels = [first.count, second.count];
        let interval = first.interval.union(second.interval);
        if self.last_counts.replace(wheels) != Some(wheels) {
            self.standstill_since = Some(interval.answered);
        }
        Some(WheelReadings { counts: MotorCounts { wheels, third: third.map(|read| read.count) }, interval })
    }

    /// Whether the wheels stand at `now`.
    pub(super) fn wheel_state(&self, now: Timestamp<HostClock>) -> WheelState {
        match self.standstill_since {
            Some(since) if now - since >= STANDSTILL_TIME => WheelState::Standing,
            _ => WheelState::Turning,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> RequestInterval {
        RequestInterval { sent: Timestamp::from_millis(millis), answered: Timestamp::from_millis(millis + 30) }
    }

    #[test]
    fn wheels_that_are_read_apart_are_told_together_and_once() {
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
    fn wheels_stand_a_quarter_of_a_second_after_they_stopped() {
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
}
