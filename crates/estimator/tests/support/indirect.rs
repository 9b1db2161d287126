//! The indirect filter's robot and how its filters are asked.

use posebridge_estimator::{Filter, FilterConfig, find_filter};
use posebridge_telemetry::{BrickClock, Estimate, Timestamp};

pub(crate) const STEP_S: f64 = 0.05;
/// 400 ug per root Hz (MPU-6050 data sheet) over the 10 Hz that 20 samples a second leave.
pub(crate) const ACCELEROMETER_M_PER_S2: f64 = 0.012;

pub(crate) fn built(name: &str, config: &FilterConfig) -> Box<dyn Filter> {
    (find_filter(name).expect("it is in the table").build)(config)
}

pub(crate) fn latest(filter: &dyn Filter) -> Estimate {
    let at: Timestamp<BrickClock> = filter.latest_time().unwrap();
    filter.estimate_at(at).expect("something was observed")
}
