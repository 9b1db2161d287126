//! What happens in a simulation: the path, the robot with its errors, its sensors, its clock and the camera.
//!
//! A scenario is one TOML text; every key has a default and every number names its unit. `docs/simulator.md` holds
//! the table of keys with the sources of the defaults. Reading files is the caller's business.

mod bundled;
pub(crate) mod checks;
mod course;
mod error;
mod personality;
mod robot;
mod sensors;
mod side_by_side;
mod thermometer;
mod waypoints;

use std::io;
use std::path::Path;

use posebridge_telemetry::{DriveGeometry, Meters, Radians, SensorNoise};
use serde::Deserialize;

use crate::bundled::text_of;

pub use bundled::BUNDLED;
pub use course::{Course, Direction, DriveEnd, DriveSettings, StartPose};
pub use error::ScenarioError;
pub use personality::{BrickProgram, Personality, PortSensor};
pub use robot::{BrickSettings, ErrorSettings, MissingSensor, MotorSettings, RobotSettings, Wire};
pub use sensors::{AccelerometerSettings, Blackout, CameraImages, CameraOrder, CameraSettings, GyroSettings};
pub use thermometer::ThermometerSettings;

/// What the brick steers by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Steering {
    /// Its own dead reckoning.
    Odometry,
    /// The estimate that the station sends back, carried forward by its own odometry; that alone while none is fresh.
    #[default]
    Estimate,
}

/// Everything that a simulation needs to know.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    /// The one seed of all randomness.
    pub seed: u64,
    /// What the brick steers by.
    pub steering: Steering,
    /// The path, in its own space; [`StartPose`] places it in the arena.
    pub path: Course,
    /// Where the path begins and points.
    pub start: StartPose,
    /// How the path is driven.
    pub drive: DriveSettings,
    /// The robot as its brick is configured.
    pub robot: RobotSettings,
    /// How the real robot differs from that.
    pub errors: ErrorSettings,
    /// The gyro.
    pub gyro: GyroSettings,
    /// The accelerometers at the wheels.
    pub accelerometer: AccelerometerSettings,
    /// The brick's clock and telemetry.
    pub brick: BrickSettings,
    /// The overhead camera.
    pub camera: CameraSettings,
    /// A thermometer on the brick, if there is one.
    #[serde(deserialize_with = "thermometer::checked")]
    pub thermometer: Option<ThermometerSettings>,
}

impl Scenario {
    /// Reads a scenario from TOML that names no other file; its way-points stand in `points_m`.
    ///
    /// # Errors
    /// [`ScenarioError::Toml`] and [`ScenarioError::Waypoints`] name the line and the key that is unknown, missing, of the wrong
    /// type or out of its range; [`ScenarioError::WaypointsUnread`] says that a `file` of way-points cannot be had from here.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        Self::from_toml_with(text, &mut |_| Err(io::Error::other(TEXT_ALONE)))
    }

    /// Reads a scenario from TOML, whose `[path.waypoints]` may name a `file` of lines `x_m,y_m`. `read` is given that path as it
    /// is written, so that the caller decides what it is relative to, and is called at most once. The scenario holds the points.
    ///
    /// # Errors
    /// As for [`Self::from_toml`]; [`ScenarioError::WaypointsUnread`] if `read` fails, [`ScenarioError::WaypointsFile`] with the
    /// line of the file that is no way-point, or out of range, or one too few or too many.
    pub fn from_toml_with(
        text: &str,
        read: &mut dyn FnMut(&Path) -> io::Result<String>,
    ) -> Result<Self, ScenarioError> {
        waypoints::parse_with_file(text, read)
    }

    /// The bundled scenario of this name, if there is one.
    ///
    /// # Errors
    /// [`ScenarioError::UnknownName`] lists the names that exist.
    pub fn bundled(name: &str) -> Result<Self, ScenarioError> {
        let text =
            text_of(BUNDLED, name).map_err(|known| ScenarioError::UnknownName { name: name.to_owned(), known })?;
        Self::from_toml(text)
    }

    /// The same scenario under another seed.
    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// The same scenario, steered by something else.
    pub const fn with_steering(mut self, steering: Steering) -> Self {
        self.steering = steering;
        self
    }

    /// The same scenario with a brick of another protocol.
    pub const fn with_personality(mut self, personality: Personality) -> Self {
        self.brick.personality = personality;
        self
    }

    /// The same scenario over another number of laps; at least one.
    pub fn with_laps(mut self, laps: u32) -> Self {
        self.drive.laps = laps.clamp(1, checks::MAX_LAPS);
        self
    }

    /// The same scenario, driven lap after lap without an end.
    pub const fn without_end(mut self) -> Self {
        self.drive.end = DriveEnd::Never;
        self
    }

    /// The drive as the brick is configured.
    pub fn drive_geometry(&self) -> DriveGeometry {
        DriveGeometry {
            left_wheel_radius: Meters(self.robot.wheel_radius_m),
            right_wheel_radius: Meters(self.robot.wheel_radius_m),
            track_width: Meters(self.robot.track_width_m),
            tick: Radians(TICK_RAD),
        }
    }

    /// The noise with which sensors and motion are simulated, one standard deviation each.
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

/// One encoder count: NXT and EV3 motors resolve one degree of the output shaft.
pub(crate) const TICK_RAD: f64 = std::f64::consts::PI / 180.0;

/// Why a scenario without files beside it cannot have one.
const TEXT_ALONE: &str = "this scenario is read without files beside it; write the points into points_m";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_text_is_the_default_scenario() {
        assert_eq!(Scenario::from_toml("").expect("defaults"), Scenario::default());
    }

    #[test]
    fn every_bundled_scenario_reads() {
        for (name, text) in BUNDLED {
            let read = Scenario::from_toml(text);
            assert!(read.is_ok(), "{name}: {read:?}");
        }
    }

    #[test]
    fn an_unknown_bundled_name_lists_the_known_ones() {
        let message = Scenario::bundled("triangle").expect_err("there is no triangle").to_string();
        assert!(message.contains("triangle") && message.contains("figure-eight"), "{message}");
    }

    #[test]
    fn errors_name_the_line_and_the_key() {
        let cases = [
            ("seed = 1\nspeling = 3\n", "line 2", "speling"),
            ("[robot]\n\ntrack_width_m = -0.1\n", "line 3", "track_width_m"),
            ("[camera]\nrate_hz = \"fast\"\n", "line 2", "rate_hz"),
            ("[path.square]\nside_m = nan\n", "line 2", "side_m"),
            ("[path.waypoints]\npoints_m = [[0, 0]]\n", "line 2", "points_m"),
            ("[path.spiral]\n", "line 1", "spiral"),
        ];
        for (text, line, key) in cases {
            let message = Scenario::from_toml(text).expect_err("the text is wrong").to_string();
            assert!(message.contains(line), "{message} lacks {line}");
            assert!(message.contains(key), "{message} lacks {key}");
        }
    }
}
