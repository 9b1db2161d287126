//! The configuration of a simulation: path, robot with its errors, sensors, clock and camera.
//!
//! A scenario is one TOML text; every key has a default and every number names its unit. `docs/simulator.md` holds the table of keys
//! with the sources of the defaults. The caller reads files.

mod loading;
mod pictures;
mod robot;
mod sensors;
mod side_by_side;
mod text_board;

use std::io;
use std::path::Path;

use posebridge_telemetry::{Arena, DriveGeometry, Heading, Meters, Pose, Radians, SensorNoise};
use serde::Deserialize;

use crate::config_file::{MAX_LAPS, bundle, bundled_text};

pub use crate::config_file::ConfigFileError as ScenarioError;
pub use pictures::{FloorTagSettings, RenderedCameraSettings, RobotTagSettings};
pub use robot::{
    BrickProgram, BrickSettings, ErrorSettings, MissingSensor, MotorSettings, Personality, PortSensor, RobotSettings,
    Wire,
};
pub use sensors::{
    AccelerometerSettings, Blackout, CameraImages, CameraOrder, CameraSettings, GyroSettings, ThermometerSettings,
};
pub use text_board::{TextBoardSettings, TextField, TextPart};

/// Name and TOML text of every bundled scenario. Adding one: a file in `config/scenarios/` and its name here.
pub const BUNDLED: &[(&str, &str)] = bundle!("scenarios": "square", "circle", "figure-eight", "waypoints", "straight", "rough", "thermometer",
    "by-hand");

/// The pose by which the brick steers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Steering {
    /// Dead reckoning.
    Odometry,
    /// The station's estimate, extrapolated by odometry; odometry alone while no estimate is fresh.
    #[default]
    Estimate,
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    pub seed: u64,
    pub steering: Steering,
    pub path: Course,
    pub start: StartPose,
    pub drive: DriveSettings,
    /// As its brick is configured.
    pub robot: RobotSettings,
    pub errors: ErrorSettings,
    pub gyro: GyroSettings,
    pub accelerometer: AccelerometerSettings,
    pub brick: BrickSettings,
    pub text_board: TextBoardSettings,
    pub camera: CameraSettings,
    #[serde(deserialize_with = "sensors::thermometer")]
    pub thermometer: Option<ThermometerSettings>,
}

impl Scenario {
    /// Reads a scenario from TOML that names no other file. An error names the line and the key that is unknown, missing, of the wrong
    /// type or out of range.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        Self::from_toml_with(text, &mut |_| Err(io::Error::other(TEXT_ALONE)))
    }

    /// Reads a scenario from TOML whose `[path.waypoints]` may name a `file` of lines `x_m,y_m`. `read` is called at most once, with
    /// the path as written, so that the caller resolves it. The scenario holds the points.
    pub fn from_toml_with(
        text: &str,
        read: &mut dyn FnMut(&Path) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        loading::parse_with_file(text, read)
    }

    pub fn bundled(name: &str) -> Result<Self, ScenarioError> {
        Self::from_toml(bundled_text("bundled scenario", BUNDLED, name, |names| names)?)
    }

    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    pub const fn with_steering(mut self, steering: Steering) -> Self {
        self.steering = steering;
        self
    }

    pub const fn with_personality(mut self, personality: Personality) -> Self {
        self.brick.personality = personality;
        self
    }

    /// With a camera that renders pictures, as the scenario describes it or else the usual one, and sends no fixes.
    #[must_use]
    pub fn with_rendered_camera(mut self) -> Self {
        self.camera.pictures.get_or_insert_default();
        self.camera.is_present = false;
        self
    }

    /// At least one.
    pub fn with_laps(mut self, laps: u32) -> Self {
        self.drive.laps = laps.clamp(1, MAX_LAPS);
        self
    }

    pub const fn without_end(mut self) -> Self {
        self.drive.end = DriveEnd::Never;
        self
    }

    pub fn drive_geometry(&self) -> DriveGeometry {
        DriveGeometry {
            left_wheel_radius: Meters(self.robot.wheel_radius_m),
            right_wheel_radius: Meters(self.robot.wheel_radius_m),
            track_width: Meters(self.robot.track_width_m),
            tick: Radians(TICK_RAD),
        }
    }

    /// The simulated noise of sensors and motion, one standard deviation each.
    pub fn sensor_noise(&self) -> SensorNoise {
        SensorNoise {
            wheel_travel_m_per_sqrt_m: self.errors.wheel_travel_m_per_sqrt_m,
            // Slip is simulated per wheel and in turns only.
            travel_m_per_sqrt_m: 0.0,
            turn_rad_per_sqrt_rad: self.errors.turn_rad_per_sqrt_rad,
            heading_rad_per_sqrt_m: 0.0,
            gyro_rad_per_s: self.gyro.sigma_deg_per_s.to_radians(),
            gyro_resolution_rad_per_s: self.gyro.quantum_deg_per_s.to_radians(),
            gyro_bias_rad_per_s: self.gyro.bias_sigma_deg_per_s.to_radians(),
            gyro_bias_walk_rad_per_s_sqrt_s: self.gyro.bias_walk_deg_per_s_sqrt_s.to_radians(),
            fix_position_m: self.camera.position_sigma_m,
            fix_heading_rad: self.camera.heading_sigma_deg.to_radians(),
            ..SensorNoise::EXACT
        }
    }
}

