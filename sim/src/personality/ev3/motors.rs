//! The EV3's four motor ports.
//!
//! # Model
//! ```text
//! power p               duty = p / 100, once started
//! speed s               10.5 degrees per second for each percent, held by a PI control every 10 ms, once started
//! steps, milliseconds   that speed or power at once, until it has turned that far or that time is over; then it stands
//! ```
//! # Assumptions
//! Large motors sit on B (left) and C (right); A and D are empty. Ramps are a part of the way: a robot slows down only shortly
//! before a target. A motor without power is braked, whether brake or coast was asked for. Two motors in step (OUTPUT_STEP_SYNC,
//! OUTPUT_TIME_SYNC) are not simulated.
//!
//! # Sources
//! LEGO MINDSTORMS EV3 firmware developer kit, output byte codes. 175 rpm without load: Pybricks' identified model of the large motor.

use posebridge_telemetry::TimeDelta;

use crate::firmware::SpeedControl;
use crate::scenario::{RobotSettings, TICK_RAD};
use crate::wheels::PerWheel;

/// Number of ports.
pub(super) const PORTS: usize = 4;
/// Where the wheels' motors are plugged in.
const LEFT: usize = 1;
const RIGHT: usize = 2;
/// Passes between two steps of the speed control.
const CONTROL_PASSES: u32 = 10;
/// Speed of one percent.
const RAD_PER_S_PER_PERCENT: f64 = 10.5 * TICK_RAD;
/// Before a target it is no faster than this per degree that is left, in percent, and no slower than that.
const PERCENT_PER_DEG: f64 = 0.4;
const SLOWEST_PERCENT: f64 = 5.0;
const FULL_PERCENT: f64 = 100.0;

/// How a motor is driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MotorDrive {
    /// Share of the battery's voltage, -1 to 1.
    Power(f64),
    /// Percent of the full speed.
    Speed(f64),
}

/// When a movement ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopCondition {
    /// Not by itself.
    Stopped,
    /// After this number of degrees, in either direction.
    Turned(i64),
    /// At this time since the beginning of the world.
    Time(TimeDelta),
}

/// One port.
#[derive(Clone, Debug)]
struct MotorOutput {
    /// What START starts.
    setting: MotorDrive,
    polarity: f64,
    running: Option<(MotorDrive, StopCondition)>,
    position: i64,
    /// Where the counter and the tacho of the movement were zeroed.
    count_zero: i64,
    tacho_zero: i64,
    start_position: i64,
    control: SpeedControl,
    duty: f64,
}

/// All ports.
#[derive(Clone, Debug)]
pub(super) struct Motors {
    ports: [MotorOutput; PORTS],
    fresh_control: SpeedControl,
    passes: u32,
}

impl Motors {
    /// Ports at rest.
    pub(super) fn new(robot: &RobotSettings) -> Self {
        let control = SpeedControl::new(robot);
        let port = || MotorOutput {
            setting: MotorDrive::Power(0.0),
            polarity: 1.0,
            running: None,
            position: 0,
            count_zero: 0,
            tacho_zero: 0,
            start_position: 0,
            control: control.clone(),
            duty: 0.0,
        };
        Self { ports: [port(), port(), port(), port()], fresh_control: control, passes: 0 }
    }

    /// Whether a motor is plugged in there.
    pub(super) const fn is_motor(port: usize) -> bool {
        matches!(port, LEFT | RIGHT)
    }

    /// Follows the encoders by one pass and returns the duty of both motors.
    pub(super) fn step(&mut self, world: TimeDelta, positions: PerWheel<i64>) -> PerWheel<f64> {
        for (place, position) in [(LEFT, positions.left), (RIGHT, positions.right)] {
            if let Some(port) = self.ports.get_mut(place) {
                port.position = position;
            }
        }
        let is_due = self.passes.is_multiple_of(CONTROL_PASSES);
        self.passes = self.passes.wrapping_add(1);
        for port in &mut self.ports {
            port.step(world);
            if is_due {
                port.control_speed();
            }
        }
        let duty = |place: usize| self.ports.get(place).map_or(0.0, |port| port.duty);
        PerWheel { left: duty(LEFT), right: duty(RIGHT) }
    }

    /// What the program on the brick does: both motors on at these duties.
    pub(super) fn drive(&mut self, duty: PerWheel<f64>) {
        for (place, duty) in [(LEFT, duty.left), (RIGHT, duty.right)] {
            if let Some(port) = self.ports.get_mut(place) {
                port.running = Some((MotorDrive::Power(duty), StopCondition::Stopped));
                port.polarity = 1.0;
            }
        }
    }

    /// What START is to start on the ports of a bit field.
    pub(super) fn set(&mut self, field: i32, drive: MotorDrive) {
        self.each(field, |port, _| port.setting = drive);
    }

    /// Turns forward and backward around, or sets them: -1, 0 for the other way round, 1.
    pub(super) fn set_polarity(&mut self, field: i32, polarity: i32) {
        self.each(field, |port, _| {
            port.polarity = match polarity.signum() {
                0 => -port.polarity,
                sign => f64::from(sign),
            };
        });
    }

    /// Starts what was set.
    pub(super) fn start(&mut self, field: i32) {
        self.each(field, |port, fresh| {
            // A movement with an end of its own goes on.
            if !matches!(port.running, Some((_, StopCondition::Turned(_) | StopCondition::Time(_)))) {
                let drive = port.setting;
                port.begin(drive, StopCondition::Stopped, fresh);
            }
        });
    }

    /// Begins a movement with an end of its own.
    pub(super) fn begin(&mut self, field: i32, drive: MotorDrive, until: StopCondition) {
        self.each(field, |port, fresh| port.begin(drive, until, fresh));
    }

