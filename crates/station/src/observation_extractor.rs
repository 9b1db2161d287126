//! Extracts observations from messages, with the clock of their stamps. This is the only place that corrects them by the robot's wiring.

use posebridge_protocol::message::{
    GnssFix, ImuMessage, Inertial, LandmarkSighting, Message, Odometry, OdometryPose, PlanarImu, VisionFix, WheelTicks,
    WireStamp,
};
use posebridge_telemetry::{
    Body, DriveGeometry, Fix, GeodeticOrigin, GyroUnit, HostClock, Meters, MetersPerSecond, ObservationKind, Point2,
    PositionCovariance, Radians, RadiansPerSecond, SensorId, Timestamp, Wiring,
};

use crate::config::{RobotConfig, RpmMeaning};

/// 2001 in microseconds since 1970: larger stamps are no time since boot (common.xml, GPS_RAW_INT.time_usec).
const UNIX_MICROS: u64 = 1_000_000_000_000_000;

/// The clock of a reading's stamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ClockSource {
    Robot,
    Observer,
}

/// The observation in a message, before its stamp is aligned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnalignedObservation {
    pub(crate) sensor: SensorId,
    pub(crate) stamp: WireStamp,
    pub(crate) clock_source: ClockSource,
    pub(crate) observed: ObservationKind,
    /// The gyro's turn since power-up, where the sender reports it: a lost frame then costs nothing.
    pub(crate) gyro_turn: Option<Radians>,
    /// The number of a fix's tag.
    pub(crate) tag: Option<u32>,
    /// The message of a reading of an inertial unit that may come in several.
    pub(crate) imu: Option<ImuMessage>,
}

impl UnalignedObservation {
    /// Whether it observes the motion of a robot.
    pub(crate) const fn is_of_wheels(&self) -> bool {
        matches!(
            self.observed,
            ObservationKind::WheelAngles { .. }
                | ObservationKind::OdometerPose(_)
                | ObservationKind::BodyVelocity { .. }
        )
    }
}

/// The robot's properties that the conversion needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ObservationExtractor {
    pub(crate) geometry: DriveGeometry,
    pub(crate) tag_in_body: Point2<Body>,
    pub(crate) wiring: Wiring,
    pub(crate) rpm: RpmMeaning,
    /// Where the arena lies on the Earth; without it no position of a satellite receiver is used.
    pub(crate) origin: Option<GeodeticOrigin>,
}

impl ObservationExtractor {
    pub(crate) const fn new(config: &RobotConfig, origin: Option<GeodeticOrigin>) -> Self {
        let RobotConfig { ref filter_config, tag_in_body, wiring, rpm, .. } = *config;
        Self { geometry: filter_config.geometry, tag_in_body, wiring, rpm, origin }
    }

    /// The observations in a message that arrived at `arrival`: none, one or two.
    pub(crate) fn extract(
        &self,
        arrival: Timestamp<HostClock>,
        message: &Message,
    ) -> [Option<UnalignedObservation>; 2] {
        self.extract_uncorrected(arrival, message)
            .map(|observation| observation.map(|observation| self.correct(observation)))
    }

    fn correct(&self, observation: UnalignedObservation) -> UnalignedObservation {
        if observation.sensor == SensorId::GNSS {
            // The wiring of fixes is that of a camera.
            return observation;
        }
        UnalignedObservation {
            observed: self.wiring.correct(observation.observed, &self.geometry),
            gyro_turn: observation.gyro_turn.and_then(|turn| match self.wiring.gyro_unit {
                GyroUnit::RadiansPerSecond => Some(Radians(self.wiring.gyro.sign() * turn.0)),
                // The period of the integral on the wire is in radians.
                GyroUnit::DegreesPerSecond => None,
            }),
            ..observation
        }
    }

