//! The configured properties of a robot: its geometry and the noise of its sensors.

use crate::quantities::{Meters, Radians};

/// A differential drive: two driven wheels on one axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveGeometry {
    /// Radius of the left wheel.
    pub left_wheel_radius: Meters,
    /// Radius of the right wheel.
    pub right_wheel_radius: Meters,
    /// Distance between the wheels' contact points.
    pub track_width: Meters,
    /// Wheel rotation of one encoder count.
    pub tick: Radians,
}

/// Noise of a robot's sensors and of its motion, one standard deviation unless the name says variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorNoise {
    /// Wheel travel: sigma of one wheel grows with the square root of its path, in m per sqrt(m).
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Distance along the track, common to both wheels: sigma grows with the square root of the path, in m per sqrt(m).
    pub travel_m_per_sqrt_m: f64,
    /// Heading: sigma grows with the square root of the turn, in rad per sqrt(rad).
    pub turn_rad_per_sqrt_rad: f64,
    /// Heading: sigma grows with the square root of the path, in rad per sqrt(m).
    pub heading_rad_per_sqrt_m: f64,
    /// Gyro white noise per sample, in rad/s.
    pub gyro_rad_per_s: f64,
    /// Resolution of the gyro, in rad/s; 0 when it is fine.
    pub gyro_resolution_rad_per_s: f64,
    /// Sigma of the gyro bias at power-up, in rad/s.
    pub gyro_bias_rad_per_s: f64,
    /// Random walk of the gyro bias, in rad/s per sqrt(s).
    pub gyro_bias_walk_rad_per_s_sqrt_s: f64,
    /// A fix's position, each axis, in m, where the fix does not bring its own covariance.
    pub fix_position_m: f64,
    /// A fix's heading, in rad, where the fix does not bring its own covariance.
    pub fix_heading_rad: f64,
    /// An accelerometer at a wheel, per sample, in m/s².
    pub accelerometer_m_per_s2: f64,
    /// A compass heading, in rad.
    pub compass_rad: f64,
    /// The range to a landmark, in m.
    pub landmark_range_m: f64,
    /// The bearing of a landmark, in rad.
    pub landmark_bearing_rad: f64,
    /// The range to a beacon, in m.
    pub beacon_range_m: f64,
    /// The range to a wall, in m.
    pub wall_range_m: f64,
    /// A thermometer, in K.
    pub temperature_k: f64,
}

impl SensorNoise {
    /// No noise: the base for a robot's own numbers.
    pub const EXACT: Self = Self {
        wheel_travel_m_per_sqrt_m: 0.0,
        travel_m_per_sqrt_m: 0.0,
        turn_rad_per_sqrt_rad: 0.0,
        heading_rad_per_sqrt_m: 0.0,
        gyro_rad_per_s: 0.0,
        gyro_resolution_rad_per_s: 0.0,
        gyro_bias_rad_per_s: 0.0,
        gyro_bias_walk_rad_per_s_sqrt_s: 0.0,
        fix_position_m: 0.0,
        fix_heading_rad: 0.0,
        accelerometer_m_per_s2: 0.0,
        compass_rad: 0.0,
        landmark_range_m: 0.0,
        landmark_bearing_rad: 0.0,
        beacon_range_m: 0.0,
        wall_range_m: 0.0,
        temperature_k: 0.0,
    };
}
