//! How a robot's sensors are connected, where they differ from the conventions: wheels swapped or reversed, a gyro upside down
//! or in degrees, a camera whose y axis points down.

use crate::observation::{Fix, ObservationKind, PositionCovariance};
use crate::quantities::{Heading, Meters, MetersPerSecond, Radians, RadiansPerSecond};
use crate::robot::DriveGeometry;
use crate::spaces::{Point2, Pose};

/// The sense in which a sensor counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Polarity {
    #[default]
    Normal,
    Reversed,
}

impl Polarity {
    pub const fn sign(self) -> f64 {
        match self {
            Self::Normal => 1.0,
            Self::Reversed => -1.0,
        }
    }

    #[must_use]
    pub const fn toggled(self) -> Self {
        match self {
            Self::Normal => Self::Reversed,
            Self::Reversed => Self::Normal,
        }
    }
}

/// Which counter belongs to which wheel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WheelOrder {
    #[default]
    AsNamed,
    Swapped,
}

impl WheelOrder {
    #[must_use]
    pub const fn toggled(self) -> Self {
        match self {
            Self::AsNamed => Self::Swapped,
            Self::Swapped => Self::AsNamed,
        }
    }
}

/// The unit of the numbers that a gyro sends as radians per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroUnit {
    #[default]
    RadiansPerSecond,
    DegreesPerSecond,
}

/// The unit of the positions that a camera sends as metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CameraUnit {
    #[default]
    Meters,
    Millimeters,
}

impl CameraUnit {
    const fn in_meters(self) -> f64 {
        match self {
            Self::Meters => 1.0,
            Self::Millimeters => 1e-3,
        }
    }
}

/// What differs from the conventions on one robot. The default differs in nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wiring {
    pub wheels: WheelOrder,
    /// Of the left wheel, after [`Self::wheels`].
    pub left: Polarity,
    /// Of the right wheel, after [`Self::wheels`].
    pub right: Polarity,
    pub gyro: Polarity,
    pub gyro_unit: GyroUnit,
    /// The y axis of the positions that cameras send; reversed, their headings turn the other way, too.
    pub camera_y: Polarity,
    pub camera_unit: CameraUnit,
}

impl Wiring {
    /// The observation as a robot without these differences would have sent it.
    ///
    /// The pose of a foreign odometer is mirrored for swapped wheels and turned for two reversed ones; one reversed wheel cannot
    /// be corrected in it.
    #[must_use]
    pub fn correct(self, observed: ObservationKind, geometry: &DriveGeometry) -> ObservationKind {
        if self == Self::default() {
            return observed;
        }
        match observed {
            ObservationKind::WheelAngles { left, right } => {
                let [left_rad, right_rad] = self.correct_pair([left.0, right.0]);
                ObservationKind::WheelAngles { left: Radians(left_rad), right: Radians(right_rad) }
            }
            ObservationKind::BodyVelocity { forward, turn } => {
                let half_m = 0.5 * geometry.track_width.0;
                let pair = [forward.0 - half_m * turn.0, forward.0 + half_m * turn.0];
                let [left_m_per_s, right_m_per_s] = self.correct_pair(pair);
                ObservationKind::BodyVelocity {
                    forward: MetersPerSecond(0.5 * (left_m_per_s + right_m_per_s)),
                    turn: RadiansPerSecond((right_m_per_s - left_m_per_s) / geometry.track_width.0),
                }
            }
            ObservationKind::OdometerPose(pose) => {
                let [along, turn] = match (self.wheels, self.left, self.right) {
                    (WheelOrder::Swapped, Polarity::Reversed, Polarity::Reversed) => [-1.0, 1.0],
                    (WheelOrder::AsNamed, Polarity::Reversed, Polarity::Reversed) => [-1.0, -1.0],
                    (WheelOrder::Swapped, _, _) => [1.0, -1.0],
                    (WheelOrder::AsNamed, _, _) => [1.0, 1.0],
                };
                ObservationKind::OdometerPose(Pose::new(
                    Meters(along * pose.x.0),
                    Meters(along * turn * pose.y.0),
                    Heading::from_rad(turn * pose.heading.rad()),
                ))
            }
            ObservationKind::TurnRate(rate) => ObservationKind::TurnRate(RadiansPerSecond(self.correct_rate(rate.0))),
            ObservationKind::Fix(fix) => ObservationKind::Fix(self.correct_fix(fix)),
            ObservationKind::WheelAccelerations { .. }
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::CompassHeading(_)
            | ObservationKind::Temperature(_) => observed,
        }
    }

