//! Estimates: a robot's pose or a single quantity at one instant, with its uncertainty.

use serde::{Deserialize, Serialize};

use crate::clock::{BrickClock, TimeDelta, Timestamp};
use crate::ellipse::Ellipse;
use crate::quantities::{MetersPerSecond, Radians, RadiansPerSecond};
use crate::robot::StartPose;
use crate::spaces::{Arena, Pose};

/// Rows of [`Estimate::covariance`].
pub mod row {
    /// x in the arena, m.
    pub const X: usize = 0;
    /// y in the arena, m.
    pub const Y: usize = 1;
    /// Heading, rad.
    pub const HEADING: usize = 2;
    /// Forward speed, m/s.
    pub const FORWARD: usize = 3;
    /// Turn rate, rad/s.
    pub const TURN: usize = 4;
}

/// The pose of a robot with its speeds, covariance and provenance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub stamp: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
    /// Along the body's x axis.
    pub forward_speed: MetersPerSecond,
    /// About the vertical, bias removed.
    pub turn_rate: RadiansPerSecond,
    /// 5 x 5, symmetric, SI units squared, rows and columns as in [`row`].
    pub covariance: [[f64; 5]; 5],
    pub validity: Validity,
    /// No absolute observation was used for longer than the configured limit.
    pub is_dead_reckoning: bool,
    /// Time since the last fix that was used, at `stamp`; `None` before the first.
    pub fix_age: Option<TimeDelta>,
    /// Counts jumps of the estimate that are not motion.
    pub reset_counter: u8,
    pub last_correction: Option<PoseCorrection>,
    /// `None` while the pose is known, and from a filter that does not say.
    pub missing: Option<MissingObservation>,
}

/// What a robot whose pose is not known must observe next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MissingObservation {
    /// Nothing that tells a position was observed.
    Position,
    /// One landmark was sighted, or two too close to each other.
    SecondLandmark,
    /// Fewer than three beacons were in reach.
    ThirdBeacon,
    /// What was observed fits any heading: the robot has to drive.
    Motion,
}

impl MissingObservation {
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Position => "needs a fix, two landmarks or three beacons",
            Self::SecondLandmark => "needs a second landmark, 0.3 m or more from the first",
            Self::ThirdBeacon => "needs ranges to three beacons that are not in line",
            Self::Motion => "needs to drive, for its heading",
        }
    }
}

impl Estimate {
    /// Whether pose, speeds and covariance are finite.
    pub fn is_finite(&self) -> bool {
        let Self { pose, forward_speed, turn_rate, covariance, .. } = self;
        let numbers = [pose.x.0, pose.y.0, pose.heading.rad(), forward_speed.0, turn_rate.0];
        numbers.iter().chain(covariance.as_flattened()).all(|number| number.is_finite())
    }

    /// Whether the pose counts from where the robot was when its motion was first observed, and not in the arena: until an
    /// absolute observation, or a pose that was given. The covariance is that of the motion since then.
    pub const fn is_relative(&self) -> bool {
        !self.validity.position
    }

    /// A start at this pose with its uncertainty; `None` unless position and heading are valid.
    pub fn start_pose(&self) -> Option<StartPose> {
        (self.validity.position && self.validity.heading).then(|| StartPose {
            pose: self.pose,
            position_sigma_m: self.x_sigma_m().max(self.y_sigma_m()),
            heading_sigma_rad: self.heading_sigma_rad(),
        })
    }

    /// What happened to the pose, in words.
    pub fn describe_reset(&self) -> String {
        let Some(PoseCorrection { dx_m, dy_m, turn, cause }) = self.last_correction else {
            return "pose reset".to_owned();
        };
        let Pose { x, y, heading, .. } = self.pose;
        match cause {
            ResetCause::Located => format!("pose found in the arena: x {:.3} m, y {:.3} m", x.0, y.0),
            ResetCause::Relocated => {
                let (moved_m, turned_deg) = (dx_m.hypot(dy_m), turn.0.to_degrees());
                format!("pose reset: moved by {moved_m:.3} m, turned by {turned_deg:.1} deg")
            }
            ResetCause::Given => {
                format!("pose set: x {:.3} m, y {:.3} m, heading {:.1} deg", x.0, y.0, heading.rad().to_degrees())
            }
            ResetCause::Discarded => "pose discarded: it counts from here".to_owned(),
        }
    }

    /// The ellipse that holds the position with a probability of 95 %; `None` if the covariance is not positive
    /// semi-definite.
    pub fn ellipse_95(&self) -> Option<Ellipse> {
        let [[xx_m2, xy_m2, ..], [_, yy_m2, ..], ..] = self.covariance;
        Ellipse::from_covariance(xx_m2, xy_m2, yy_m2, Ellipse::SIGMAS_95)
    }

    pub fn x_sigma_m(&self) -> f64 {
        self.covariance[row::X][row::X].max(0.0).sqrt()
    }
    pub fn y_sigma_m(&self) -> f64 {
        self.covariance[row::Y][row::Y].max(0.0).sqrt()
    }
    pub fn heading_sigma_rad(&self) -> f64 {
        self.covariance[row::HEADING][row::HEADING].max(0.0).sqrt()
    }
}

/// The valid parts of an estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Validity {
    /// The position in the arena has been observed or was given; until then it is relative, see [`Estimate::is_relative`].
    pub position: bool,
    /// The heading in the arena has been observed or was given; a relative pose has a heading all the same.
    pub heading: bool,
    /// The speeds come from recent motion observations.
    pub speeds: bool,
}

/// A jump of the estimate that was not motion, from before to after.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseCorrection {
    pub dx_m: f64,
    pub dy_m: f64,
    /// Change of heading, the short way.
    pub turn: Radians,
    pub cause: ResetCause,
}

/// Why an estimate jumped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// The first absolute observation: before it the pose was relative to the start.
    Located,
    /// Observations agreed on another pose.
    Relocated,
    /// A person or a program set the pose.
    Given,
    /// A person or a program discarded the pose: it is relative to where the robot was then.
    Discarded,
}

impl ResetCause {
    /// As recordings spell it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Located => "located",
            Self::Relocated => "relocated",
            Self::Given => "given",
            Self::Discarded => "discarded",
        }
    }
}

/// The 97.5 % point of the standard normal distribution: 95 % lie within this many standard deviations of the mean.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;

/// The estimate of a filter for one quantity, such as a distance or a temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarEstimate {
    pub stamp: Timestamp<BrickClock>,
    pub value: f64,
    pub sigma: f64,
    /// Rate of change, per second; zero for a constant.
    pub rate_per_s: f64,
    pub unit: &'static str,
}

impl ScalarEstimate {
    pub const fn is_finite(&self) -> bool {
        self.value.is_finite() && self.sigma.is_finite() && self.rate_per_s.is_finite()
    }

    /// Half the width of the interval around the value that holds the quantity with a probability of 95 %, in its unit.
    pub const fn bound_95(&self) -> f64 {
        NORMAL_95 * self.sigma
    }
}
