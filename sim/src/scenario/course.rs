//! Where the robot is to drive, and how.

use posebridge_telemetry::{Arena, Heading, Meters, Pose};
use serde::Deserialize;

use super::loading;
use crate::checks;

/// The shape of the path. It begins at its own origin and leaves along x; [`StartPose`] puts it into the arena.
/// Way-points are an exception: they are taken as they are, relative to the start pose.
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
    /// Two circles, the left one first, without a stop; closed.
    FigureEight {
        #[serde(default = "default_radius", deserialize_with = "checks::positive")]
        radius_m: f64,
    },
    /// Straight legs between points, with turns in place. Further laps begin with a leg back to the first point.
    Waypoints {
        /// At least two points (x, y), in metres. A scenario may name a file instead, see [`super::Scenario::from_toml_with`].
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

/// Which way round a closed path is driven.
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
    /// The sign of the turn: 1 to the left, -1 to the right.
    pub(crate) const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

/// Where the path's own origin lies in the arena and where its x axis points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartPose {
    /// East, in metres.
    #[serde(deserialize_with = "checks::finite")]
    pub x_m: f64,
    /// North, in metres.
    #[serde(deserialize_with = "checks::finite")]
    pub y_m: f64,
    /// Counter-clockwise from east, in degrees.
    #[serde(deserialize_with = "checks::finite")]
    pub heading_deg: f64,
}

impl StartPose {
    pub(crate) fn pose(self) -> Pose<Arena> {
        Pose::new(Meters(self.x_m), Meters(self.y_m), Heading::from_rad(self.heading_deg.to_radians()))
    }
}

/// Whether a drive ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DriveEnd {
    /// With the last lap.
    #[default]
    LastLap,
    /// Never: lap after lap. A path that does not close is followed by the way back to its first point.
    Never,
}

/// How the path is driven. The values of the follower are limits; the motors may be slower.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriveSettings {
    /// How often the path is driven, if its end is the drive's.
    #[serde(deserialize_with = "checks::laps")]
    pub laps: u32,
    /// Whether the drive ends. No scenario sets this: the caller decides.
    #[serde(skip)]
    pub end: DriveEnd,
    /// Speed on legs and circles, in metres per second.
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    /// Speed of turns in place, in radians per second.
    #[serde(deserialize_with = "checks::positive")]
    pub turn_rate_rad_per_s: f64,
    /// Rest before the first movement, in seconds; a station finds the gyro's bias in it.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_s: f64,
    /// Rest before and after each turn in place, in seconds.
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
