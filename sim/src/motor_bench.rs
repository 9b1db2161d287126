//! A wheel's motor on a test bench: the step test that identifies its time constant, dead time and gain.
//!
//! # Model
//! ```text
//! u(t) = volts from rest_s + dead_time_s on, else 0            the motor: that of docs/simulator.md, with half the robot's mass
//! tau = (J + m r^2 / 2) / (Kt/R Ke)                            w_end = (volts - friction / (Kt/R)) / Ke
//! reading k at the first millisecond after k periods, each period of its own length; angle = floor((phi + phi_0) / tick) tick
//! ```
//! The battery holds its voltage; the wheels do not slip.
//!
//! # Sources
//! The motor: docs/simulator.md. Dead time, periods and the rest: our choice, typical of an NXT behind a Bluetooth link.

use crate::clock::STEP_S;
use crate::motor::Motor;
use crate::random::RandomStream;
use crate::scenario::{RobotSettings, TICK_RAD};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorBench {
    pub robot: RobotSettings,
    pub volts: f64,
    /// Time of the command after the first reading.
    pub rest_s: f64,
    pub dead_time_s: f64,
    pub period_s: f64,
    /// Uniform relative spread of each period, either way.
    pub period_spread: f64,
    pub duration_s: f64,
}

impl Default for MotorBench {
    fn default() -> Self {
        Self {
            robot: RobotSettings::default(),
            volts: 8.0,
            rest_s: 0.5,
            dead_time_s: 0.06,
            period_s: 0.01,
            period_spread: 0.1,
            duration_s: 2.0,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderReading {
    pub at_s: f64,
    pub angle_rad: f64,
}

pub const ENCODER_TICK_RAD: f64 = TICK_RAD;

impl MotorBench {
    /// Runs the test. The seed draws the sampling times and the initial shaft position within a tick.
    pub fn run(&self, seed: u64) -> Vec<EncoderReading> {
        let mut motor = Motor::new(&self.robot.motor, self.load_kg_m2());
        let mut pace = RandomStream::new(seed, "bench pace");
        let phase_rad = RandomStream::new(seed, "bench shaft").uniform(0.0, TICK_RAD);
        let mut next_s = 0.0;
        let mut readings = Vec::new();
        let steps = (self.duration_s / STEP_S).round().clamp(0.0, MAX_STEPS) as u32;
        for step in 0..steps {
            let at_s = f64::from(step) * STEP_S;
            if at_s >= next_s {
                next_s += pace.period(self.period_s, self.period_spread);
                let ticks = ((motor.angle_rad + phase_rad) / TICK_RAD).floor();
                let angle_rad = ticks * TICK_RAD;
                readings.push(EncoderReading { at_s, angle_rad });
            }
            let is_on = at_s >= self.rest_s + self.dead_time_s - 0.5 * STEP_S;
            motor.step(if is_on { self.volts } else { 0.0 });
        }
        readings
    }

    pub fn time_constant_s(&self) -> f64 {
        self.robot.motor.time_constant_s(self.load_kg_m2())
    }

    /// Steady-state speed per volt, less the voltage drop of friction.
    pub fn gain_rad_per_s_per_v(&self) -> f64 {
        let motor = &self.robot.motor;
        let friction_v = motor.friction_n_m / motor.torque_n_m_per_v;
        (self.volts.abs() - friction_v) / motor.back_emf_v_s_per_rad / self.volts.abs()
    }

    /// Each wheel carries half the robot.
    const fn load_kg_m2(&self) -> f64 {
        0.5 * self.robot.mass_kg * self.robot.wheel_radius_m * self.robot.wheel_radius_m
    }
}

const MAX_STEPS: f64 = 3.6e6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wheel_stands_through_the_dead_time_and_then_turns_with_its_time_constant_and_gain() {
        let bench = MotorBench { period_s: 0.001, ..MotorBench::default() };
        let readings = bench.run(1);
        let at = |at_s: f64| readings.iter().rfind(|reading| reading.at_s <= at_s).unwrap();
        let moved = readings.iter().find(|reading| reading.angle_rad > readings[0].angle_rad).unwrap();
        // Within some 12 ms the motor turns a degree.
        assert!((0.56..0.60).contains(&moved.at_s), "{moved:?}");
        let end_rad_per_s = bench.gain_rad_per_s_per_v() * bench.volts;
        let tau_s = bench.time_constant_s();
        assert!((tau_s - 0.111).abs() < 0.001, "{tau_s}");
        // A time constant after the onset it has turned by w_end tau / e; half a second at full speed is known to a tick.
        for (from_s, to_s, expected_rad) in
            [(0.56, 0.56 + tau_s, end_rad_per_s * tau_s / std::f64::consts::E), (1.4, 1.9, 0.5 * end_rad_per_s)]
        {
            let turned_rad = at(to_s).angle_rad - at(from_s).angle_rad;
            assert!((turned_rad - expected_rad).abs() < 1.5 * ENCODER_TICK_RAD, "{turned_rad} {expected_rad}");
        }
    }

    #[test]
    fn periods_are_spread_about_their_mean_and_seeds_differ() {
        let bench = MotorBench::default();
        let gaps = |seed| bench.run(seed).windows(2).map(|pair| pair[1].at_s - pair[0].at_s).collect::<Vec<_>>();
        assert!(gaps(3).iter().all(|gap| (0.008..0.0125).contains(gap)) && gaps(3).iter().any(|gap| *gap > 0.0101));
        assert_ne!(gaps(3), gaps(4));
        assert!(bench.run(3).len().abs_diff(200) <= 4);
    }
}
