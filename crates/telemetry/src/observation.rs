//! Observations of sensors in SI units and typed coordinate frames, independent of wire formats.

use serde::{Deserialize, Serialize};

use crate::clock::{BrickClock, TimeDelta, Timestamp};
use crate::ids::{BeaconId, LandmarkId, SensorId};
use crate::quantities::{Celsius, Heading, Meters, MetersPerSecond, MetersPerSecondSquared, Radians, RadiansPerSecond};
use crate::spaces::{Arena, Body, Odom, Point2, Pose};

/// One observation, aligned to the brick's clock: the estimator's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    pub sensor: SensorId,
    /// The instant of the measurement: end of the interval for counters and rates, middle of the exposure for images.
    pub stamp: Timestamp<BrickClock>,
    /// How far `stamp` may be off (one standard deviation), from the alignment of the clocks.
    pub stamp_sigma: TimeDelta,
    pub measurement: ObservationKind,
}

/// Whether the observations of a sensor are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorSwitch {
    On,
    Off,
}

/// The kinds of observation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ObservationKind {
    /// Total rotation of each wheel since the counters were zeroed, forward positive. A jump to zero re-bases; it is
    /// not motion.
    WheelAngles {
        left: Radians,
        right: Radians,
    },
    /// The pose that a foreign odometer has integrated; only its increments are used.
    OdometerPose(Pose<Odom>),
    /// Forward and turn speed, commanded or measured by a foreign odometer, held until the next one.
    BodyVelocity {
        /// Along the body's x axis.
        forward: MetersPerSecond,
        /// About the vertical.
        turn: RadiansPerSecond,
    },
    /// Mean turn rate since the sensor's previous observation, bias included.
    TurnRate(RadiansPerSecond),
    /// Forward acceleration at each wheel.
    WheelAccelerations {
        left: MetersPerSecondSquared,
        right: MetersPerSecondSquared,
    },
    /// A position or a pose in the arena, seen from outside.
    Fix(Fix),
    /// Range and bearing to a landmark of known position.
    Landmark {
        id: LandmarkId,
        /// Distance from the sensor, which sits at the body's origin.
        range: Meters,
        /// In the body's frame, counter-clockwise from forward.
        bearing: Radians,
    },
    /// Range to a beacon of known position.
    BeaconRange {
        id: BeaconId,
        /// The distance as measured, bias and scale included.
        range: Meters,
    },
    /// Range straight ahead to the nearest object.
    WallRange(Meters),
    /// Heading against the arena, from a compass.
    CompassHeading(Heading),
    Temperature(Celsius),
}

impl ObservationKind {
    /// The kind's name, as used in reports and in the configuration.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::WheelAngles { .. } => "wheel_angles",
            Self::OdometerPose(_) => "odometer_pose",
            Self::BodyVelocity { .. } => "body_velocity",
            Self::TurnRate(_) => "turn_rate",
            Self::WheelAccelerations { .. } => "wheel_accelerations",
            Self::Fix(_) => "fix",
            Self::Landmark { .. } => "landmark",
            Self::BeaconRange { .. } => "beacon_range",
            Self::WallRange(_) => "wall_range",
            Self::CompassHeading(_) => "compass_heading",
            Self::Temperature(_) => "temperature",
        }
    }
}

/// A position in the arena with an optional heading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fix {
    /// Position of the observed point (the tag).
    pub position: Point2<Arena>,
    /// Heading of the body, if the observer measures it.
    pub heading: Option<Heading>,
    /// Covariance as reported by the observer; `None` means the configured noise.
    pub covariance: Option<PositionCovariance>,
    /// The observed point in the body's space: the lever arm from mid-axle to the tag.
    pub tag_in_body: Point2<Body>,
    /// Counts the observer's own jumps (a re-localised tracker); a change is not motion.
    pub reset_counter: u8,
}

/// Covariance of a fix, in the arena: the upper triangle of x, y, heading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PositionCovariance {
    pub xx_m2: f64,
    pub xy_m2: f64,
    pub yy_m2: f64,
    /// Infinite without a heading.
    pub heading_rad2: f64,
}
