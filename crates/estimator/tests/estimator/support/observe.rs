//! Observations at so many milliseconds, or seconds, of the brick's clock.

use posebridge_telemetry::{
    BrickClock, Fix, Heading, Meters, MetersPerSecondSquared, Observation, ObservationKind, Point2, Radians,
    RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};

pub(crate) fn ms(millis: i64) -> Timestamp<BrickClock> {
    Timestamp::from_millis(millis)
}

pub(crate) fn at(millis: i64, sensor: SensorId, measurement: ObservationKind) -> Observation {
    Observation { sensor, stamp: ms(millis), stamp_sigma: TimeDelta::ZERO, measurement }
}

pub(crate) fn at_s(at_s: f64, sensor: SensorId, measurement: ObservationKind) -> Observation {
    Observation { stamp: Timestamp::from_secs_f64(at_s), ..at(0, sensor, measurement) }
}

pub(crate) fn wheels(millis: i64, left_rad: f64, right_rad: f64) -> Observation {
    at(millis, SensorId::WHEELS, ObservationKind::WheelAngles { left: Radians(left_rad), right: Radians(right_rad) })
}

pub(crate) fn gyro(millis: i64, rad_per_s: f64) -> Observation {
    at(millis, SensorId::GYRO, ObservationKind::TurnRate(RadiansPerSecond(rad_per_s)))
}

pub(crate) fn accelerations(millis: i64, left: f64, right: f64) -> Observation {
    let (left, right) = (MetersPerSecondSquared(left), MetersPerSecondSquared(right));
    at(millis, SensorId::ACCELEROMETER, ObservationKind::WheelAccelerations { left, right })
}

pub(crate) fn fix(millis: i64, fix: Fix) -> Observation {
    at(millis, SensorId::CAMERA, ObservationKind::Fix(fix))
}

/// A fix of a tag at mid-axle, with the configured noise.
pub(crate) fn fix_of(x_m: f64, y_m: f64, heading_rad: impl Into<Option<f64>>) -> Fix {
    Fix {
        position: Point2::new(Meters(x_m), Meters(y_m)),
        heading: heading_rad.into().map(Heading::from_rad),
        covariance: None,
        tag_in_body: Point2::ORIGIN,
        reset_counter: 0,
    }
}

pub(crate) fn each_fix(observations: &mut [Observation], change: impl Fn(&mut Fix)) {
    for observation in observations {
        if let ObservationKind::Fix(fix) = &mut observation.measurement {
            change(fix);
        }
    }
}
