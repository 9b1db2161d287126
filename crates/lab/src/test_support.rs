//! A robot and its observations, for the tests of this crate.

use posebridge_estimator::{FilterConfig, Params};
use posebridge_telemetry::{
    Arena, Body, Calibration, DriveGeometry, Fix, Heading, Meters, Observation, ObservationKind, Point2, Radians,
    SensorId, SensorNoise, TimeDelta, Timestamp,
};

/// Wheels of 50 mm on a track of 200 mm.
pub(crate) fn config(noise: SensorNoise) -> FilterConfig {
    FilterConfig {
        geometry: DriveGeometry {
            left_wheel_radius: Meters(0.05),
            right_wheel_radius: Meters(0.05),
            track_width: Meters(0.2),
            tick: Radians(0.01),
        },
        noise,
        start: None,
        params: Params::default(),
        calibration: Calibration::default(),
        arena_map: std::sync::Arc::default(),
    }
}

pub(crate) fn observation(sensor: SensorId, millis: i64, measurement: ObservationKind) -> Observation {
    Observation { sensor, stamp: Timestamp::from_millis(millis), stamp_sigma: TimeDelta::ZERO, measurement }
}

/// Angles of the left and of the right wheel, in radians.
pub(crate) fn wheel_angles(millis: i64, left_rad: f64, right_rad: f64) -> Observation {
    let [left, right] = [left_rad, right_rad].map(Radians);
    observation(SensorId::WHEELS, millis, ObservationKind::WheelAngles { left, right })
}

/// A camera fix of a tag at `tag_in_body`; the heading in radians.
pub(crate) fn fix(
    millis: i64,
    position: Point2<Arena>,
    heading_rad: Option<f64>,
    tag_in_body: Point2<Body>,
) -> Observation {
    let fix =
        Fix { position, heading: heading_rad.map(Heading::from_rad), covariance: None, tag_in_body, reset_counter: 0 };
    observation(SensorId::CAMERA, millis, ObservationKind::Fix(fix))
}
