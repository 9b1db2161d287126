//! Dead reckoning by the wheels alone, for the page: the filter `odometry` beside the one that sends.

use posebridge_dashboard::{DeadReckoning, DeadReckoningBuilder};
use posebridge_estimator::{Filter, FilterConfig, find_filter};
use posebridge_telemetry::{BrickClock, Observation, Odom, Pose, Timestamp};

const FILTER: &str = "odometry";

struct WheelOdometry {
    filter: Box<dyn Filter>,
    last: Option<Timestamp<BrickClock>>,
}

/// With the noise and the parameters of the configuration, and the geometry of each robot. `None` if there is no such filter.
pub(super) fn dead_reckoning(config: FilterConfig) -> Option<DeadReckoningBuilder> {
    let build = find_filter(FILTER)?.build;
    Some(DeadReckoningBuilder::new(move |geometry| {
        // It counts from its start: the page knows where that is.
        let config = FilterConfig { geometry, start: None, ..config.clone() };
        Box::new(WheelOdometry { filter: build(&config), last: None })
    }))
}

impl DeadReckoning for WheelOdometry {
    fn observe(&mut self, observation: &Observation) -> Option<Pose<Odom>> {
        self.filter.observe(observation);
        let latest = self.filter.latest_time()?;
        if self.last == Some(latest) {
            return None;
        }
        self.last = Some(latest);
        let pose = self.filter.estimate_at(latest)?.pose;
        Some(Pose::new(pose.x, pose.y, pose.heading))
    }

    fn restart_clock(&mut self) {
        self.filter.restart_clock();
    }
}
