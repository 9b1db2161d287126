//! A robot as a file describes it: geometry, noise, calibration, start.

use anyhow::{Result, ensure};
use posebridge_estimator::StartPose;
use posebridge_telemetry::{Calibration, DriveGeometry, Heading, Meters, Pose, Radians, SensorNoise};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bricks::{Ev3Section, LineSection, NxtSection};
use super::calibration::RobotCalibration;
use super::noise::RobotNoise;
use super::thermometer::RobotThermometer;

/// A robot's geometry, noise and calibration; `[robot]` of a configuration, of a robot profile and of a recording's descriptor.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RobotFile {
    /// Its name, for people.
    pub name: String,
    /// Radius of the left wheel.
    pub left_wheel_radius_m: f64,
    /// Radius of the right wheel.
    pub right_wheel_radius_m: f64,
    /// Distance between the wheels' contact points.
    pub track_width_m: f64,
    /// Encoder counts per turn of a wheel.
    pub ticks_per_turn: f64,
    /// Let the robot's own description, when it sends one, override this file.
    pub adopt_description: bool,
    /// Noise of motion and sensors.
    pub noise: RobotNoise,
    /// Systematic errors, and how well they are known.
    pub calibration: RobotCalibration,
    /// Where it starts; without it the first fixes decide.
    pub start: Option<RobotStart>,
    /// A LEGO NXT's motors and sensors, for a link with brick = "nxt" or "nxt-push".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nxt: Option<NxtSection>,
    /// A LEGO EV3's motors and sensors, for a link with brick = "ev3".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ev3: Option<Ev3Section>,
    /// The lines of a board that prints, for a link with brick = "line".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<LineSection>,
    /// Its thermometers, as far as they are known.
    #[serde(rename = "thermometer", skip_serializing_if = "Vec::is_empty")]
    pub thermometers: Vec<RobotThermometer>,
}

/// Where a robot starts, and how well that is known.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RobotStart {
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
    /// Counter-clockwise from east.
    pub heading_deg: f64,
    /// One standard deviation of x and of y.
    pub position_sigma_m: f64,
    /// One standard deviation of the heading.
    pub heading_sigma_deg: f64,
}

impl Default for RobotFile {
    /// The LEGO NXT of the bundled scenarios: 56 mm wheels, 112 mm track, encoders of one degree.
    fn default() -> Self {
        Self {
            name: "nxt-56mm".to_owned(),
            left_wheel_radius_m: 0.028,
            right_wheel_radius_m: 0.028,
            track_width_m: 0.112,
            ticks_per_turn: 360.0,
            adopt_description: true,
            noise: RobotNoise::default(),
            calibration: RobotCalibration::default(),
            start: None,
            nxt: None,
            ev3: None,
            line: None,
            thermometers: Vec::new(),
        }
    }
}

impl RobotFile {
    /// Geometry in the vocabulary's types.
    ///
    /// # Errors
    /// A length or a count is not positive.
    pub fn geometry(&self) -> Result<DriveGeometry> {
        for (key, value) in [
            ("left_wheel_radius_m", self.left_wheel_radius_m),
            ("right_wheel_radius_m", self.right_wheel_radius_m),
            ("track_width_m", self.track_width_m),
            ("ticks_per_turn", self.ticks_per_turn),
        ] {
            ensure!(value.is_finite() && value > 0.0, "`robot.{key}` is {value}, must be a positive number");
        }
        Ok(DriveGeometry {
            left_wheel_radius: Meters(self.left_wheel_radius_m),
            right_wheel_radius: Meters(self.right_wheel_radius_m),
            track_width: Meters(self.track_width_m),
            tick: Radians(std::f64::consts::TAU / self.ticks_per_turn),
        })
    }

    /// Noise in the vocabulary's types.
    ///
    /// # Errors
    /// A standard deviation is negative, or one that must not be zero is.
    pub fn noise(&self) -> Result<SensorNoise> {
        self.noise.checked()
    }

    /// What is known of systematic errors, in the vocabulary's types.
    ///
    /// # Errors
    /// A value or a sigma is out of its range.
    pub fn calibration(&self) -> Result<Calibration> {
        self.calibration.checked(self.noise.gyro_bias_rad_per_s)
    }

    /// Start in the vocabulary's types.
    ///
    /// # Errors
    /// A standard deviation is not positive.
    pub fn start(&self) -> Result<Option<StartPose>> {
        let Some(start) = self.start else {
            return Ok(None);
        };
        for (key, value) in
            [("position_sigma_m", start.position_sigma_m), ("heading_sigma_deg", start.heading_sigma_deg)]
        {
            ensure!(value.is_finite() && value > 0.0, "`robot.start.{key}` is {value}, must be more than zero");
        }
        let heading = Heading::from_rad(start.heading_deg.to_radians());
        Ok(Some(StartPose {
            pose: Pose::new(Meters(start.x_m), Meters(start.y_m), heading),
            position_sigma_m: start.position_sigma_m,
            heading_sigma_rad: start.heading_sigma_deg.to_radians(),
        }))
    }
}