    /// Stops the ports of a bit field.
    pub(super) fn stop(&mut self, field: i32) {
        self.each(field, |port, _| port.running = None);
    }

    /// Zeroes the counters that are read as sensors.
    pub(super) fn clear_counts(&mut self, field: i32) {
        self.each(field, |port, _| port.count_zero = port.position);
    }

    /// Zeroes the tachos of the movements.
    pub(super) fn reset_tachos(&mut self, field: i32) {
        self.each(field, |port, _| port.tacho_zero = port.position);
    }

    /// Whether one of the ports of a bit field has a movement with an end before it.
    pub(super) fn is_busy(&self, field: i32) -> bool {
        let is_moving =
            |port: &MotorOutput| matches!(port.running, Some((_, StopCondition::Turned(_) | StopCondition::Time(_))));
        (0..).zip(&self.ports).any(|(bit, port)| field >> bit & 1 == 1 && is_moving(port))
    }

    /// The counter of a port, in degrees; 0 where there is none.
    pub(super) fn count(&self, port: usize) -> i32 {
        let port = self.ports.get(port);
        port.map_or(0, |port| (port.position - port.count_zero) as i32)
    }

    /// The tacho of a port, in degrees, and its power or speed in percent.
    pub(super) fn tacho(&self, port: usize) -> (i32, i32) {
        let Some(port) = self.ports.get(port) else {
            return (0, 0);
        };
        let percent = (port.duty * 100.0).round() as i32;
        ((port.position - port.tacho_zero) as i32, percent)
    }

    fn each(&mut self, field: i32, mut change: impl FnMut(&mut MotorOutput, &SpeedControl)) {
        for (bit, port) in (0..).zip(&mut self.ports) {
            if field >> bit & 1 == 1 {
                change(port, &self.fresh_control);
            }
        }
    }
}

impl MotorOutput {
    fn begin(&mut self, drive: MotorDrive, until: StopCondition, fresh: &SpeedControl) {
        self.running = Some((drive, until));
        self.start_position = self.position;
        self.control = fresh.clone();
    }

    fn step(&mut self, world: TimeDelta) {
        let is_over = match self.running {
            Some((_, StopCondition::Turned(degrees))) => self.remaining_degrees(degrees) <= 0,
            Some((_, StopCondition::Time(end))) => world >= end,
            Some((_, StopCondition::Stopped)) | None => false,
        };
        if is_over {
            self.running = None;
        }
        match self.running {
            None => self.duty = 0.0,
            Some((MotorDrive::Power(share), _)) => {
                self.duty = (self.polarity * share).clamp(-1.0, 1.0);
            }
            Some((MotorDrive::Speed(_), _)) => {}
        }
    }

    fn control_speed(&mut self) {
        let Some((MotorDrive::Speed(percent), until)) = self.running else {
            return;
        };
        let most = match until {
            StopCondition::Turned(degrees) => PERCENT_PER_DEG * self.remaining_degrees(degrees) as f64,
            StopCondition::Stopped | StopCondition::Time(_) => FULL_PERCENT,
        };
        let most = most.clamp(SLOWEST_PERCENT, FULL_PERCENT);
        let wanted = self.polarity * percent.clamp(-most, most) * RAD_PER_S_PER_PERCENT;
        self.duty = self.control.duty(wanted, self.position - self.start_position);
    }

    const fn remaining_degrees(&self, degrees: i64) -> i64 {
        degrees - (self.position - self.start_position).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const B: i32 = 2;

    fn at(left: i64) -> PerWheel<i64> {
        PerWheel { left, right: 0 }
    }

    fn motors() -> Motors {
        Motors::new(&RobotSettings::default())
    }

    #[test]
    fn power_waits_for_the_start_and_the_polarity_turns_it_around() {
        let mut motors = motors();
        motors.set(B, MotorDrive::Power(0.4));
        assert_eq!(motors.step(TimeDelta::ZERO, at(0)).left, 0.0);
        motors.start(B);
        assert_eq!(motors.step(TimeDelta::ZERO, at(0)).left, 0.4);
        motors.set_polarity(B, 0);
        assert_eq!(motors.step(TimeDelta::ZERO, at(0)).left, -0.4);
        motors.stop(B);
        assert_eq!(motors.step(TimeDelta::ZERO, at(0)).left, 0.0);
    }

    #[test]
    fn a_movement_is_busy_until_its_end() {
        let mut motors = motors();
        motors.begin(B, MotorDrive::Power(0.3), StopCondition::Turned(90));
        motors.step(TimeDelta::ZERO, at(-89));
        assert!(motors.is_busy(B) && motors.is_busy(15) && !motors.is_busy(4));
        motors.step(TimeDelta::ZERO, at(-90));
        assert!(!motors.is_busy(B));
        motors.begin(B, MotorDrive::Speed(30.0), StopCondition::Time(TimeDelta::from_millis(5)));
        motors.step(TimeDelta::from_millis(4), at(0));
        assert!(motors.is_busy(B));
        motors.step(TimeDelta::from_millis(5), at(0));
        assert!(!motors.is_busy(B));
    }

    #[test]
    fn counter_and_tacho_are_zeroed_for_themselves() {
        let mut motors = motors();
        motors.step(TimeDelta::ZERO, at(50));
        motors.clear_counts(B);
        motors.step(TimeDelta::ZERO, at(60));
        motors.reset_tachos(15);
        motors.step(TimeDelta::ZERO, at(65));
        assert_eq!((motors.count(1), motors.tacho(1).0), (15, 5));
        assert_eq!((motors.count(0), motors.count(9)), (0, 0));
    }
}
