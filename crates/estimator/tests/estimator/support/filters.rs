//! The filters of the table, a drive straight on, and the text of a filter's state.

use posebridge_estimator::{EstimatedQuantity, FILTERS, Filter, FilterConfig, FilterEntry, find_filter};
use posebridge_telemetry::{Estimate, Heading, Meters, Pose, StartPose, TimeDelta};

use super::observe::{gyro, wheels};
use super::robot::{RADIUS_M, config};

/// Runs a check on every filter of the pose, freshly built, with the row that built it.
pub(crate) fn for_each(config: &FilterConfig, check: impl Fn(&FilterEntry, Box<dyn Filter>)) {
    for entry in FILTERS.iter().filter(|entry| entry.quantity == EstimatedQuantity::Pose) {
        check(entry, (entry.build)(config));
    }
}

pub(crate) fn named(name: &str, config: &FilterConfig) -> Box<dyn Filter> {
    (find_filter(name).expect("it is in the table").build)(config)
}

/// Drives straight on at 0.2 m/s from 0 to `until_ms`, wheels and gyro every 50 ms; the last observation is that of the wheels.
pub(crate) fn drive_straight(filter: &mut dyn Filter, until_ms: i64) {
    drive_straight_from(filter, 0, until_ms);
}

pub(crate) fn drive_straight_from(filter: &mut dyn Filter, from_ms: i64, until_ms: i64) {
    for millis in (from_ms..=until_ms).step_by(50) {
        filter.observe(&gyro(millis, 0.0));
        let rad = 0.2e-3 * millis as f64 / RADIUS_M;
        filter.observe(&wheels(millis, rad, rad));
    }
}

/// Keeps the robot at rest with wheels and gyro at 20 Hz; the gyro shows its bias.
pub(crate) fn rest(filter: &mut dyn Filter, steps: i64, rate_rad_per_s: f64) {
    for k in 0..steps {
        filter.observe(&wheels(50 * k, 0.0, 0.0));
        filter.observe(&gyro(50 * k, rate_rad_per_s));
    }
}

pub(crate) fn latest(filter: &dyn Filter) -> Estimate {
    filter.latest_time().and_then(|latest| filter.estimate_at(latest)).expect("something was observed")
}

/// A filter's estimates of the last seconds and of the next, in enough digits to distinguish any two numbers.
pub(crate) fn state_text(filter: &dyn Filter) -> String {
    let latest = filter.latest_time();
    let instants = (-20..=20).filter_map(|k| Some(latest? + TimeDelta::from_millis(k * 100)));
    let estimates: Vec<_> = instants
        .map(|at| (filter.estimate_at(at), filter.scalar_at(at)))
        .filter(|found| found != &(None, None))
        .collect();
    format!("{latest:?} {estimates:?}")
}

pub(crate) fn start(x_m: f64, y_m: f64, heading_rad: f64) -> StartPose {
    StartPose {
        pose: Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad)),
        position_sigma_m: 0.02,
        heading_sigma_rad: 0.02,
    }
}

pub(crate) fn started_at(x_m: f64, y_m: f64, heading_rad: f64) -> FilterConfig {
    FilterConfig { start: Some(start(x_m, y_m, heading_rad)), ..config() }
}

pub(crate) fn without_start() -> FilterConfig {
    FilterConfig { start: None, ..config() }
}
