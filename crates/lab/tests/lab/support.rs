//! Robots and what they say.

use std::sync::Arc;

use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::{FilterConfig, Params};
use posebridge_telemetry::{
    Calibration, DriveGeometry, Fix, Heading, Meters, Observation, ObservationKind, Point2, Radians, SensorId,
    SensorNoise, TimeDelta, Timestamp,
};

/// Wheels of these radii, left and right, on a track; no start is known.
pub(crate) fn config(radii_m: [f64; 2], track_width_m: f64, tick_rad: f64, noise: SensorNoise) -> FilterConfig {
    FilterConfig {
        geometry: DriveGeometry {
            left_wheel_radius: Meters(radii_m[0]),
            right_wheel_radius: Meters(radii_m[1]),
            track_width: Meters(track_width_m),
            tick: Radians(tick_rad),
        },
        noise,
        start: None,
        params: Params::default(),
        calibration: Calibration::default(),
        arena_map: Arc::default(),
        slow_sensor: SlowSensor::UNKNOWN,
    }
}

pub(crate) fn observation(sensor: SensorId, millis: i64, measurement: ObservationKind) -> Observation {
    Observation { sensor, stamp: Timestamp::from_millis(millis), stamp_sigma: TimeDelta::ZERO, measurement }
}

/// Angles of the wheels in radians.
pub(crate) fn wheels(millis: i64, left: f64, right: f64) -> Observation {
    let angles = ObservationKind::WheelAngles { left: Radians(left), right: Radians(right) };
    observation(SensorId::WHEELS, millis, angles)
}

pub(crate) fn fix(millis: i64, x_m: f64, y_m: f64, heading_rad: Option<f64>) -> Observation {
    let fix = Fix {
        position: Point2::new(Meters(x_m), Meters(y_m)),
        heading: heading_rad.map(Heading::from_rad),
        covariance: None,
        tag_in_body: Point2::ORIGIN,
        reset_counter: 0,
    };
    observation(SensorId::CAMERA, millis, ObservationKind::Fix(fix))
}
