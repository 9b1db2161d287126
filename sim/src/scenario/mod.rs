//! The configuration of a simulation: path, robot with its errors, sensors, clock and camera.
//!
//! A scenario is one TOML text; every key has a default and every number names its unit. `docs/simulator.md` holds the table of keys
//! with the sources of the defaults. The caller reads files.

mod course;
mod loading;
mod robot;
mod sensors;
mod side_by_side;

use std::io;
use std::path::Path;

use posebridge_telemetry::{DriveGeometry, Meters, Radians, SensorNoise};
use serde::Deserialize;

use crate::checks;
use crate::config_file::bundled_text;

pub use course::{Course, Direction, DriveEnd, DriveSettings, StartPose};
pub use loading::ScenarioError;
pub use robot::{
    BrickProgram, BrickSettings, ErrorSettings, MissingSensor, MotorSettings, Personality, PortSensor, RobotSettings,
    Wire,
};
pub use sensors::{
    AccelerometerSettings, Blackout, CameraImages, CameraOrder, CameraSettings, GyroSettings, ThermometerSettings,
};

/// Name and TOML text of every bundled scenario. Adding one: a file in `config/scenarios/` and a line here.
pub const BUNDLED: &[(&str, &str)] = &[
    ("square", include_str!("../../../config/scenarios/square.toml")),
    ("circle", include_str!("../../../config/scenarios/circle.toml")),
    ("figure-eight", include_str!("../../../config/scenarios/figure-eight.toml")),
    ("waypoints", include_str!("../../../config/scenarios/waypoints.toml")),
    ("straight", include_str!("../../../config/scenarios/straight.toml")),
    ("rough", include_str!("../../../config/scenarios/rough.toml")),
    ("thermometer", include_str!("../../../config/scenarios/thermometer.toml")),
];

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

/// The configuration of a simulation.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    pub seed: u64,
    pub steering: Steering,
    /// In its own space; [`StartPose`] places it in the arena.
    pub path: Course,
    /// Origin and direction of the path.
    pub start: StartPose,
    pub drive: DriveSettings,
    /// As its brick is configured.
    pub robot: RobotSettings,
    /// Deviations of the real robot from `robot`.
    pub errors: ErrorSettings,
    pub gyro: GyroSettings,
    pub accelerometer: AccelerometerSettings,
    /// Clock and telemetry.
    pub brick: BrickSettings,
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

    /// At least one.
    pub fn with_laps(mut self, laps: u32) -> Self {
        self.drive.laps = laps.clamp(1, checks::MAX_LAPS);
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

    #[test]
    fn errors_name_the_line_and_the_key() {
        for (text, line, key) in [
            ("seed = 1\nspeling = 3\n", 2, "speling"),
            ("[robot]\n\ntrack_width_m = -0.1\n", 3, "track_width_m"),
            ("[camera]\nrate_hz = \"fast\"\n", 2, "rate_hz"),
            ("[path.square]\nside_m = nan\n", 2, "side_m"),
            ("[path.waypoints]\npoints_m = [[0, 0]]\n", 2, "points_m"),
            ("[path.spiral]\n", 1, "spiral"),
            ("[drive]\nlaps = 10001\n", 2, "laps"),
            ("[brick]\nsystem = 251\n", 2, "system"),
            ("[brick]\nclock_start_micros = 281474976710656\n", 2, "2^48"),
            ("[brick]\nclock_tick_micros = 0\n", 2, "tick"),
            ("[brick]\ntelegram_bytes = 129\n", 2, "telegram"),
            ("[thermometer]\nchannel = \"water\"\n", 2, "temp"),
            ("[thermometer]\nchannel = \"temperature1\"\n", 2, "temp"),
            ("[thermometer]\nlags_s = []\n", 2, "time constants"),
            ("[thermometer]\nlags_s = [0.0, 3.0]\n", 2, "time constants"),
            ("[thermometer]\nshares = [0.5, 0.6]\n", 2, "sum up to 1"),
            ("[thermometer]\nlags_s = [3.0]\n", 1, "one share for each lag"),
            ("[thermometer]\nafter_c = -300.0\n", 2, "after_c"),
            ("[thermometer]\nlag_s = 3.0\n", 2, "lag_s"),
        ] {
            let message = Scenario::from_toml(text).unwrap_err().to_string();
            assert!(
                message.contains(&format!("line {line}")) && message.contains(key),
                "{message} lacks line {line} or {key}"
            );
        }
    }
}
