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

pub(super) const PORTS: usize = 4;
/// Ports of the wheel motors.
const LEFT: usize = 1;
const RIGHT: usize = 2;
const CONTROL_PASSES: u32 = 10;
const RAD_PER_S_PER_PERCENT: f64 = 10.5 * TICK_RAD;
/// Deceleration before a target: speed limit in percent per remaining degree, and the minimum speed in percent.
const PERCENT_PER_DEG: f64 = 0.4;
const SLOWEST_PERCENT: f64 = 5.0;
const FULL_PERCENT: f64 = 100.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MotorDrive {
    /// Share of the battery's voltage, -1 to 1.
    Power(f64),
    Speed(f64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopCondition {
    /// Only a stop command.
    Stopped,
    Turned(i64),
    Time(TimeDelta),
}

#[derive(Clone, Debug)]
struct MotorOutput {
    /// Applied by START.
    setting: MotorDrive,
    polarity: f64,
    running: Option<(MotorDrive, StopCondition)>,
    position: i64,
    /// Zero points of the counter and of the movement's tacho.
    count_zero: i64,
    tacho_zero: i64,
    start_position: i64,
    control: SpeedControl,
    duty: f64,
}

#[derive(Clone, Debug)]
pub(super) struct Motors {
    ports: [MotorOutput; PORTS],
    passes: u32,
}

impl Motors {
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
        Self { ports: [port(), port(), port(), port()], passes: 0 }
    }

    pub(super) const fn is_motor(port: usize) -> bool {
        matches!(port, LEFT | RIGHT)
    }

    pub(super) fn step(&mut self, world: TimeDelta, positions: PerWheel<i64>) -> PerWheel<f64> {
        self.ports[LEFT].position = positions.left;
        self.ports[RIGHT].position = positions.right;
        let is_due = self.passes.is_multiple_of(CONTROL_PASSES);
        self.passes = self.passes.wrapping_add(1);
        for port in &mut self.ports {
            port.step(world);
            if is_due {
                port.control_speed();
            }
        }
        PerWheel { left: self.ports[LEFT].duty, right: self.ports[RIGHT].duty }
    }

    pub(super) fn drive(&mut self, duty: PerWheel<f64>) {
        for (index, duty) in [(LEFT, duty.left), (RIGHT, duty.right)] {
            self.ports[index].running = Some((MotorDrive::Power(duty), StopCondition::Stopped));
            self.ports[index].polarity = 1.0;
        }
    }

    pub(super) fn set(&mut self, field: i32, drive: MotorDrive) {
        self.each(field, |port| port.setting = drive);
    }

    /// Polarity of the ports of a bit field: -1 backward, 0 toggle, 1 forward.
    pub(super) fn set_polarity(&mut self, field: i32, polarity: i32) {
        self.each(field, |port| {
            port.polarity = match polarity.signum() {
                0 => -port.polarity,
                sign => f64::from(sign),
            };
        });
    }

    pub(super) fn start(&mut self, field: i32) {
        self.each(field, |port| {
            // A movement with an end of its own goes on.
            if !matches!(port.running, Some((_, StopCondition::Turned(_) | StopCondition::Time(_)))) {
                let drive = port.setting;
                port.begin(drive, StopCondition::Stopped);
            }
        });
    }

    pub(super) fn begin(&mut self, field: i32, drive: MotorDrive, until: StopCondition) {
        self.each(field, |port| port.begin(drive, until));
    }

    pub(super) fn stop(&mut self, field: i32) {
        self.each(field, |port| port.running = None);
    }

    /// Zeroes the counters that are read as sensors.
    pub(super) fn clear_counts(&mut self, field: i32) {
        self.each(field, |port| port.count_zero = port.position);
    }

    pub(super) fn reset_tachos(&mut self, field: i32) {
        self.each(field, |port| port.tacho_zero = port.position);
    }

    pub(super) fn is_busy(&self, field: i32) -> bool {
        let is_moving =
            |port: &MotorOutput| matches!(port.running, Some((_, StopCondition::Turned(_) | StopCondition::Time(_))));
        (0..).zip(&self.ports).any(|(bit, port)| field >> bit & 1 == 1 && is_moving(port))
    }

    /// Degrees; 0 for a port that does not exist.
    pub(super) fn count(&self, port: usize) -> i32 {
        let port = self.ports.get(port);
        port.map_or(0, |port| (port.position - port.count_zero) as i32)
    }

    pub(super) fn tacho(&self, port: usize) -> (i32, i32) {
        let Some(port) = self.ports.get(port) else {
            return (0, 0);
        };
        let percent = (port.duty * 100.0).round() as i32;
        ((port.position - port.tacho_zero) as i32, percent)
    }

    fn each(&mut self, field: i32, mut change: impl FnMut(&mut MotorOutput)) {
        for (bit, port) in (0..).zip(&mut self.ports) {
            if field >> bit & 1 == 1 {
                change(port);
            }
        }
    }
}

impl MotorOutput {
    fn begin(&mut self, drive: MotorDrive, until: StopCondition) {
        self.running = Some((drive, until));
        self.start_position = self.position;
        self.control.restart();
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
        let target_rad_per_s = self.polarity * percent.clamp(-most, most) * RAD_PER_S_PER_PERCENT;
        self.duty = self.control.duty(target_rad_per_s, self.position - self.start_position);
    }

    const fn remaining_degrees(&self, degrees: i64) -> i64 {
        degrees - (self.position - self.start_position).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_movement_is_busy_until_its_end() {
        const B: i32 = 2;
        let until = StopCondition::Time(TimeDelta::from_millis(5));
        // Time in milliseconds and position in degrees.
        for (end, last, first_after) in [(StopCondition::Turned(90), (0, -89), (0, -90)), (until, (4, 0), (5, 0))] {
            let mut motors = Motors::new(&RobotSettings::default());
            motors.begin(B, MotorDrive::Power(0.3), end);
            let busy = [last, first_after].map(|(millis, left)| {
                motors.step(TimeDelta::from_millis(millis), PerWheel { left, right: 0 });
                [B, 15, 4].map(|field| motors.is_busy(field))
            });
            assert_eq!(busy, [[true, true, false], [false; 3]]);
        }
    }
}
