//! Closed-loop wheel speed control: a duty from the set speed and encoder counts.
//!
//! # Model
//! ```text
//! u = Ke w* + friction sign(w*) + P (w* - w) + I (angle* - angle)        angle* = sum of w* dt
//! ```
//! `w` is the count over the last 50 ms; one count in that window is 0.35 rad/s. With the NXT motor's 0.1 s the gains place both poles
//! at 10 rad/s with a damping of 0.7.

use std::collections::VecDeque;

use posebridge_telemetry::TimeDelta;

use crate::scenario::{MotorSettings, RobotSettings, TICK_RAD};

pub(super) const PERIOD: TimeDelta = TimeDelta::from_millis(10);
pub(super) const PERIOD_S: f64 = PERIOD.as_nanos() as f64 / 1e9;
/// Number of control steps over which the speed is measured.
const WINDOW: usize = 5;
/// P in units of Ke.
const PROPORTIONAL: f64 = 0.4;
/// I in units of Ke, per second.
const INTEGRAL_PER_S: f64 = 10.0;
/// Limit by which the reference may lead the wheel.
const LEAD_RAD: f64 = 0.6;

#[derive(Clone, Debug)]
pub(crate) struct SpeedControl {
    motor: MotorSettings,
    battery_v: f64,
    reference_rad: f64,
    counts: VecDeque<i64>,
}

impl SpeedControl {
    pub(crate) fn new(robot: &RobotSettings) -> Self {
        Self {
            motor: robot.motor,
            battery_v: robot.battery_v,
            reference_rad: 0.0,
            counts: VecDeque::from([0; WINDOW + 1]),
        }
    }

    /// Back to rest with the counter at zero.
    pub(crate) fn restart(&mut self) {
        self.reference_rad = 0.0;
        self.counts = VecDeque::from([0; WINDOW + 1]);
    }

    /// The duty for the next period, -1 to 1.
    pub(crate) fn duty(&mut self, target_rad_per_s: f64, count: i64) -> f64 {
        let oldest = self.counts.pop_front().unwrap_or(count);
        self.counts.push_back(count);
        let angle_rad = count as f64 * TICK_RAD;
        let moved = count - oldest;
        if target_rad_per_s == 0.0 && moved == 0 {
            self.reference_rad = angle_rad;
            return 0.0;
        }
        let speed_rad_per_s = moved as f64 * TICK_RAD / (WINDOW as f64 * PERIOD_S);
        self.reference_rad =
            (self.reference_rad + target_rad_per_s * PERIOD_S).max(angle_rad - LEAD_RAD).min(angle_rad + LEAD_RAD);
        let correction_rad_per_s =
            PROPORTIONAL * (target_rad_per_s - speed_rad_per_s) + INTEGRAL_PER_S * (self.reference_rad - angle_rad);
        let friction_v = if target_rad_per_s == 0.0 {
            0.0
        } else {
            (self.motor.friction_n_m / self.motor.torque_n_m_per_v).copysign(target_rad_per_s)
        };
        let volts = self.motor.back_emf_v_s_per_rad * (target_rad_per_s + correction_rad_per_s) + friction_v;
        (volts / self.battery_v).clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use crate::motor::Motor;

    use super::*;

    #[test]
    fn a_wheel_reaches_its_speed_against_a_weak_battery_holds_it_and_stops() {
        let robot = RobotSettings::default();
        let mut control = SpeedControl::new(&robot);
        let mut motor = Motor::new(&robot.motor, 0.0);
        let mut drive = |target_rad_per_s: f64, steps: u32| {
            for _ in 0..steps {
                let duty = control.duty(target_rad_per_s, (motor.angle_rad / TICK_RAD).floor() as i64);
                // A tenth weaker than the brick assumes.
                (0..10).for_each(|_| motor.step(0.9 * robot.battery_v * duty));
            }
            motor
        };
        let at_one_second = drive(7.0, 100).angle_rad;
        let mean = (drive(7.0, 200).angle_rad - at_one_second) / 2.0;
        assert!((mean - 7.0).abs() < 0.1, "{mean} rad/s");
        assert_eq!(drive(0.0, 100).speed_rad_per_s, 0.0);
    }
}
