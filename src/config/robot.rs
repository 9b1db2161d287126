//! A robot as a file describes it: geometry, noise, start.

use anyhow::{Result, ensure};
use posebridge_estimator::StartPose;
use posebridge_telemetry::{DriveGeometry, Heading, Meters, Pose, Radians, SensorNoise};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// A robot's geometry and noise; `[robot]` of a configuration, of a robot profile and of a recording's descriptor.
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
    /// Believe the robot's own description, when it sends one, more than this file.
    pub adopt_description: bool,
    /// Noise of motion and sensors.
    pub noise: RobotNoise,
    /// Where it starts; without it the first fixes decide.
    pub start: Option<RobotStart>,
}

/// Noise, one standard deviation each.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RobotNoise {
    /// Each wheel's travel, for itself.
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Distance along the track, common to both wheels.
    pub travel_m_per_sqrt_m: f64,
    /// Heading, by turning.
    pub turn_rad_per_sqrt_rad: f64,
    /// Heading, by driving.
    pub heading_rad_per_sqrt_m: f64,
    /// Gyro, white, per sample.
    pub gyro_rad_per_s: f64,
    /// Gyro's step; 0 if fine.
    pub gyro_resolution_rad_per_s: f64,
    /// Gyro's bias at power-up.
    pub gyro_bias_rad_per_s: f64,
    /// Random walk of the gyro's bias.
    pub gyro_bias_walk_rad_per_s_sqrt_s: f64,
    /// A fix's position, each axis.
    pub fix_position_m: f64,
    /// A fix's heading.
    pub fix_heading_rad: f64,
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
            start: None,
        }
    }
}

impl Default for RobotNoise {
    /// A LEGO NXT with HiTechnic gyro under an overhead camera; sources in config/default.toml.
    fn default() -> Self {
        Self {
            wheel_travel_m_per_sqrt_m: 0.001,
            travel_m_per_sqrt_m: 0.005,
            turn_rad_per_sqrt_rad: 0.02,
            heading_rad_per_sqrt_m: 0.03,
            gyro_rad_per_s: DEGREE,
            gyro_resolution_rad_per_s: DEGREE,
            gyro_bias_rad_per_s: 2.0 * DEGREE,
            gyro_bias_walk_rad_per_s_sqrt_s: 0.01 * DEGREE,
            fix_position_m: 0.005,
            fix_heading_rad: DEGREE,
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
            ensure!(
                value.is_finite() && value > 0.0,
                "`robot.{key}` is {value}, must be a positive number"
            );
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
        let n = &self.noise;
        for (key, value, may_be_zero) in [
            (
                "wheel_travel_m_per_sqrt_m",
                n.wheel_travel_m_per_sqrt_m,
                true,
            ),
            ("travel_m_per_sqrt_m", n.travel_m_per_sqrt_m, true),
            ("turn_rad_per_sqrt_rad", n.turn_rad_per_sqrt_rad, true),
            ("heading_rad_per_sqrt_m", n.heading_rad_per_sqrt_m, true),
            ("gyro_rad_per_s", n.gyro_rad_per_s, true),
            (
                "gyro_resolution_rad_per_s",
                n.gyro_resolution_rad_per_s,
                true,
            ),
            ("gyro_bias_rad_per_s", n.gyro_bias_rad_per_s, true),
            (
                "gyro_bias_walk_rad_per_s_sqrt_s",
                n.gyro_bias_walk_rad_per_s_sqrt_s,
                true,
            ),
            ("fix_position_m", n.fix_position_m, false),
            ("fix_heading_rad", n.fix_heading_rad, false),
        ] {
            let is_good = value.is_finite() && (value > 0.0 || (may_be_zero && value == 0.0));
            let wanted = if may_be_zero {
                "zero or more"
            } else {
                "more than zero"
            };
            ensure!(is_good, "`robot.noise.{key}` is {value}, must be {wanted}");
        }
        Ok(SensorNoise {
            wheel_travel_m_per_sqrt_m: n.wheel_travel_m_per_sqrt_m,
            travel_m_per_sqrt_m: n.travel_m_per_sqrt_m,
            turn_rad_per_sqrt_rad: n.turn_rad_per_sqrt_rad,
            heading_rad_per_sqrt_m: n.heading_rad_per_sqrt_m,
            gyro_rad_per_s: n.gyro_rad_per_s,
            gyro_resolution_rad_per_s: n.gyro_resolution_rad_per_s,
            gyro_bias_rad_per_s: n.gyro_bias_rad_per_s,
            gyro_bias_walk_rad_per_s_sqrt_s: n.gyro_bias_walk_rad_per_s_sqrt_s,
            fix_position_m: n.fix_position_m,
            fix_heading_rad: n.fix_heading_rad,
            ..SensorNoise::EXACT
        })
    }

    /// Start in the vocabulary's types.
    ///
    /// # Errors
    /// A standard deviation is not positive.
    pub fn start(&self) -> Result<Option<StartPose>> {
        let Some(start) = self.start else {
            return Ok(None);
        };
        for (key, value) in [
            ("position_sigma_m", start.position_sigma_m),
            ("heading_sigma_deg", start.heading_sigma_deg),
        ] {
            ensure!(
                value.is_finite() && value > 0.0,
                "`robot.start.{key}` is {value}, must be more than zero"
            );
        }
        let heading = Heading::from_rad(start.heading_deg.to_radians());
        Ok(Some(StartPose {
            pose: Pose::new(Meters(start.x_m), Meters(start.y_m), heading),
            position_sigma_m: start.position_sigma_m,
            heading_sigma_rad: start.heading_sigma_deg.to_radians(),
        }))
    }
}