    fn extract_uncorrected(
        &self,
        arrival: Timestamp<HostClock>,
        message: &Message,
    ) -> [Option<UnalignedObservation>; 2] {
        #[expect(clippy::wildcard_enum_match_arm, reason = "most messages observe nothing")]
        match message {
            Message::WheelTicks(ticks) => [Some(self.wheel_ticks(ticks)), None],
            Message::WheelDistance { stamp, left, right } => {
                let observed = ObservationKind::WheelAngles {
                    left: Radians(left.0 / self.geometry.left_wheel_radius.0),
                    right: Radians(right.0 / self.geometry.right_wheel_radius.0),
                };
                [Some(robot_observation(SensorId::WHEELS, *stamp, observed)), None]
            }
            Message::Inertial(inertial) => inertial_readings(inertial),
            Message::WheelSpeeds { left, right } => match self.rpm {
                RpmMeaning::Wheels => [Some(self.wheel_speeds(arrival, *left, *right)), None],
                RpmMeaning::Unknown => [None, None],
            },
            Message::Imu(imu) => [imu_reading(imu), None],
            Message::GnssFix(fix) => {
                [self.origin.map(|origin| gnss_fix(arrival, fix, &origin)), ground_speed(arrival, fix)]
            }
            Message::LandmarkSighting(LandmarkSighting { stamp, landmark, forward, left }) => {
                let observed = ObservationKind::Landmark {
                    id: *landmark,
                    range: Meters(forward.0.hypot(left.0)),
                    bearing: Radians(left.0.atan2(forward.0)),
                };
                [Some(robot_observation(SensorId::LANDMARKS, *stamp, observed)), None]
            }
            Message::DistanceSensor { stamp, range, .. } => {
                [Some(robot_observation(SensorId::RANGE, *stamp, ObservationKind::WallRange(*range))), None]
            }
            Message::Compass { stamp, heading } => {
                [Some(robot_observation(SensorId::COMPASS, *stamp, ObservationKind::CompassHeading(*heading))), None]
            }
            Message::VisionPosition(fix) | Message::MocapPosition(fix) => [Some(self.fix(fix)), None],
            Message::Odometry(odometry) => [Some(odometry_reading(odometry)), None],
            // Thermometers have filters of their own.
            _ => [None, None],
        }
    }

    fn wheel_ticks(&self, ticks: &WheelTicks) -> UnalignedObservation {
        let tick_rad = self.geometry.tick.0;
        let observed = ObservationKind::WheelAngles {
            left: Radians(ticks.left.0 as f64 * tick_rad),
            right: Radians(ticks.right.0 as f64 * tick_rad),
        };
        robot_observation(SensorId::WHEELS, ticks.stamp, observed)
    }

    fn wheel_speeds(
        &self,
        arrival: Timestamp<HostClock>,
        left: RadiansPerSecond,
        right: RadiansPerSecond,
    ) -> UnalignedObservation {
        let left_m_per_s = left.0 * self.geometry.left_wheel_radius.0;
        let right_m_per_s = right.0 * self.geometry.right_wheel_radius.0;
        let observed = ObservationKind::BodyVelocity {
            forward: MetersPerSecond(0.5 * (left_m_per_s + right_m_per_s)),
            turn: RadiansPerSecond((right_m_per_s - left_m_per_s) / self.geometry.track_width.0),
        };
        robot_observation(SensorId::WHEELS, at_arrival(arrival), observed)
    }

    fn fix(&self, fix: &VisionFix) -> UnalignedObservation {
        let covariance = fix.covariance.map(|[xx_m2, xy_m2, yy_m2, heading_rad2]| PositionCovariance {
            xx_m2,
            xy_m2,
            yy_m2,
            heading_rad2: known_or_infinite(heading_rad2),
        });
        UnalignedObservation {
            sensor: SensorId::CAMERA,
            stamp: fix.stamp,
            clock_source: ClockSource::Observer,
            gyro_turn: None,
            imu: None,
            tag: fix.tag,
            observed: ObservationKind::Fix(Fix {
                position: Point2::new(fix.x, fix.y),
                heading: fix.heading,
                covariance,
                tag_in_body: self.tag_in_body,
                reset_counter: fix.reset_counter,
            }),
        }
    }
}

/// Senders that know only the variance of the position write zero or NaN for that of the heading.
fn known_or_infinite(heading_rad2: f64) -> f64 {
    if heading_rad2 > 0.0 { heading_rad2 } else { f64::INFINITY }
}

fn robot_observation(sensor: SensorId, stamp: WireStamp, observed: ObservationKind) -> UnalignedObservation {
    let clock_source = ClockSource::Robot;
    UnalignedObservation { sensor, stamp, clock_source, observed, gyro_turn: None, tag: None, imu: None }
}

fn inertial_readings(inertial: &Inertial) -> [Option<UnalignedObservation>; 2] {
    let rate = inertial.turn_rate.map(|rate| UnalignedObservation {
        gyro_turn: inertial.turn,
        ..robot_observation(SensorId::GYRO, inertial.stamp, ObservationKind::TurnRate(rate))
    });
    let accelerations = inertial.wheel_accelerations.map(|(left, right)| {
        robot_observation(SensorId::ACCELEROMETER, inertial.stamp, ObservationKind::WheelAccelerations { left, right })
    });
    [rate, accelerations]
}

