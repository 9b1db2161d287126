//! The properties of a robot: its geometry, the noise of its sensors, what a filter has learned of them, and the map of its arena.

use std::collections::BTreeMap;
use std::ops::{Index, IndexMut};

use serde::{Deserialize, Serialize};

use crate::ids::{BeaconId, LandmarkId};
use crate::quantities::{Meters, Radians};
use crate::spaces::{Arena, Point2, Pose};

/// A differential drive: two driven wheels on one axle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveGeometry {
    pub left_wheel_radius: Meters,
    pub right_wheel_radius: Meters,
    /// Distance between the wheels' contact points.
    pub track_width: Meters,
    /// Wheel rotation of one encoder count.
    pub tick: Radians,
}

/// Noise of a robot's sensors and of its motion, one standard deviation unless the name says variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorNoise {
    /// Of one wheel; grows with the square root of its path.
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Along the track, common to both wheels; grows with the square root of the path.
    pub travel_m_per_sqrt_m: f64,
    /// Of the heading; grows with the square root of the turn.
    pub turn_rad_per_sqrt_rad: f64,
    /// Of the heading; grows with the square root of the path.
    pub heading_rad_per_sqrt_m: f64,
    /// Along the track; grows with the square root of the time in which the wheels turn.
    pub travel_m_per_sqrt_s: f64,
    /// Of the heading; grows with the square root of the time in which the wheels turn.
    pub heading_rad_per_sqrt_s: f64,
    /// White noise per sample.
    pub gyro_rad_per_s: f64,
    /// 0 where the resolution is finer than the noise.
    pub gyro_resolution_rad_per_s: f64,
    /// At power-up.
    pub gyro_bias_rad_per_s: f64,
    pub gyro_bias_walk_rad_per_s_sqrt_s: f64,
    /// Each axis, where the fix does not bring its own covariance.
    pub fix_position_m: f64,
    /// Where the fix does not bring its own covariance.
    pub fix_heading_rad: f64,
    /// Each axis of an error that all fixes of one source share, in addition to their own; 0 for none.
    pub fix_persistent_m: f64,
    /// The path after which the correlation of that error has fallen to 1/e.
    pub fix_persistence_m: f64,
    /// At one wheel, per sample.
    pub accelerometer_m_per_s2: f64,
    pub compass_rad: f64,
    pub landmark_range_m: f64,
    /// The part of the range's noise that is proportional to the range.
    pub landmark_range_share: f64,
    pub landmark_bearing_rad: f64,
    /// Each axis of a landmark's position in the map.
    pub landmark_place_m: f64,
    pub beacon_range_m: f64,
    /// The part of the range's noise that is proportional to the range.
    pub beacon_range_share: f64,
    pub wall_range_m: f64,
    pub temperature_k: f64,
}

impl SensorNoise {
    /// No noise: the base for a robot's own numbers.
    pub const EXACT: Self = Self {
        wheel_travel_m_per_sqrt_m: 0.0,
        travel_m_per_sqrt_m: 0.0,
        turn_rad_per_sqrt_rad: 0.0,
        heading_rad_per_sqrt_m: 0.0,
        travel_m_per_sqrt_s: 0.0,
        heading_rad_per_sqrt_s: 0.0,
        gyro_rad_per_s: 0.0,
        gyro_resolution_rad_per_s: 0.0,
        gyro_bias_rad_per_s: 0.0,
        gyro_bias_walk_rad_per_s_sqrt_s: 0.0,
        fix_position_m: 0.0,
        fix_heading_rad: 0.0,
        fix_persistent_m: 0.0,
        fix_persistence_m: 1.0,
        accelerometer_m_per_s2: 0.0,
        compass_rad: 0.0,
        landmark_range_m: 0.0,
        landmark_range_share: 0.0,
        landmark_bearing_rad: 0.0,
        landmark_place_m: 0.0,
        beacon_range_m: 0.0,
        beacon_range_share: 0.0,
        wall_range_m: 0.0,
        temperature_k: 0.0,
    };
}

/// A number with one standard deviation; a sigma of zero means that it is fixed and not estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UncertainValue {
    pub value: f64,
    pub sigma: f64,
}

