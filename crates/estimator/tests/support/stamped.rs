//! Observations at so many milliseconds of the brick's clock.

use posebridge_telemetry::{
    BrickClock, Observation, ObservationKind, Radians, RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};

pub(crate) fn ms(millis: i64) -> Timestamp<BrickClock> {
    Timestamp::from_millis(millis)
}

pub(crate) fn at(millis: i64, sensor: SensorId, observed: ObservationKind) -> Observation {
    Observation { sensor, stamp: ms(millis), stamp_sigma: TimeDelta::ZERO, measurement: observed }
}

pub(crate) fn wheels(millis: i64, left_rad: f64, right_rad: f64) -> Observation {
    let observed = ObservationKind::WheelAngles { left: Radians(left_rad), right: Radians(right_rad) };
    at(millis, SensorId::WHEELS, observed)
}

pub(crate) fn gyro(millis: i64, rad_per_s: f64) -> Observation {
    let observed = ObservationKind::TurnRate(RadiansPerSecond(rad_per_s));
    at(millis, SensorId::GYRO, observed)
}
