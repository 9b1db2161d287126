//! The drive: distance and speed under a held PWM.

use super::scene::{CarSettings, ControlSettings};
use crate::random::RandomStream;

/// Where the car is and how fast.
#[derive(Clone, Debug)]
pub(super) struct Car {
    steady_m_per_s_per_pwm: f64,
    time_constant_s: f64,
    pub(super) distance_m: f64,
    pub(super) towards_m_per_s: f64,
}

impl Car {
    pub(super) fn new(settings: &CarSettings, distance_m: f64) -> Self {
        Self {
            steady_m_per_s_per_pwm: settings.steady_m_per_s / settings.reference_pwm,
            time_constant_s: settings.rise_90_s / std::f64::consts::LN_10,
            distance_m,
            towards_m_per_s: 0.0,
        }
    }

    /// Drives on for a time. The wall ends it: the car stands before it then.
    pub(super) fn drive(&mut self, pwm: f64, dt_s: f64) {
        let settled = self.steady_m_per_s_per_pwm * pwm;
        let left = (-dt_s / self.time_constant_s).exp();
        // What is missing to the settled speed decays; its integral is the way that is missing.
        let missing = self.towards_m_per_s - settled;
        self.distance_m -= settled * dt_s + missing * self.time_constant_s * (1.0 - left);
        self.towards_m_per_s = settled + missing * left;
        if self.distance_m <= 0.0 {
            self.distance_m = 0.0;
            self.towards_m_per_s = 0.0;
        }
    }
}

/// When the loop turns.
#[derive(Clone, Debug)]
pub(super) struct ControlPeriods {
    settings: ControlSettings,
    stream: RandomStream,
}

impl ControlPeriods {
    pub(super) fn new(settings: ControlSettings, seed: u64, run: u32) -> Self {
        Self { settings, stream: RandomStream::new(seed, &format!("wall control {run}")) }
    }

    pub(super) fn next_s(&mut self) -> f64 {
        let spread = self.settings.period_spread;
        self.settings.period_s * (1.0 + spread * self.stream.uniform(-1.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: CarSettings = CarSettings { reference_pwm: 80.0, steady_m_per_s: 1.225, rise_90_s: 0.997 };

    #[test]
    fn ninety_per_cent_of_the_speed_are_there_at_the_stated_time_however_it_is_cut() {
        let (mut whole, mut cut) = (Car::new(&PAPER, 5.0), Car::new(&PAPER, 5.0));
        whole.drive(80.0, 0.997);
        for _ in 0..997 {
            cut.drive(80.0, 0.001);
        }
        assert!((whole.towards_m_per_s - 0.9 * 1.225).abs() < 1e-12);
        assert!((whole.distance_m - cut.distance_m).abs() < 1e-9);
        // By hand: 5 - 1.225 (0.997 - 0.9 tau), tau = 0.997 / 2.302585 = 0.432992.
        assert!((whole.distance_m - 4.256_04).abs() < 1e-4, "{}", whole.distance_m);
    }

    #[test]
    fn the_wall_stops_it() {
        let mut car = Car::new(&PAPER, 0.01);
        car.drive(80.0, 1.0);
        assert_eq!((car.distance_m, car.towards_m_per_s), (0.0, 0.0));
    }
}