/// The systematic errors of a robot and of the sensors that watch it: as a prior in a filter's configuration, as a result in
/// its report.
///
/// The true left wheel's radius is `r_L (1 + radius_scale - radius_difference / 2)`, the right one's
/// `r_R (1 + radius_scale + radius_difference / 2)`, the true track width `b (1 + track_scale)`, with the nominal geometry
/// r_L, r_R, b. For a robot that reports speeds or an odometer's pose the same numbers scale distance and turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calibration {
    pub radius_scale: UncertainValue,
    pub radius_difference: UncertainValue,
    pub track_scale: UncertainValue,
    pub gyro_bias_rad_per_s: UncertainValue,
    /// Relative error of the gyro's rate; positive reads fast.
    pub gyro_scale: UncertainValue,
    /// Total play between each encoder and its wheel.
    pub backlash_rad: UncertainValue,
    /// How much earlier than its timestamp the motion of an odometer happened. Negative for commands, which are carried out later.
    pub odometry_delay_s: UncertainValue,
    /// How much earlier than its timestamp a fix was measured.
    pub fix_delay_s: UncertainValue,
    /// Error of the tag's configured position.
    pub tag_forward_m: UncertainValue,
    pub tag_left_m: UncertainValue,
    /// Offset of each beacon's ranges; positive reads long.
    pub beacon_offset_m: UncertainValue,
    /// Relative error of each beacon's ranges.
    pub beacon_scale: UncertainValue,
    /// Offset of the robot camera's ranges to landmarks; positive reads long.
    pub landmark_offset_m: UncertainValue,
    /// Relative error of the camera's ranges to landmarks.
    pub landmark_scale: UncertainValue,
    /// How much earlier than its timestamp a sighting of a landmark was measured.
    pub landmark_delay_s: UncertainValue,
    pub beacon_delay_s: UncertainValue,
    /// Of the ranges to walls.
    pub range_delay_s: UncertainValue,
    pub compass_delay_s: UncertainValue,
    pub mountings: Mountings,
}

/// A sensor whose place on the robot is configured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountedSensor {
    /// The camera or scanner that measures range and bearing of landmarks.
    Landmarks,
    /// The radio tag whose range to beacons is measured.
    Beacons,
    /// The range finder that measures walls.
    Range,
    Compass,
    /// The accelerometers.
    Imu,
}

impl MountedSensor {
    pub const ALL: [Self; 5] = [Self::Landmarks, Self::Beacons, Self::Range, Self::Compass, Self::Imu];

    /// In configuration keys.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Landmarks => "landmarks",
            Self::Beacons => "beacons",
            Self::Range => "range",
            Self::Compass => "compass",
            Self::Imu => "imu",
        }
    }
}

/// A sensor's pose in the body's frame, whose origin is mid-axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounting {
    /// Forward of the axle.
    pub x_m: UncertainValue,
    /// To the left.
    pub y_m: UncertainValue,
    /// Of the sensor's x axis, counter-clockwise from forward.
    pub yaw_rad: UncertainValue,
}

/// The mounting of every sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mountings([Mounting; MountedSensor::ALL.len()]);

impl Index<MountedSensor> for Mountings {
    type Output = Mounting;

    fn index(&self, sensor: MountedSensor) -> &Mounting {
        &self.0[sensor as usize]
    }
}

impl IndexMut<MountedSensor> for Mountings {
    fn index_mut(&mut self, sensor: MountedSensor) -> &mut Mounting {
        &mut self.0[sensor as usize]
    }
}

/// Where a robot starts, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StartPose {
    pub pose: Pose<Arena>,
    /// One standard deviation of x and of y.
    pub position_sigma_m: f64,
    /// One standard deviation.
    pub heading_sigma_rad: f64,
}

/// The positions of landmarks, beacons and walls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArenaMap {
    /// Points that a robot's camera identifies.
    pub landmarks: BTreeMap<LandmarkId, Point2<Arena>>,
    pub beacons: BTreeMap<BeaconId, Point2<Arena>>,
    /// Walls that a range sensor measures.
    pub walls: Vec<Wall>,
}

/// A straight wall between two points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wall {
    pub from: Point2<Arena>,
    pub to: Point2<Arena>,
}
