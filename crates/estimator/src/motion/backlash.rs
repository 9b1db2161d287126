//! Play between encoder and wheel: after a reversal the encoder turns and the wheel does not, until the gear has crossed its play.
//!
//! ```text
//! wheel = encoder - beta p      p <- clamp(p + d encoder / w, -1/2, 1/2)      beta the play, w the configured one
//! ```
//! p depends on the encoder alone, so that the travel is linear in beta, which the filter learns. At power-up p is uniform.

use serde::{Deserialize, Serialize};

use crate::saved::finite;

/// Variance of a uniform p.
const UNIFORM_VARIANCE: f64 = 1.0 / 12.0;

/// The share p of its play by which one gear is ahead of its wheel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct GearPosition {
    #[serde(deserialize_with = "finite")]
    share: f64,
    /// Whether the gear has touched an end since power-up.
    is_known: bool,
}

/// The change of p over a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BacklashCrossing {
    /// The change expected.
    #[serde(deserialize_with = "finite")]
    pub share: f64,
    /// Its variance: more than zero until the gear has touched an end for the first time.
    #[serde(deserialize_with = "finite")]
    pub variance: f64,
}

impl BacklashCrossing {
    /// The part of a crossing that belongs to a part of its interval.
    pub(super) fn part(self, part: f64) -> Self {
        Self { share: self.share * part, variance: self.variance * part }
    }
}

impl GearPosition {
    /// Turns the encoder; `width_rad` is the configured play, more than zero.
    pub(super) fn turn(&mut self, encoder_rad: f64, width_rad: f64) -> BacklashCrossing {
        let before = self.share;
        let unclamped = before + encoder_rad / width_rad;
        self.share = unclamped.clamp(-0.5, 0.5);
        let touches = unclamped.abs() >= 0.5;
        let variance = if touches && !self.is_known { UNIFORM_VARIANCE } else { 0.0 };
        self.is_known |= touches;
        BacklashCrossing { share: self.share - before, variance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gear_crosses_its_play_once_for_each_reversal() {
        let mut gear = GearPosition::default();
        let shares: Vec<f64> = [1.0, 2.0, -0.02, -0.05, -3.0, 0.04].map(|turned| gear.turn(turned, 0.08).share).into();
        for (share, expected) in shares.iter().zip([0.5, 0.0, -0.25, -0.625, -0.125, 0.5]) {
            assert!((share - expected).abs() < 1e-12, "{shares:?}");
        }
    }

    #[test]
    fn where_the_gear_stood_at_power_up_is_unknown_until_it_has_touched_an_end() {
        let mut gear = GearPosition::default();
        let variances = [0.02, 0.03, 1.0, -1.0].map(|turned| gear.turn(turned, 0.08).variance);
        assert_eq!(variances, [0.0, UNIFORM_VARIANCE, 0.0, 0.0]);
    }
}
