//! The counts of both wheels, put together from one reply or several, and whether the wheels stand.

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::gyro::Wheels;
use super::settings::MotorPort;
use crate::bricks::counters::Counts;

/// So long the counts must not have changed for wheels to stand; a wheel that turns slower than this allows is slower than 4 degrees
/// per second.
const STANDS_AFTER: Span = Span::from_millis(250);

/// One motor as it was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Read {
    count: i32,
    sent: Stamp<HostClock>,
    answered: Stamp<HostClock>,
}

/// Both wheels, and between which instants they were read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BothWheels {
    pub(super) counts: Counts,
    pub(super) sent: Stamp<HostClock>,
    pub(super) answered: Stamp<HostClock>,
}

/// The motors of one brick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motors {
    read: [Option<Read>; 3],
    last: Option<[i32; 2]>,
    stand_since: Option<Stamp<HostClock>>,
}

impl Motors {
    /// A motor was read.
    pub(super) const fn take(
        &mut self,
        motor: MotorPort,
        count: i32,
        (sent, answered): (Stamp<HostClock>, Stamp<HostClock>),
    ) {
        self.read[motor.index()] = Some(Read { count, sent, answered });
    }

    /// Both wheels, once both were read since the last time.
    pub(super) fn both(&mut self, left: MotorPort, right: MotorPort) -> Option<BothWheels> {
        let (first, second) = (self.read[left.index()]?, self.read[right.index()]?);
        let third = MotorPort::ALL
            .into_iter()
            .find(|port| *port != left && *port != right)
            .and_then(|port| self.read[port.index()]);
        self.read = [None; 3];
        let wheels = [first.count, second.count];
        let answered = first.answered.max(second.answered);
        if self.last.replace(wheels) != Some(wheels) {
            self.stand_since = Some(answered);
        }
        Some(BothWheels {
            counts: Counts { wheels, third: third.map(|read| read.count) },
            sent: first.sent.min(second.sent),
            answered,
        })
    }

    /// Whether the wheels stand at `now`.
    pub(super) fn wheels(&self, now: Stamp<HostClock>) -> Wheels {
        match self.stand_since {
            Some(since) if now - since >= STANDS_AFTER => Wheels::Standing,
            _ => Wheels::Turning,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> (Stamp<HostClock>, Stamp<HostClock>) {
        (Stamp::from_millis(millis), Stamp::from_millis(millis + 30))
    }

    #[test]
    fn wheels_that_are_read_apart_are_told_together_and_once() {
        let mut motors = Motors::default();
        motors.take(MotorPort::B, 7, at(0));
        assert_eq!(motors.both(MotorPort::B, MotorPort::C), None);
        motors.take(MotorPort::C, -7, at(30));
        let both = motors.both(MotorPort::B, MotorPort::C).unwrap();
        assert_eq!(both.counts.wheels, [7, -7]);
        assert_eq!(both.counts.third, None);
        assert_eq!((both.sent, both.answered), (at(0).0, at(30).1));
        assert_eq!(motors.both(MotorPort::B, MotorPort::C), None);
    }

    #[test]
    fn wheels_stand_a_quarter_of_a_second_after_they_stopped() {
        let mut motors = Motors::default();
        let mut read = |count, millis| {
            motors.take(MotorPort::A, count, at(millis));
            motors.take(MotorPort::B, 0, at(millis));
            motors.take(MotorPort::C, 3, at(millis));
            let both = motors.both(MotorPort::C, MotorPort::A).unwrap();
            assert_eq!(both.counts.third, Some(0));
            motors.wheels(Stamp::from_millis(millis + 30))
        };
        assert_eq!(read(1, 0), Wheels::Turning);
        assert_eq!(read(2, 300), Wheels::Turning);
        assert_eq!(read(2, 549), Wheels::Turning);
        assert_eq!(read(2, 550), Wheels::Standing);
        assert_eq!(read(3, 900), Wheels::Turning);
    }
}