fn imu_reading(imu: &PlanarImu) -> Option<UnalignedObservation> {
    imu.turn_rate.map(|rate| UnalignedObservation {
        imu: Some(imu.message),
        ..robot_observation(SensorId::GYRO, imu.stamp, ObservationKind::TurnRate(rate))
    })
}

/// The position of the receiver, which is taken for the body's origin: its error is far larger than a robot.
fn gnss_fix(arrival: Timestamp<HostClock>, fix: &GnssFix, origin: &GeodeticOrigin) -> UnalignedObservation {
    let covariance = fix.sigma.map(|sigma| {
        let variance_m2 = sigma.0.powi(2);
        PositionCovariance { xx_m2: variance_m2, xy_m2: 0.0, yy_m2: variance_m2, heading_rad2: f64::INFINITY }
    });
    let observed = ObservationKind::Fix(Fix {
        position: origin.to_arena(fix.position),
        heading: None,
        covariance,
        tag_in_body: Point2::ORIGIN,
        reset_counter: 0,
    });
    robot_observation(SensorId::GNSS, gnss_stamp(arrival, fix), observed)
}

/// The speed over the ground, taken for forward. The receiver does not know the turn: the robot adds that of its gyro.
fn ground_speed(arrival: Timestamp<HostClock>, fix: &GnssFix) -> Option<UnalignedObservation> {
    let observed = ObservationKind::BodyVelocity { forward: fix.ground_speed?, turn: RadiansPerSecond(0.0) };
    Some(robot_observation(SensorId::GNSS, gnss_stamp(arrival, fix), observed))
}

fn gnss_stamp(arrival: Timestamp<HostClock>, fix: &GnssFix) -> WireStamp {
    if fix.stamp.as_micros() < UNIX_MICROS { fix.stamp } else { at_arrival(arrival) }
}

/// For a message without a time of the robot's clock.
const fn at_arrival(arrival: Timestamp<HostClock>) -> WireStamp {
    WireStamp::HostInterval { sent: arrival, answered: arrival }
}

