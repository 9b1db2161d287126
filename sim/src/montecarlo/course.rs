//! The course of a Monte-Carlo drive, as its TOML file says it.

use std::f64::consts::FRAC_PI_2;

use serde::Deserialize;

use crate::checks::whole;
use crate::scenario::checks;

/// Poses closer than this have no direction between them, in metres.
const SHORTEST_LEG_M: f64 = 1e-3;

/// What is driven.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Course {
    /// Laps of a square with turns in place, left and right in turn, with a controller that knows the truth.
    Laps(Laps),
    /// A constant speed with a turn rate that swings.
    Weave(Weave),
    /// Splines through poses, at a trapezoidal speed.
    Spline(Spline),
}

/// Laps of a square.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laps {
    /// How many.
    #[serde(deserialize_with = "checks::laps")]
    pub laps: u32,
    /// Length of a side, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub side_m: f64,
    /// Speed on a side, in metres per second.
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    /// Turn rate of a turn in place, in radians per second.
    #[serde(deserialize_with = "checks::positive")]
    pub turn_rate_rad_per_s: f64,
    /// Steps over which the speed rises and falls at the ends of each side and turn.
    #[serde(deserialize_with = "ramp_steps")]
    pub ramp_steps: u32,
    /// Rest before the first lap, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_s: f64,
    /// Rest after each side, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_after_side_s: f64,
    /// Rest after each turn, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_after_turn_s: f64,
    /// Rest after the extra turn that ends a lap, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_after_lap_s: f64,
    /// The controller on a side: turn per step for each radian of heading error.
    #[serde(deserialize_with = "checks::non_negative")]
    pub heading_gain: f64,
    /// The controller on a side: turn per step for each metre beside the line, in radians.
    #[serde(deserialize_with = "checks::non_negative")]
    pub lateral_gain_rad_per_m: f64,
    /// The most that the controller turns in a step, in radians.
    #[serde(deserialize_with = "checks::non_negative")]
    pub most_turn_rad: f64,
}

/// A constant speed with the turn rate `amplitude sin(pulsation t)`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weave {
    /// How long, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub duration_s: f64,
    /// Forward speed, in metres per second.
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    /// Largest turn rate, in radians per second.
    #[serde(deserialize_with = "checks::finite")]
    pub turn_amplitude_rad_per_s: f64,
    /// How fast the turn rate swings, in radians per second.
    #[serde(deserialize_with = "checks::finite")]
    pub turn_pulsation_rad_per_s: f64,
}

/// Quintic splines from pose to pose, driven as one way with a trapezoidal speed.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spline {
    /// The poses (x in m, y in m, heading in degrees), from the first to the last.
    pub poses_m_deg: [[f64; 3]; 5],
    /// Length of the tangents at both ends of a leg, as a multiple of the straight distance between them.
    #[serde(deserialize_with = "checks::positive")]
    pub tangent_scale: f64,
    /// Largest speed, in metres per second.
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    /// Acceleration at the start and at the end, in metres per second squared.
    #[serde(deserialize_with = "checks::positive")]
    pub acceleration_m_per_s2: f64,
}

impl Course {
    /// About how many steps it takes, to be checked before anything is drawn.
    pub(super) fn steps_estimate(&self, step_s: f64) -> f64 {
        match self {
            Self::Laps(laps) => {
                let ramp_s = f64::from(laps.ramp_steps) * step_s;
                let side_s = laps.side_m / laps.speed_m_per_s + ramp_s + laps.rest_after_side_s;
                let turn_s = FRAC_PI_2 / laps.turn_rate_rad_per_s + ramp_s;
                let lap_s = 4.0 * (side_s + turn_s + laps.rest_after_turn_s) + turn_s + laps.rest_after_lap_s;
                (laps.rest_s + f64::from(laps.laps) * lap_s) / step_s
            }
            Self::Weave(weave) => weave.duration_s / step_s,
            Self::Spline(spline) => spline.duration_estimate_s() / step_s,
        }
    }
}

impl Spline {
    /// About how long it takes, from the straight distances and the lengths of the tangents, in seconds.
    fn duration_estimate_s(&self) -> f64 {
        let straight_m: f64 = self.legs().map(|(from, to)| distance_m(from, to)).sum();
        let length_m = straight_m * (1.0 + self.tangent_scale);
        length_m / self.speed_m_per_s + self.speed_m_per_s / self.acceleration_m_per_s2
    }

    /// The number, from 1, of the first leg whose ends are less than a millimetre apart.
    pub(super) fn leg_without_length(&self) -> Option<usize> {
        let is_short = |(from, to)| distance_m(from, to) < SHORTEST_LEG_M;
        self.legs().position(is_short).map(|index| index + 1)
    }

    pub(super) fn legs(&self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> + '_ {
        self.poses_m_deg.windows(2).map(|pair| (pair[0], pair[1]))
    }
}

pub(super) fn distance_m(from: [f64; 3], to: [f64; 3]) -> f64 {
    (to[0] - from[0]).hypot(to[1] - from[1])
}

fn ramp_steps<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 0, 1_000)
}
