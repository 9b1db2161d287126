//! What encoders measure and wheels do not do: the play of the gears, and wheels that spin.

use super::disturbances::SlipBursts;
use super::scenario::Scenario;
use super::schedule::starts;
use crate::random::RandomStream;
use crate::wheels::PerWheel;

/// The play between an encoder and its wheel.
#[derive(Clone, Copy, Debug)]
pub(super) struct GearPlay {
    half_rad: f64,
    /// How far the encoder is ahead of the wheel, within the play.
    ahead_rad: f64,
}

impl GearPlay {
    /// Each begins anywhere within its play.
    pub(super) fn of_wheels(play_deg: f64, seed: u64) -> PerWheel<Self> {
        let mut stream = RandomStream::new(seed, "backlash");
        let half_rad = 0.5 * play_deg.to_radians();
        let mut draw = || Self { half_rad, ahead_rad: stream.uniform(-half_rad, half_rad) };
        PerWheel { left: draw(), right: draw() }
    }

    /// The wheel's turn while the encoder turns by `encoder_rad`.
    pub(super) fn follow(&mut self, encoder_rad: f64) -> f64 {
        let ahead_rad = self.ahead_rad + encoder_rad;
        self.ahead_rad = ahead_rad.clamp(-self.half_rad, self.half_rad);
        ahead_rad - self.ahead_rad
    }
}

/// Wheels that turn forward on the spot.
pub(super) struct WheelSpinner {
    bursts: SlipBursts,
    /// The first step of each, and whether it is the left wheel's.
    pub(super) firsts: Vec<(usize, bool)>,
}

impl WheelSpinner {
    pub(super) fn new(bursts: SlipBursts, scenario: &Scenario, seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "slip bursts");
        let firsts = starts(bursts.first_s, bursts.every_s, scenario, &mut stream);
        Self { bursts, firsts: firsts.into_iter().map(|first| (first, stream.sign() > 0.0)).collect() }
    }

    /// What each encoder turns in a step without its wheel.
    pub(super) fn spin_rad(&self, step: usize, tick_rad: f64) -> PerWheel<f64> {
        let mut spin_rad = PerWheel { left: 0.0, right: 0.0 };
        let steps = self.bursts.spread_steps;
        let part_rad = f64::from(self.bursts.counts) / f64::from(steps) * tick_rad;
        for (first, is_left) in &self.firsts {
            if (*first..first + steps as usize).contains(&step) {
                let wheel = if *is_left { &mut spin_rad.left } else { &mut spin_rad.right };
                *wheel += part_rad;
            }
        }
        spin_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wheel_follows_its_encoder_once_the_play_is_through() {
        let mut play = GearPlay { half_rad: 0.1, ahead_rad: 0.0 };
        // By hand: to the front of the play, on, then back through the whole of it.
        let wheel: Vec<f64> =
            [0.1, 0.3, -0.15, -0.25].into_iter().map(|encoder_rad| play.follow(encoder_rad)).collect();
        for (found, expected) in wheel.into_iter().zip([0.0, 0.3, 0.0, -0.2]) {
            assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
        }
    }
}
