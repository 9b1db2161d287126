//! How often the states of robots are published, so that they leave room for estimates.

use std::collections::BTreeMap;

use posebridge_fleet::RobotName;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// Bytes of states per second of a whole station, a third of what a wireless network of a room carries. With 122 kB for a robot with all
/// sensors that is 32 robots each second; with more, each is published less often.
const MAX_BYTES_PER_S: usize = 4_000_000;

#[derive(Debug, Default)]
pub(super) struct StateSchedule {
    robots: BTreeMap<RobotName, PublishedState>,
    total_len: usize,
}

#[derive(Clone, Copy, Debug)]
struct PublishedState {
    at: Timestamp<HostClock>,
    len: usize,
}

impl StateSchedule {
    /// Whether the robot's state may be published again.
    pub(super) fn is_due(&self, now: Timestamp<HostClock>, robot: &RobotName) -> bool {
        let interval_s = self.total_len as f64 / MAX_BYTES_PER_S as f64;
        // At the least interval the owner's own schedule decides.
        interval_s <= 1.0
            || self.robots.get(robot).is_none_or(|last| now - last.at >= TimeDelta::from_secs_f64(interval_s))
    }

    pub(super) fn record(&mut self, now: Timestamp<HostClock>, robot: &RobotName, len: usize) {
        let before = self.robots.insert(robot.clone(), PublishedState { at: now, len });
        self.total_len = self.total_len + len - before.map_or(0, |before| before.len);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_robots_share_the_rate() {
        let mut schedule = StateSchedule::default();
        let names: Vec<RobotName> = (0..400).map(|number| RobotName::new(&format!("r{number}")).unwrap()).collect();
        let at = Timestamp::from_millis;
        for name in &names[..100] {
            schedule.record(at(0), name, 40_000);
        }
        assert!(schedule.is_due(at(900), &names[0]), "4 MB: the owner's own interval");
        for name in &names {
            schedule.record(at(1_000), name, 40_000);
        }
        assert!(!schedule.is_due(at(4_999), &names[0]) && schedule.is_due(at(5_000), &names[0]), "16 MB: 4 s");
    }
}
