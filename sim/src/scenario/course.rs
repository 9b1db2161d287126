//! The path of a scenario and how it is driven.

use posebridge_telemetry::{Arena, Heading, Meters, Pose};
use serde::Deserialize;

use super::loading;
use crate::checks;

/// The shape of the path, in its own space: it begins at the origin and leaves along x; [`StartPose`] places it in the arena.
/// Way-points are used as given, relative to the start pose.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Course {
    /// Straight sides with turns in place; closed.
    Square {
        #[serde(default = "default_side", deserialize_with = "checks::positive")]
        side_m: f64,
        #[serde(default)]
        direction: Direction,
    },
    /// A circle without a stop; closed.
    Circle {
        #[serde(default = "default_radius", deserialize_with = "checks::positive")]
        radius_m: f64,
        #[serde(default)]
        direction: Direction,
    },
    /// Two circles without a stop, the left one first; closed.
    FigureEight {
        #[serde(default = "default_radius", deserialize_with = "checks::positive")]
        radius_m: f64,
    },
    /// Straight legs between points, with turns in place. Further laps begin with a leg back to the first point.
    Waypoints {
        /// At least two points (x, y). A scenario may name a file instead, see [`super::Scenario::from_toml_with`].
        #[serde(deserialize_with = "loading::waypoints")]
        points_m: Vec<[f64; 2]>,
    },
}

impl Default for Course {
    fn default() -> Self {
        Self::Square { side_m: default_side(), direction: Direction::default() }
    }
}

const fn default_side() -> f64 {
    1.0
}

const fn default_radius() -> f64 {
    0.5
}

/// Of a closed path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Counter-clockwise.
    #[default]
    Left,
    /// Clockwise.
    Right,
}

impl Direction {
    /// Turn sign: 1 to the left, -1 to the right.
    pub(crate) const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

/// Origin and x axis of the path in the arena.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartPose {
    /// East.
    #[serde(deserialize_with = "checks::finite")]
    pub x_m: f64,
    /// North.
    #[serde(deserialize_with = "checks::finite")]
    pub y_m: f64,
    /// Counter-clockwise from east.
    #[serde(deserialize_with = "checks::finite")]
    pub heading_deg: f64,
}

impl StartPose {
    pub(crate) fn pose(self) -> Pose<Arena> {
        Pose::new(Meters(self.x_m), Meters(self.y_m), Heading::from_rad(self.heading_deg.to_radians()))
    }
}

/// Whether a drive ends after its laps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DriveEnd {
    #[default]
    LastLap,
    /// Endless laps. A path that is not closed returns to its first point.
    Never,
}

/// Limits and timing of the drive. The motors may be slower.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriveSettings {
    /// Ignored by an endless drive.
    #[serde(deserialize_with = "checks::laps")]
    pub laps: u32,
    /// Set by the caller, never by a scenario.
    #[serde(skip)]
    pub end: DriveEnd,
    /// On legs and circles.
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    /// Of turns in place.
    #[serde(deserialize_with = "checks::positive")]
    pub turn_rate_rad_per_s: f64,
    /// Rest before the first movement, in which a station estimates the gyro's bias.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_s: f64,
    /// Rest before and after each turn in place.
    #[serde(deserialize_with = "checks::non_negative")]
    pub pause_s: f64,
}

impl Default for DriveSettings {
    fn default() -> Self {
        Self {
            laps: 1,
            end: DriveEnd::default(),
            speed_m_per_s: 0.22,
            turn_rate_rad_per_s: 1.2,
            rest_s: 2.0,
            pause_s: 0.25,
        }
    }
}
