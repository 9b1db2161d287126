//! From messages to observations: what a message says about the robot, and by which clock it is stamped.

use posebridge_protocol::message::{
    Inertial, Message, Odometry, OdometryPose, PlanarImu, VisionFix, WheelTicks, WireStamp,
};
use posebridge_telemetry::{Body, DriveGeometry, Fix, Observed, Point2, PositionCovariance, Radians, SensorId};

/// Whose clock stamped a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StampedBy {
    /// The robot's own.
    Brick,
    /// That of an observer outside.
    Observer,
}

/// What a message says, before its stamp is aligned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reading {
    pub(crate) sensor: SensorId,
    pub(crate) stamp: WireStamp,
    pub(crate) stamped_by: StampedBy,
    pub(crate) observed: Observed,
    /// The gyro's turn since power-up, where the sender tells it: a lost frame then costs nothing.
    pub(crate) gyro_turn: Option<Radians>,
}

/// What interpretation needs to know about the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interpreter {
    pub(crate) geometry: DriveGeometry,
    pub(crate) tag_in_body: Point2<Body>,
}

impl Interpreter {
    /// What a message says about the robot: none, one or two readings.
    pub(crate) fn readings(&self, message: &Message) -> [Option<Reading>; 2] {
        match message {
            Message::WheelTicks(ticks) => [Some(self.wheel_ticks(ticks)), None],
            Message::WheelDistance { stamp, left, right } => {
                let observed = Observed::WheelAngles {
                    left: Radians(left.0 / self.geometry.left_wheel_radius.0),
                    right: Radians(right.0 / self.geometry.right_wheel_radius.0),
                };
                [Some(by_brick(SensorId::WHEELS, *stamp, observed)), None]
            }
            Message::Inertial(inertial) => inertial_readings(inertial),
            Message::ScaledImu(imu) | Message::HighresImu(imu) => [imu_reading(imu), None],
            Message::DistanceSensor { stamp, range, .. } => [
                Some(by_brick(
                    SensorId::RANGE,
                    *stamp,
                    Observed::WallRange(*range),
                )),
                None,
            ],
            Message::Compass { stamp, heading } => [
                Some(by_brick(
                    SensorId::COMPASS,
                    *stamp,
                    Observed::CompassHeading(*heading),
                )),
                None,
            ],
            Message::VisionPosition(fix) | Message::MocapPosition(fix) => {
                [Some(self.fix(fix)), None]
            }
            Message::Odometry(odometry) => [Some(odometry_reading(odometry)), None],
            Message::Heartbeat(_)
            | Message::SystemTime { .. }
            | Message::TimeSync(_)
            | Message::SetMessageInterval(_)
            | Message::Command(_)
            | Message::CommandInt(_)
            | Message::CommandAck(_)
            | Message::StatusText { .. }
            | Message::AutopilotVersion(_)
            | Message::ProtocolVersion(_)
            | Message::ComponentInformation(_)
            | Message::MessageInterval(_)
            | Message::NamedValue(_)
            | Message::FloatArray(_)
            // Thermometers have filters of their own.
            | Message::Thermometer { .. }
            | Message::PlanarPose(_)
            | Message::FusionHealth(_)
            | Message::RobotDescription(_)
            | Message::LocalPosition { .. }
            | Message::Attitude { .. }
            | Message::EstimatorStatus(_)
            | Message::ParamRequestList { .. }
            | Message::ParamRequestRead { .. }
            | Message::ParamSet { .. }
            | Message::ParamSetUnsupported { .. }
            | Message::ParamValue { .. } => [None, None],
        }
    }

    fn wheel_ticks(&self, ticks: &WheelTicks) -> Reading {
        let tick_rad = self.geometry.tick.0;
        let observed = Observed::WheelAngles {
            left: Radians(ticks.left.0 as f64 * tick_rad),
            right: Radians(ticks.right.0 as f64 * tick_rad),
        };
        by_brick(SensorId::WHEELS, ticks.stamp, observed)
    }

    fn fix(&self, seen: &VisionFix) -> Reading {
        let covariance = seen.covariance.map(|[xx_m2, xy_m2, yy_m2, heading_rad2]| PositionCovariance {
            xx_m2,
            xy_m2,
            yy_m2,
            heading_rad2: known_or_infinite(heading_rad2),
        });
        Reading {
            sensor: SensorId::CAMERA,
            stamp: seen.stamp,
            stamped_by: StampedBy::Observer,
            gyro_turn: None,
            observed: Observed::Fix(Fix {
                position: Point2::new(seen.x, seen.y),
                heading: seen.heading,
                covariance,
                tag_in_body: self.tag_in_body,
                reset_counter: seen.reset_counter,
            }),
        }
    }
}

