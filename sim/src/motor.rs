//! A geared direct-current motor with Coulomb friction, and the play between its gears.
//!
//! # Model
//! ```text
//! torque = (Kt/R) (u - Ke w) - friction sign(w)        u volts at the terminals, w rad/s at the output shaft
//! J dw/dt = torque                                     the motor stands while |(Kt/R) u| <= friction
//! ```
//! The winding's inductance is left out: its time constant is below the step of one millisecond.
//!
//! # Sources
//! Pybricks `model_nxt` (servo_settings.c and motor_model.py), decoded into SI; it agrees with the measurements of
//! philohome.com (170 rpm at 9 V without load, stall 0.50 N m). See docs/simulator.md.

use crate::clock::STEP_S;
use crate::scenario::MotorSettings;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Motor {
    back_emf_v_s_per_rad: f64,
    /// Voltage drop of friction, which is also the dead band.
    friction_v: f64,
    /// Factor of a speed difference after one step.
    decay: f64,
    /// J R / (Kt Ke).
    time_constant_s: f64,
    /// Total rotation of the output shaft, where the encoder sits.
    pub(crate) angle_rad: f64,
    pub(crate) speed_rad_per_s: f64,
}

impl Motor {
    /// At rest at angle zero; `load_kg_m2` is the inertia besides its own, at the output shaft.
    pub(crate) fn new(motor: &MotorSettings, load_kg_m2: f64) -> Self {
        let time_constant_s = motor.time_constant_s(load_kg_m2);
        Self {
            back_emf_v_s_per_rad: motor.back_emf_v_s_per_rad,
            friction_v: motor.friction_n_m / motor.torque_n_m_per_v,
            decay: (-STEP_S / time_constant_s).exp(),
            time_constant_s,
            angle_rad: 0.0,
            speed_rad_per_s: 0.0,
        }
    }

    /// Applies `volts` for one step; exact for a constant voltage and therefore stable for any constants.
    pub(crate) fn step(&mut self, volts: f64) {
        let before = self.speed_rad_per_s;
        let net_v = volts - self.back_emf_v_s_per_rad * before;
        let is_held = net_v.abs() <= self.friction_v;
        if before == 0.0 && is_held {
            return;
        }
        let against = if before == 0.0 { net_v } else { before };
        let end = (volts - self.friction_v.copysign(against)) / self.back_emf_v_s_per_rad;
        let after = end + (before - end) * self.decay;
        // Friction brings a motor to rest; which way it starts again is decided from there.
        if before * after < 0.0 {
            self.speed_rad_per_s = 0.0;
            self.angle_rad += 0.5 * before * STEP_S;
        } else {
            self.speed_rad_per_s = after;
            self.angle_rad += end * STEP_S + (before - end) * self.time_constant_s * (1.0 - self.decay);
        }
    }
}

/// The play between the encoder's shaft and the wheel: on reversal the wheel waits until the gap is crossed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Backlash {
    half_gap_rad: f64,
    wheel_rad: f64,
}

impl Backlash {
    /// Total play `gap_rad`, with the wheel in its middle.
    pub(crate) const fn new(gap_rad: f64) -> Self {
        Self { half_gap_rad: 0.5 * gap_rad, wheel_rad: 0.0 }
    }

    pub(crate) fn follow(&mut self, shaft_rad: f64) -> f64 {
        let before = self.wheel_rad;
        self.wheel_rad = before.max(shaft_rad - self.half_gap_rad).min(shaft_rad + self.half_gap_rad);
        self.wheel_rad - before
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn speed_after(volts: f64, millis: u32) -> f64 {
        let mut motor = Motor::new(&MotorSettings::default(), 0.0);
        (0..millis).for_each(|_| motor.step(volts));
        motor.speed_rad_per_s
    }

    #[test]
    fn no_load_speeds_and_the_dead_band_are_those_of_the_measured_motor() {
        // philohome.com and Pybricks: 170 rpm at 9 V, 135 rpm at 7.2 V; friction eats a third of a volt.
        for (volts, rpm) in [(9.0, 170.0), (7.2, 135.0), (-9.0, -170.0)] {
            let found = speed_after(volts, 2_000) * 60.0 / std::f64::consts::TAU;
            assert!((found - rpm).abs() < 2.0, "{volts} V: {found} rpm");
        }
        assert_eq!(speed_after(0.32, 1_000), 0.0);
        assert!(speed_after(0.35, 1_000) > 0.0);
    }

    #[test]
    fn the_wheel_waits_while_the_gap_is_crossed() {
        let mut play = Backlash::new(0.08);
        assert!((play.follow(1.0) - 0.96).abs() < 1e-12);
        assert_eq!(play.follow(0.93), 0.0);
        assert!((play.follow(0.90) + 0.02).abs() < 1e-12);
    }
}
