//! The robots that a station knows, up to a limit.

use std::collections::BTreeMap;

use posebridge_telemetry::{HostClock, Timestamp};

use crate::names::RobotName;
use crate::robot_entry::RobotEntry;

/// Where the table is full, robots of this station displace others, and others displace only robots that nobody owns.
#[derive(Clone, Debug)]
pub(crate) struct RobotTable {
    entries: BTreeMap<RobotName, RobotEntry>,
    limit: usize,
}

impl RobotTable {
    pub(crate) const fn new(limit: usize) -> Self {
        Self { entries: BTreeMap::new(), limit }
    }

    pub(crate) fn get(&self, robot: &RobotName) -> Option<&RobotEntry> {
        self.entries.get(robot)
    }

    pub(crate) fn get_mut(&mut self, robot: &RobotName) -> Option<&mut RobotEntry> {
        self.entries.get_mut(robot)
    }

    /// The entry of a robot that is heard here; `None` if the table is full of such.
    pub(crate) fn heard(&mut self, robot: &RobotName, now: Timestamp<HostClock>) -> Option<&mut RobotEntry> {
        if !self.entries.contains_key(robot) {
            if self.entries.len() >= self.limit {
                let displaced = self.oldest(|entry| entry.tokens.is_empty()).or_else(|| self.oldest(|_| true))?;
                self.entries.remove(&displaced);
            }
            self.entries.insert(robot.clone(), RobotEntry::new(now));
        }
        self.touch(robot, now)
    }

    /// The entry of a robot that another station tells of; `None` if the table is full of robots that are heard or owned.
    pub(crate) fn reported(&mut self, robot: &RobotName, now: Timestamp<HostClock>) -> Option<&mut RobotEntry> {
        if !self.entries.contains_key(robot) {
            if self.entries.len() >= self.limit {
                let displaced = self.oldest(|entry| entry.tokens.is_empty())?;
                self.entries.remove(&displaced);
            }
            self.entries.insert(robot.clone(), RobotEntry::new(now));
        }
        self.touch(robot, now)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&RobotName, &RobotEntry)> {
        self.entries.iter()
    }

    /// The names of the robots whose entries fit.
    pub(crate) fn names(&self, fits: impl Fn(&RobotEntry) -> bool) -> Vec<RobotName> {
        self.entries.iter().filter(|(_, entry)| fits(entry)).map(|(robot, _)| robot.clone()).collect()
    }

    fn touch(&mut self, robot: &RobotName, now: Timestamp<HostClock>) -> Option<&mut RobotEntry> {
        let entry = self.entries.get_mut(robot)?;
        entry.last_used = now;
        Some(entry)
    }

    /// Of the robots that are neither heard nor owned here.
    fn oldest(&self, fits: impl Fn(&RobotEntry) -> bool) -> Option<RobotName> {
        let candidates = self.entries.iter().filter(|(_, entry)| !entry.is_local() && fits(entry));
        candidates.min_by_key(|(_, entry)| entry.last_used).map(|(robot, _)| robot.clone())
    }
}