/// A heading's variance of zero or NaN is what senders write who know that of the position alone.
fn known_or_infinite(heading_rad2: f64) -> f64 {
    if heading_rad2 > 0.0 { heading_rad2 } else { f64::INFINITY }
}

fn by_brick(sensor: SensorId, stamp: WireStamp, observed: Observed) -> Reading {
    Reading { sensor, stamp, stamped_by: StampedBy::Brick, observed, gyro_turn: None }
}

fn inertial_readings(inertial: &Inertial) -> [Option<Reading>; 2] {
    let rate = inertial.turn_rate.map(|rate| Reading {
        gyro_turn: inertial.turn,
        ..by_brick(SensorId::GYRO, inertial.stamp, Observed::TurnRate(rate))
    });
    let accelerations = inertial.wheel_accelerations.map(|(left, right)| {
        by_brick(SensorId::ACCELEROMETER, inertial.stamp, Observed::WheelAccelerations { left, right })
    });
    [rate, accelerations]
}

fn imu_reading(imu: &PlanarImu) -> Option<Reading> {
    imu.turn_rate.map(|rate| by_brick(SensorId::GYRO, imu.stamp, Observed::TurnRate(rate)))
}

fn odometry_reading(odometry: &Odometry) -> Reading {
    match odometry.pose {
        OdometryPose::Odom(pose) => by_brick(SensorId::ODOMETER, odometry.stamp, Observed::OdometerPose(pose)),
        OdometryPose::Arena(pose) => {
            Reading {
                sensor: SensorId::CAMERA,
                stamp: odometry.stamp,
                stamped_by: StampedBy::Observer,
                gyro_turn: None,
                observed: Observed::Fix(Fix {
                    position: pose.origin(),
                    heading: Some(pose.heading),
                    covariance: odometry.covariance.map(|[xx_m2, xy_m2, _, yy_m2, _, heading_rad2]| {
                        PositionCovariance { xx_m2, xy_m2, yy_m2, heading_rad2: known_or_infinite(heading_rad2) }
                    }),
                    tag_in_body: Point2::ORIGIN,
                    reset_counter: odometry.reset_counter,
                }),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Heading, Meters};

    const INTERPRETER: Interpreter = Interpreter {
        geometry: DriveGeometry {
            left_wheel_radius: Meters(0.03),
            right_wheel_radius: Meters(0.02),
            track_width: Meters(0.1),
            tick: Radians(0.5),
        },
        tag_in_body: Point2::new(Meters(0.07), Meters(0.0)),
    };

    fn fix_with(covariance: Option<[f64; 4]>) -> Fix {
        let message = Message::VisionPosition(VisionFix {
            stamp: WireStamp::Micros64(7),
            x: Meters(1.0),
            y: Meters(2.0),
            heading: Some(Heading::from_rad(0.3)),
            covariance,
            reset_counter: 0,
        });
        let [Some(reading), None] = INTERPRETER.readings(&message) else {
            panic!("a fix is one reading");
        };
        assert_eq!(reading.stamped_by, StampedBy::Observer);
        let Observed::Fix(fix) = reading.observed else {
            panic!("a fix is a fix");
        };
        fix
    }

    #[test]
    fn a_heading_variance_that_says_nothing_is_infinite() {
        for (written, expected) in [(0.01, 0.01), (0.0, f64::INFINITY), (f64::NAN, f64::INFINITY)] {
            let fix = fix_with(Some([1e-4, 0.0, 1e-4, written]));
            let covariance = fix.covariance.unwrap();
            assert_eq!(covariance.heading_rad2, expected, "{written}");
        }
        assert_eq!(fix_with(None).covariance, None);
        assert_eq!(fix_with(None).tag_in_body, INTERPRETER.tag_in_body);
    }

    #[test]
    fn a_compass_of_the_brick_is_a_heading() {
        let heading = Heading::from_rad(0.5);
        let stamp = WireStamp::Millis32(9);
        let [Some(reading), None] = INTERPRETER.readings(&Message::Compass { stamp, heading }) else {
            panic!("a compass is one reading");
        };
        assert_eq!(reading.sensor, SensorId::COMPASS);
        assert_eq!(reading.stamped_by, StampedBy::Brick);
        assert_eq!(reading.observed, Observed::CompassHeading(heading));
    }

    #[test]
    fn distances_of_wheels_of_unequal_size_become_their_rotations() {
        let message = Message::WheelDistance { stamp: WireStamp::Micros64(7), left: Meters(0.3), right: Meters(-0.1) };
        let [Some(reading), None] = INTERPRETER.readings(&message) else {
            panic!("both wheels are one reading");
        };
        let Observed::WheelAngles { left, right } = reading.observed else {
            panic!("wheels turn");
        };
        assert!((left.0 - 10.0).abs() < 1e-12 && (right.0 + 5.0).abs() < 1e-12);
    }
}