/// The shape of the path, in its own space: it begins at the origin and leaves along x; [`StartPose`] places it in the arena.
/// Way-points are used as given, relative to the start pose.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Course {
    /// Straight sides with turns in place; closed.
    Square {
        #[serde(default = "default_side")]
        side_m: f64,
        #[serde(default)]
        direction: Direction,
    },
    /// A circle without a stop; closed.
    Circle {
        #[serde(default = "default_radius")]
        radius_m: f64,
        #[serde(default)]
        direction: Direction,
    },
    /// Two circles without a stop, the left one first; closed.
    FigureEight {
        #[serde(default = "default_radius")]
        radius_m: f64,
    },
    /// Straight legs between points, with turns in place. Further laps begin with a leg back to the first point.
    Waypoints {
        /// At least two points (x, y). A scenario may name a file instead, see [`Scenario::from_toml_with`].
        #[serde(deserialize_with = "loading::waypoints")]
        points_m: Vec<[f64; 2]>,
    },
    /// A person moves the robot; its motors do nothing.
    ByHand(HandMotions),
}

/// The motions that `posebridge init --guide` asks for, with rests between: the left wheel turned by hand, straight on, on the spot to
/// the left.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HandMotions {
    pub wheel_turns: f64,
    pub straight_m: f64,
    pub turns: f64,
}

impl Default for HandMotions {
    fn default() -> Self {
        Self { wheel_turns: 1.0, straight_m: 1.0, turns: 1.0 }
    }
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
    pub x_m: f64,
    /// North.
    pub y_m: f64,
    /// Counter-clockwise from east.
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
    pub laps: u32,
    /// Set by the caller, never by a scenario.
    #[serde(skip)]
    pub end: DriveEnd,
    /// On legs and circles.
    pub speed_m_per_s: f64,
    /// Of turns in place.
    pub turn_rate_rad_per_s: f64,
    /// Rest before the first movement, in which a station estimates the gyro's bias.
    pub rest_s: f64,
    /// Rest before and after each turn in place, and after each motion by hand.
    pub pause_s: f64,
    /// Rest at the end of each lap; of all laps on a path without a stop.
    pub rest_after_lap_s: f64,
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
            rest_after_lap_s: 0.0,
        }
    }
}

/// NXT and EV3 motors resolve one degree of the output shaft.
pub(crate) const TICK_RAD: f64 = std::f64::consts::PI / 180.0;

const TEXT_ALONE: &str = "this scenario is read without files beside it; write the points into points_m";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_bundled_scenarios_and_names_read() {
        assert_eq!(Scenario::from_toml("").unwrap(), Scenario::default());
        for (name, text) in BUNDLED {
            assert!(Scenario::from_toml(text).is_ok(), "{name}: {:?}", Scenario::from_toml(text));
        }
        let message = Scenario::bundled("triangle").unwrap_err().to_string();
        assert!(message.contains("triangle") && message.contains("figure-eight"), "{message}");
        assert_eq!(Scenario::default().thermometer, None);
        let dipped = Scenario::from_toml("[thermometer]\nafter_c = 48.7\n").unwrap();
        assert_eq!(dipped.thermometer.unwrap().after_c, 48.7);
    }
}