    fn correct_rate(self, rate: f64) -> f64 {
        let signed = self.gyro.sign() * rate;
        match self.gyro_unit {
            GyroUnit::RadiansPerSecond => signed,
            GyroUnit::DegreesPerSecond => signed.to_radians(),
        }
    }

    fn correct_pair(self, [left, right]: [f64; 2]) -> [f64; 2] {
        let [left, right] = match self.wheels {
            WheelOrder::AsNamed => [left, right],
            WheelOrder::Swapped => [right, left],
        };
        [self.left.sign() * left, self.right.sign() * right]
    }

    /// A fix, used or withheld.
    #[must_use]
    pub fn correct_fix(self, fix: Fix) -> Fix {
        let (y_sign, unit_m) = (self.camera_y.sign(), self.camera_unit.in_meters());
        Fix {
            position: Point2::new(Meters(unit_m * fix.position.x.0), Meters(y_sign * unit_m * fix.position.y.0)),
            heading: fix.heading.map(|heading| Heading::from_rad(y_sign * heading.rad())),
            covariance: fix.covariance.map(|covariance| PositionCovariance {
                xx_m2: unit_m * unit_m * covariance.xx_m2,
                xy_m2: y_sign * unit_m * unit_m * covariance.xy_m2,
                yy_m2: unit_m * unit_m * covariance.yy_m2,
                heading_rad2: covariance.heading_rad2,
            }),
            ..fix
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEOMETRY: DriveGeometry = DriveGeometry {
        left_wheel_radius: Meters(0.03),
        right_wheel_radius: Meters(0.03),
        track_width: Meters(0.1),
        tick: Radians(0.01),
    };

    fn wheels(left: f64, right: f64) -> ObservationKind {
        ObservationKind::WheelAngles { left: Radians(left), right: Radians(right) }
    }

    #[test]
    fn wheels_are_swapped_first_and_reversed_then() {
        let wiring = Wiring { wheels: WheelOrder::Swapped, left: Polarity::Reversed, ..Wiring::default() };
        assert_eq!(wiring.correct(wheels(1.0, 2.0), &GEOMETRY), wheels(-2.0, 1.0));
        let speeds = |forward, turn| ObservationKind::BodyVelocity {
            forward: MetersPerSecond(forward),
            turn: RadiansPerSecond(turn),
        };
        let swapped = Wiring { wheels: WheelOrder::Swapped, ..Wiring::default() };
        let ObservationKind::BodyVelocity { forward, turn } = swapped.correct(speeds(0.2, 1.0), &GEOMETRY) else {
            panic!("speeds stay speeds");
        };
        assert!((forward.0 - 0.2).abs() < 1e-12 && (turn.0 + 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_odometers_pose_is_mirrored_and_turned() {
        let reversed = Wiring { left: Polarity::Reversed, right: Polarity::Reversed, ..Wiring::default() };
        let swapped = Wiring { wheels: WheelOrder::Swapped, ..Wiring::default() };
        let pose =
            |x, y, heading| ObservationKind::OdometerPose(Pose::new(Meters(x), Meters(y), Heading::from_rad(heading)));
        assert_eq!(swapped.correct(pose(1.0, 2.0, 0.5), &GEOMETRY), pose(1.0, -2.0, -0.5));
        assert_eq!(reversed.correct(pose(1.0, 2.0, 0.5), &GEOMETRY), pose(-1.0, 2.0, -0.5));
    }

    #[test]
    fn degrees_millimetres_and_a_y_axis_that_points_down_are_converted() {
        let wiring = Wiring {
            gyro: Polarity::Reversed,
            gyro_unit: GyroUnit::DegreesPerSecond,
            camera_y: Polarity::Reversed,
            camera_unit: CameraUnit::Millimeters,
            ..Wiring::default()
        };
        let rate = |value| ObservationKind::TurnRate(RadiansPerSecond(value));
        assert_eq!(wiring.correct(rate(90.0), &GEOMETRY), rate(-std::f64::consts::FRAC_PI_2));
        let fix = |x, y, heading, xy_m2, yy_m2| {
            ObservationKind::Fix(Fix {
                position: Point2::new(Meters(x), Meters(y)),
                heading: Some(Heading::from_rad(heading)),
                covariance: Some(PositionCovariance { xx_m2: yy_m2, xy_m2, yy_m2, heading_rad2: 0.1 }),
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            })
        };
        assert_eq!(wiring.correct(fix(1e3, 2e3, 0.5, 2e6, 4e6), &GEOMETRY), fix(1.0, -2.0, -0.5, -2.0, 4.0));
    }
}
