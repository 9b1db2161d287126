//! What both suites of every filter of the pose are made of: the filters of the table, a drive straight on, and what is believed.

use posebridge_estimator::{EstimatedQuantity, FILTERS, Filter, FilterConfig, FilterEntry, StartPose};
use posebridge_telemetry::{
    Estimate, Fix, Heading, Meters, Observation, ObservationKind, Point2, Pose, SensorId, TimeDelta,
};

use super::robot::RADIUS_M;
use super::stamped::{at, gyro, wheels};

pub(crate) fn fix_of(x_m: f64, y_m: f64, heading_rad: f64) -> Fix {
    Fix {
        position: Point2::new(Meters(x_m), Meters(y_m)),
        heading: Some(Heading::from_rad(heading_rad)),
        covariance: None,
        tag_in_body: Point2::ORIGIN,
        reset_counter: 0,
    }
}

pub(crate) fn fix(millis: i64, fix: Fix) -> Observation {
    at(millis, SensorId::CAMERA, ObservationKind::Fix(fix))
}

/// Runs a check on every filter of the pose, freshly built, with the row that built it. Those of one quantity have a suite of their
/// own, `conformance_scalar.rs`.
pub(crate) fn for_each(config: &FilterConfig, check: impl Fn(&FilterEntry, Box<dyn Filter>)) {
    for entry in FILTERS {
        if entry.quantity == EstimatedQuantity::Pose {
            check(entry, (entry.build)(config));
        }
    }
}

/// Drives straight on at 0.2 m/s from 0 to `until_ms`, wheels and gyro every 50 ms; the last observation is that of the wheels.
pub(crate) fn drive_straight(filter: &mut dyn Filter, until_ms: i64) {
    for millis in (0..=until_ms).step_by(50) {
        filter.observe(&gyro(millis, 0.0));
        let rad = 0.2e-3 * millis as f64 / RADIUS_M;
        filter.observe(&wheels(millis, rad, rad));
    }
}

pub(crate) fn latest(filter: &dyn Filter) -> Estimate {
    filter.latest_time().and_then(|latest| filter.estimate_at(latest)).expect("something was observed")
}

/// What a filter believes of the last seconds and of the next, in digits that tell any two numbers apart.
pub(crate) fn belief(filter: &dyn Filter) -> String {
    let instants = (-20..=20).map(|k| k * 100);
    let latest = filter.latest_time();
    let believed: Vec<_> =
        instants.filter_map(|millis| filter.estimate_at(latest? + TimeDelta::from_millis(millis))).collect();
    format!("{latest:?} {believed:?}")
}

pub(crate) fn start(x_m: f64, y_m: f64, heading_rad: f64) -> StartPose {
    StartPose {
        pose: Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad)),
        position_sigma_m: 0.02,
        heading_sigma_rad: 0.05,
    }
}
