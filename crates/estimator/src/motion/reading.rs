//! A motion reading, and the travel between two of them.

use posebridge_telemetry::{BrickClock, DriveGeometry, Heading, ObservationKind, Odom, Pose, Timestamp};
use serde::{Deserialize, Serialize};

use crate::models::differential_drive::WheelTravel;
use crate::saved::finite;

/// The result of inserting a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InsertOutcome {
    /// Inserted; the motion changed after this instant, the stamp of the reading before it. `None`: it is the first.
    Inserted(Option<Timestamp<BrickClock>>),
    /// Inserted, but the motion since the reading at this instant is unknown: a jump of the counters, or a better
    /// source.
    Rebased(Timestamp<BrickClock>),
    /// A better source is in use.
    Superseded,
    /// There is a reading with this stamp already.
    Duplicate,
    /// Older than all kept readings, or from before a better source took over.
    TooOld,
}

/// The kind of motion observation in use; a later variant replaces an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum MotionSource {
    /// Commanded or foreign speeds, held.
    Velocity,
    /// Increments of a foreign odometer's pose.
    Odometer,
    /// Encoder counts.
    Wheels,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum MotionReading {
    /// Total rotation of each wheel.
    Wheels {
        #[serde(deserialize_with = "finite")]
        left_rad: f64,
        #[serde(deserialize_with = "finite")]
        right_rad: f64,
    },
    #[serde(deserialize_with = "finite")]
    Odometer(Pose<Odom>),
    /// Speeds, held until the next reading.
    Velocity {
        /// Along the body's x axis.
        #[serde(deserialize_with = "finite")]
        forward_m_per_s: f64,
        /// About the vertical.
        #[serde(deserialize_with = "finite")]
        turn_rad_per_s: f64,
    },
}

impl MotionReading {
    /// The motion reading of an observation; `None` for other kinds.
    pub fn from_observation(observed: &ObservationKind) -> Option<Self> {
        match *observed {
            ObservationKind::WheelAngles { left, right } => Some(Self::Wheels { left_rad: left.0, right_rad: right.0 }),
            ObservationKind::OdometerPose(pose) => Some(Self::Odometer(pose)),
            ObservationKind::BodyVelocity { forward, turn } => {
                Some(Self::Velocity { forward_m_per_s: forward.0, turn_rad_per_s: turn.0 })
            }
            ObservationKind::TurnRate(_)
            | ObservationKind::WheelAccelerations { .. }
            | ObservationKind::Fix(_)
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::CompassHeading(_)
            | ObservationKind::Temperature(_) => None,
        }
    }

    pub const fn source(&self) -> MotionSource {
        match self {
            Self::Wheels { .. } => MotionSource::Wheels,
            Self::Odometer(_) => MotionSource::Odometer,
            Self::Velocity { .. } => MotionSource::Velocity,
        }
    }

    /// Travel from this reading to the next one, `dt_s` later; `None` when they are of different kinds.
    pub(crate) fn travel_to(&self, next: &Self, dt_s: f64, geometry: &DriveGeometry) -> Option<WheelTravel> {
        match (*self, *next) {
            (Self::Wheels { left_rad: left, right_rad: right }, Self::Wheels { left_rad, right_rad }) => {
                Some(WheelTravel::from_rotation(left_rad - left, right_rad - right, geometry))
            }
            (Self::Odometer(from), Self::Odometer(to)) => Some(arc_between(from, to, geometry.track_width.0)),
            (Self::Velocity { forward_m_per_s, turn_rad_per_s }, Self::Velocity { .. }) => {
                let half_m_per_s = 0.5 * turn_rad_per_s * geometry.track_width.0;
                Some(WheelTravel {
                    left_m: (forward_m_per_s - half_m_per_s) * dt_s,
                    right_m: (forward_m_per_s + half_m_per_s) * dt_s,
                })
            }
            (Self::Wheels { .. } | Self::Odometer(_) | Self::Velocity { .. }, _) => None,
        }
    }
}

/// The wheel travel that moves an odometer from one pose to the other along an arc.
fn arc_between(from: Pose<Odom>, to: Pose<Odom>, track_width_m: f64) -> WheelTravel {
    let turn_rad = (to.heading - from.heading).0;
    let (dx_m, dy_m) = (to.x.0 - from.x.0, to.y.0 - from.y.0);
    let mean_heading = Heading::from_rad(from.heading.rad() + 0.5 * turn_rad).rad();
    let chord_m = dx_m.hypot(dy_m);
    let along_m = dx_m * mean_heading.cos() + dy_m * mean_heading.sin();
    let half = 0.5 * turn_rad;
    let arc_over_chord = if half.abs() < 1e-6 { 1.0 } else { half / half.sin() };
    let forward_m = (chord_m * arc_over_chord).copysign(along_m);
    let half_turn_m = half * track_width_m;
    WheelTravel { left_m: forward_m - half_turn_m, right_m: forward_m + half_turn_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Meters, Radians};

    #[test]
    fn an_odometer_pose_gives_the_arc_between_two_poses() {
        let geometry = DriveGeometry {
            left_wheel_radius: Meters(0.03),
            right_wheel_radius: Meters(0.03),
            track_width: Meters(0.1),
            tick: Radians(0.017_453_3),
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        let here = MotionReading::Odometer(Pose::default());
        let there = MotionReading::Odometer(Pose::new(Meters(-1.0), Meters(-1.0), Heading::from_rad(quarter)));
        let travel = here.travel_to(&there, 1.0, &geometry).unwrap();
        assert!((0.5 * (travel.left_m + travel.right_m) + quarter).abs() < 1e-9, "backwards along the arc");
        assert!(((travel.right_m - travel.left_m) / 0.1 - quarter).abs() < 1e-9);
    }
}
