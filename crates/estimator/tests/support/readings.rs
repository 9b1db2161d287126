//! Readings of the wheels and the gyro by the second, and what a filter of the table makes of them in the units of paper 1.

use posebridge_estimator::models::planar_speeds::Covariance;
use posebridge_estimator::papers::paper1::UNITS;
use posebridge_estimator::{Filter, FilterConfig, find_filter};
use posebridge_telemetry::{
    BrickClock, Estimate, Observation, ObservationKind, Radians, RadiansPerSecond, SensorId, TimeDelta, Timestamp,
};

pub(crate) fn at(secs: f64, sensor: SensorId, observed: ObservationKind) -> Observation {
    Observation {
        sensor,
        stamp: Timestamp::<BrickClock>::from_secs_f64(secs),
        stamp_sigma: TimeDelta::ZERO,
        measurement: observed,
    }
}

pub(crate) fn wheels(secs: f64, left_rad: f64, right_rad: f64) -> Observation {
    let observed = ObservationKind::WheelAngles { left: Radians(left_rad), right: Radians(right_rad) };
    at(secs, SensorId::WHEELS, observed)
}

pub(crate) fn gyro(secs: f64, rad_per_s: f64) -> Observation {
    let observed = ObservationKind::TurnRate(RadiansPerSecond(rad_per_s));
    at(secs, SensorId::GYRO, observed)
}

pub(crate) fn named(name: &str, config: &FilterConfig) -> Box<dyn Filter> {
    (find_filter(name).expect("it is in the table").build)(config)
}

pub(crate) fn latest(filter: &dyn Filter) -> Estimate {
    filter.latest_time().and_then(|latest| filter.estimate_at(latest)).expect("something was observed")
}

/// The published covariance in the paper's units: cm, degrees and these per second.
pub(crate) fn covariance_in_paper_units(filter: &dyn Filter) -> Covariance {
    let published = latest(filter).covariance;
    Covariance::from_fn(|i, j| published[i][j] / (UNITS[i] * UNITS[j]))
}

pub(crate) fn assert_near(what: &str, found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() < tolerance, "{what}: {found} instead of {expected}");
}
