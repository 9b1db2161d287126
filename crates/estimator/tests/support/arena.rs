//! An arena with something for every sensor, and what those sensors say there beside wheels, gyro and camera.

use std::sync::Arc;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{
    Arena, ArenaMap, BeaconId, Celsius, LandmarkId, Meters, MetersPerSecond, MetersPerSecondSquared, Observation,
    ObservationKind, Odom, Point2, Pose, Radians, RadiansPerSecond, SensorId, Wall, quantities::wrap_rad,
};

use super::robot::config;
use super::steady::{FORWARD_M_PER_S, TURN_RAD_PER_S, at, pose};

const LANDMARK: Point2<Arena> = Point2::new(Meters(1.5), Meters(-0.5));

/// The robot of the tests in an arena with a landmark, which is a beacon as well, and a square of walls.
pub(crate) fn furnished() -> FilterConfig {
    let corner = |x_m, y_m| Point2::new(Meters(x_m), Meters(y_m));
    let corners = [corner(-3.0, -3.0), corner(3.0, -3.0), corner(3.0, 3.0), corner(-3.0, 3.0)];
    let walls = (0..4).map(|i| Wall { from: corners[i], to: corners[(i + 1) % 4] });
    let world = ArenaMap {
        landmarks: [(LandmarkId(1), LANDMARK)].into(),
        beacons: [(BeaconId(1), LANDMARK)].into(),
        walls: walls.collect(),
    };
    FilterConfig { arena_map: Arc::new(world), ..config() }
}

/// Everything else that a sensor may say at the end of a step. The ranges are what they would be.
pub(crate) fn others(step: i64) -> [Observation; 8] {
    let pose = pose(step);
    let (dx_m, dy_m) = (LANDMARK.x.0 - pose.x.0, LANDMARK.y.0 - pose.y.0);
    let range = Meters(dx_m.hypot(dy_m));
    let bearing = Radians(wrap_rad(dy_m.atan2(dx_m) - pose.heading.rad()));
    let (id, beacon) = (LandmarkId(1), BeaconId(1));
    let rest = MetersPerSecondSquared(0.0);
    [
        at(step, SensorId::ACCELEROMETER, ObservationKind::WheelAccelerations { left: rest, right: rest }),
        at(step, SensorId::LANDMARKS, ObservationKind::Landmark { id, range, bearing }),
        at(step, SensorId::BEACONS, ObservationKind::BeaconRange { id: beacon, range }),
        at(step, SensorId::RANGE, ObservationKind::WallRange(Meters(1.0))),
        at(step, SensorId::COMPASS, ObservationKind::CompassHeading(pose.heading)),
        at(step, SensorId::THERMOMETER, ObservationKind::Temperature(Celsius(20.0))),
        at(
            step,
            SensorId::ODOMETER,
            ObservationKind::BodyVelocity {
                forward: MetersPerSecond(FORWARD_M_PER_S),
                turn: RadiansPerSecond(TURN_RAD_PER_S),
            },
        ),
        at(step, SensorId::ODOMETER, ObservationKind::OdometerPose(odometer(pose))),
    ]
}

/// A foreign odometer's pose is in a space of its own; here the two coincide.
fn odometer(pose: Pose<Arena>) -> Pose<Odom> {
    Pose::new(pose.x, pose.y, pose.heading)
}
