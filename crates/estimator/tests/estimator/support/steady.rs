//! A robot that drives in a circle for ever, and its sensors' readings at each step: no noise, no randomness, no allocation.

use posebridge_telemetry::{
    Arena, BrickClock, Fix, Heading, Meters, Observation, ObservationKind, Point2, Pose, Radians, RadiansPerSecond,
    SensorId, TimeDelta, Timestamp,
};

use super::robot::{DEGREE, RADIUS_M, TRACK_M};

/// The period of wheels and gyro: 20 Hz.
pub(crate) const STEP: TimeDelta = TimeDelta::from_millis(50);
/// A fix comes this many steps after what it saw: 300 ms.
pub(crate) const LATE_STEPS: i64 = 6;
pub(crate) const FORWARD_M_PER_S: f64 = 0.2;
pub(crate) const TURN_RAD_PER_S: f64 = 0.4;

/// When a step ends.
pub(crate) fn stamp(step: i64) -> Timestamp<BrickClock> {
    Timestamp::from_nanos(STEP.as_nanos() * step)
}

fn time_s(step: i64) -> f64 {
    stamp(step).as_secs_f64()
}

/// Where the robot is at the end of a step.
pub(crate) fn pose(step: i64) -> Pose<Arena> {
    let heading_rad = TURN_RAD_PER_S * time_s(step);
    let radius_m = FORWARD_M_PER_S / TURN_RAD_PER_S;
    Pose::new(
        Meters(radius_m * heading_rad.sin()),
        Meters(radius_m * (1.0 - heading_rad.cos())),
        Heading::from_rad(heading_rad),
    )
}

/// A sensor's reading at the end of a step.
pub(crate) fn at(step: i64, sensor: SensorId, observed: ObservationKind) -> Observation {
    Observation { sensor, stamp: stamp(step), stamp_sigma: TimeDelta::ZERO, measurement: observed }
}

/// The counters at the end of a step, in full degrees.
pub(crate) fn wheels(step: i64) -> Observation {
    let angle = |side: f64| {
        let speed_m_per_s = FORWARD_M_PER_S + side * 0.5 * TURN_RAD_PER_S * TRACK_M;
        let degrees = speed_m_per_s * time_s(step) / RADIUS_M / DEGREE;
        Radians(degrees.floor() * DEGREE)
    };
    let observed = ObservationKind::WheelAngles { left: angle(-1.0), right: angle(1.0) };
    at(step, SensorId::WHEELS, observed)
}

/// The turn rate during a step.
pub(crate) fn gyro(step: i64) -> Observation {
    let observed = ObservationKind::TurnRate(RadiansPerSecond(TURN_RAD_PER_S));
    at(step, SensorId::GYRO, observed)
}

/// What the camera saw at the end of a step, to be given [`LATE_STEPS`] later.
pub(crate) fn fix(step: i64) -> Observation {
    let pose = pose(step);
    let observed = ObservationKind::Fix(Fix {
        position: Point2::new(pose.x, pose.y),
        heading: Some(pose.heading),
        covariance: None,
        tag_in_body: Point2::ORIGIN,
        reset_counter: 0,
    });
    at(step, SensorId::CAMERA, observed)
}