fn odometry_reading(odometry: &Odometry) -> UnalignedObservation {
    match odometry.pose {
        OdometryPose::Odom(pose) => {
            robot_observation(SensorId::ODOMETER, odometry.stamp, ObservationKind::OdometerPose(pose))
        }
        OdometryPose::Arena(pose) => {
            UnalignedObservation {
                sensor: SensorId::CAMERA,
                stamp: odometry.stamp,
                clock_source: ClockSource::Observer,
                gyro_turn: None,
                imu: None,
                tag: None,
                observed: ObservationKind::Fix(Fix {
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
    use posebridge_telemetry::{CameraUnit, GeodeticPoint, Heading, Polarity, WheelOrder};

    const INTERPRETER: ObservationExtractor = ObservationExtractor {
        geometry: DriveGeometry {
            left_wheel_radius: Meters(0.03),
            right_wheel_radius: Meters(0.02),
            track_width: Meters(0.1),
            tick: Radians(0.5),
        },
        tag_in_body: Point2::new(Meters(0.07), Meters(0.0)),
        wiring: Wiring {
            wheels: WheelOrder::AsNamed,
            left: Polarity::Normal,
            right: Polarity::Normal,
            gyro: Polarity::Normal,
            gyro_unit: GyroUnit::RadiansPerSecond,
            camera_y: Polarity::Normal,
            camera_unit: CameraUnit::Meters,
        },
        rpm: RpmMeaning::Unknown,
        origin: None,
    };

    fn fix_with(covariance: Option<[f64; 4]>) -> Fix {
        let message = Message::VisionPosition(VisionFix {
            stamp: WireStamp::Micros64(7),
            x: Meters(1.0),
            y: Meters(2.0),
            heading: Some(Heading::from_rad(0.3)),
            covariance,
            reset_counter: 0,
            tag: None,
        });
        let [Some(reading), None] = INTERPRETER.extract(Timestamp::ZERO, &message) else {
            panic!("a fix is one reading");
        };
        assert_eq!(reading.clock_source, ClockSource::Observer);
        let ObservationKind::Fix(fix) = reading.observed else {
            panic!("a fix is a fix");
        };
        fix
    }

    #[test]
    fn an_unknown_heading_variance_is_infinite() {
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
        let [Some(reading), None] = INTERPRETER.extract(Timestamp::ZERO, &Message::Compass { stamp, heading }) else {
            panic!("a compass is one reading");
        };
        assert_eq!(reading.sensor, SensorId::COMPASS);
        assert_eq!(reading.clock_source, ClockSource::Robot);
        assert_eq!(reading.observed, ObservationKind::CompassHeading(heading));
    }

    #[test]
    fn what_a_message_says_is_corrected_by_the_wiring() {
        let wiring = Wiring { gyro: Polarity::Reversed, camera_y: Polarity::Reversed, ..INTERPRETER.wiring };
        let extractor = ObservationExtractor { wiring, ..INTERPRETER };
        let inertial = Inertial {
            stamp: WireStamp::Micros64(7),
            turn_rate: Some(RadiansPerSecond(0.5)),
            turn: Some(Radians(2.0)),
            wheel_accelerations: None,
        };
        let [Some(gyro), None] = extractor.extract(Timestamp::ZERO, &Message::Inertial(inertial)) else {
            panic!("a gyro is one reading");
        };
        assert_eq!(gyro.observed, ObservationKind::TurnRate(RadiansPerSecond(-0.5)));
        assert_eq!(gyro.gyro_turn, Some(Radians(-2.0)));
        let in_degrees = Wiring { gyro_unit: GyroUnit::DegreesPerSecond, ..INTERPRETER.wiring };
        let extractor = ObservationExtractor { wiring: in_degrees, ..INTERPRETER };
        let [Some(gyro), None] = extractor.extract(Timestamp::ZERO, &Message::Inertial(inertial)) else {
            panic!("a gyro is one reading");
        };
        assert_eq!(gyro.observed, ObservationKind::TurnRate(RadiansPerSecond(0.5_f64.to_radians())));
        assert_eq!(gyro.gyro_turn, None);
    }

    #[test]
    fn a_satellite_fix_needs_an_origin_and_a_stamp_since_1970_is_not_of_the_robots_clock() {
        let point = |latitude: f64, longitude: f64| GeodeticPoint {
            latitude: Radians(latitude.to_radians()),
            longitude: Radians(longitude.to_radians()),
        };
        let origin = GeodeticOrigin::new(point(41.0, -96.0), Meters(0.0)).unwrap();
        let arrival = Timestamp::from_millis(700);
        let message = |micros| {
            Message::GnssFix(GnssFix {
                stamp: WireStamp::Micros64(micros),
                position: point(41.001, -96.0),
                sigma: Some(Meters(3.0)),
                ground_speed: None,
            })
        };
        assert_eq!(INTERPRETER.extract(arrival, &message(5)), [None, None]);
        // The camera's y is not that of the receiver.
        let wiring = Wiring { camera_y: Polarity::Reversed, ..INTERPRETER.wiring };
        let placed = ObservationExtractor { origin: Some(origin), wiring, ..INTERPRETER };
        let [Some(since_boot), None] = placed.extract(arrival, &message(5)) else {
            panic!("a fix is one reading");
        };
        assert_eq!((since_boot.sensor, since_boot.stamp), (SensorId::GNSS, WireStamp::Micros64(5)));
        let ObservationKind::Fix(fix) = since_boot.observed else {
            panic!("a fix is a fix");
        };
        assert!((fix.position.y.0 - 111.06).abs() < 0.1 && fix.position.x.0.abs() < 1e-6, "{fix:?}");
        assert_eq!(fix.covariance.unwrap().yy_m2, 9.0);
        let [Some(since_1970), None] = placed.extract(arrival, &message(1_742_581_143_368_055)) else {
            panic!("a fix is one reading");
        };
        assert_eq!(since_1970.stamp, WireStamp::HostInterval { sent: arrival, answered: arrival });
    }

    #[test]
    fn distances_of_wheels_of_unequal_size_become_their_rotations() {
        let message = Message::WheelDistance { stamp: WireStamp::Micros64(7), left: Meters(0.3), right: Meters(-0.1) };
        let [Some(reading), None] = INTERPRETER.extract(Timestamp::ZERO, &message) else {
            panic!("both wheels are one reading");
        };
        let ObservationKind::WheelAngles { left, right } = reading.observed else {
            panic!("wheels turn");
        };
        assert!((left.0 - 10.0).abs() < 1e-12 && (right.0 + 5.0).abs() < 1e-12);
    }
}
