//! State for the messages of each robot: topics, frame, clock, thinning, path.

use std::collections::BTreeMap;
use std::sync::Arc;

use posebridge_telemetry::{Arena, BrickClock, Estimate, Event, HostClock, Pose, RobotId, SensorId, Timestamp};

use super::channels::EncodedMessage;
use super::wire::{BODY, START};
use crate::clock_alignment::ClockAlignmentPoint;
use crate::robot_names::RobotNames;

/// Robots with topics: the station's default limit.
const MAX_ROBOTS: usize = 64;
/// A longer name is cut in topics.
const MAX_SEGMENT_CHARS: usize = 50;
/// Poses of the path; when full, every second one is dropped.
const PATH_POSES: usize = 256;

/// The robots of a session; all but the first have topics of their own.
#[derive(Debug, Default)]
pub(super) struct RobotOutputsTable {
    first: RobotOutputs,
    first_id: Option<RobotId>,
    others: BTreeMap<RobotId, RobotOutputs>,
    names: RobotNames,
    skipped: u64,
    is_overflow_reported: bool,
}

#[derive(Debug)]
pub(super) struct RobotOutputs {
    /// The robot's name in its topics; `None` for the first, whose topics are those of a recording of one robot.
    segment: Option<Arc<str>>,
    /// Name of [`posebridge_telemetry::Body`] of this robot in messages.
    pub(super) body_frame: String,
    /// Name of the frame of its poses while they are relative.
    pub(super) start_frame: String,
    pub(super) alignment: Option<ClockAlignmentPoint>,
    pub(super) last_estimate: Option<Timestamp<HostClock>>,
    pub(super) last_fusions: BTreeMap<(SensorId, &'static str), Option<Timestamp<HostClock>>>,
    /// By filter.
    pub(super) last_compared_estimates: BTreeMap<&'static str, Option<Timestamp<HostClock>>>,
    pub(super) last_compared_fusions: BTreeMap<(&'static str, SensorId, &'static str), Option<Timestamp<HostClock>>>,
    pub(super) path: PathHistory,
}

#[derive(Debug, Default)]
pub(super) struct PathHistory {
    pub(super) poses: Vec<Pose<Arena>>,
    is_relative: bool,
    stride: usize,
    pose_count: usize,
    pub(super) last_written: Option<Timestamp<HostClock>>,
}

impl RobotOutputsTable {
    /// Stores the robot's name from an event, for topics that are not in use yet.
    pub(super) fn observe_name(&mut self, event: &Event) {
        self.names.observe(event);
    }

    /// The state of a robot; `None` is the first, and so is a robot id without a link. Adds an unknown robot, or counts it if the table
    /// is full.
    pub(super) fn get_or_add(&mut self, robot: Option<RobotId>) -> Option<&mut RobotOutputs> {
        let Some(robot) = robot.filter(|robot| *robot != RobotId::default()) else {
            return Some(&mut self.first);
        };
        if *self.first_id.get_or_insert(robot) == robot {
            return Some(&mut self.first);
        }
        if !self.others.contains_key(&robot) {
            if self.others.len() + 1 >= MAX_ROBOTS {
                self.skipped += 1;
                return None;
            }
            let added = RobotOutputs::new(&self.free_segment(robot));
            self.others.insert(robot, added);
        }
        self.others.get_mut(&robot)
    }

    /// `None` unless the robot was added before.
    pub(super) fn find_other(&self, robot: RobotId) -> Option<&RobotOutputs> {
        self.others.get(&robot)
    }

    /// Requests for robots without topics.
    pub(super) const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The warning about robots without topics, once.
    pub(super) fn take_overflow_warning(&mut self) -> Option<String> {
        if self.skipped == 0 || self.is_overflow_reported {
            return None;
        }
        self.is_overflow_reported = true;
        Some(format!("there are more than {MAX_ROBOTS} robots: the others have no topics here, but a replay has them"))
    }

    /// The robot's name in characters that every viewer accepts in a topic, else its ids; unique.
    fn free_segment(&self, robot: RobotId) -> String {
        let ids = format!("{}_{}_{}", robot.link, robot.address.system, robot.address.component);
        let is_safe = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
        let name = self.names.get(robot).unwrap_or_default().chars().take(MAX_SEGMENT_CHARS);
        let name: String = name.map(|letter| if is_safe(letter) { letter } else { '_' }).collect();
        let preferred = if name.contains(is_safe) { name } else { ids.clone() };
        let alternatives = (2..=MAX_ROBOTS).map(|number| format!("{preferred}_{number}"));
        let is_free = |segment: &String| !self.others.values().any(|other| other.segment.as_deref() == Some(segment));
        let mut candidates = std::iter::once(preferred.clone()).chain(alternatives).filter(is_free);
        candidates.next().unwrap_or(ids)
    }
}

impl RobotOutputs {
    fn new(segment: &str) -> Self {
        let frame = |name: &str| format!("{segment}/{name}");
        Self { body_frame: frame(BODY), start_frame: frame(START), segment: Some(segment.into()), ..Self::default() }
    }

    pub(super) fn assign(&self, messages: &mut [EncodedMessage]) {
        for message in messages {
            message.robot.clone_from(&self.segment);
        }
    }

    /// Label of an estimate in viewers; with one robot it has no name.
    pub(super) fn estimate_name(&self) -> String {
        self.segment.as_ref().map_or_else(|| "the estimate".to_owned(), |segment| format!("the estimate of {segment}"))
    }

    /// Converts brick time to host time; `None` before the first alignment.
    pub(super) fn host_time(&self, brick: Timestamp<BrickClock>) -> Option<Timestamp<HostClock>> {
        Some(self.alignment?.host_time(brick))
    }
}

impl Default for RobotOutputs {
    fn default() -> Self {
        Self {
            segment: None,
            body_frame: BODY.to_owned(),
            start_frame: START.to_owned(),
            alignment: None,
            last_estimate: None,
            last_fusions: BTreeMap::new(),
            last_compared_estimates: BTreeMap::new(),
            last_compared_fusions: BTreeMap::new(),
            path: PathHistory::default(),
        }
    }
}

impl PathHistory {
    /// Of poses that count from another origin than the last one the path begins anew.
    pub(super) fn push(&mut self, estimate: &Estimate) {
        if self.is_relative != estimate.is_relative() {
            let last_written = self.last_written;
            *self = Self { is_relative: estimate.is_relative(), last_written, ..Self::default() };
        }
        self.stride = self.stride.max(1);
        if self.pose_count.is_multiple_of(self.stride) {
            self.poses.push(estimate.pose);
        }
        self.pose_count += 1;
        if self.poses.len() >= PATH_POSES {
            let mut is_kept = false;
            self.poses.retain(|_| {
                is_kept = !is_kept;
                is_kept
            });
            self.stride *= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkId};

    fn id(system: u8) -> RobotId {
        RobotId { link: LinkId(3), address: Address::new(system, 1) }
    }

    fn segment(table: &mut RobotOutputsTable, robot: RobotId, name: &str) -> Option<String> {
        table.observe_name(&Event::RobotNamed { robot, name: name.to_owned() });
        let outputs = table.get_or_add(Some(robot)).unwrap();
        outputs.segment.as_deref().map(str::to_owned)
    }

    #[test]
    fn names_become_safe_in_topics_and_stay_apart() {
        let mut table = RobotOutputsTable::default();
        assert_eq!(segment(&mut table, id(1), "first"), None);
        for (system, name, expected) in [
            (2, "left", "left"),
            (3, "a/b #1", "a_b__1"),
            (4, "a b/#1", "a_b__1_2"),
            (5, "", "3_5_1"),
            (6, "\u{e4}/", "3_6_1"),
        ] {
            assert_eq!(segment(&mut table, id(system), name).as_deref(), Some(expected), "{name}");
        }
        assert_eq!(segment(&mut table, id(7), &"x".repeat(60)), Some("x".repeat(50)));
        // A name that comes late does not move what is written already.
        assert_eq!(segment(&mut table, id(5), "late").as_deref(), Some("3_5_1"));
    }

    #[test]
    fn the_id_of_a_robot_that_was_not_heard_yet_is_that_of_the_first() {
        let mut table = RobotOutputsTable::default();
        let point = ClockAlignmentPoint { host: Timestamp::ZERO, brick: Timestamp::ZERO, skew_ppm: 0.0 };
        table.get_or_add(Some(RobotId::default())).unwrap().alignment = Some(point);
        assert!(table.get_or_add(Some(id(1))).unwrap().alignment.is_some());
        assert!(table.get_or_add(None).unwrap().alignment.is_some());
        assert!(table.get_or_add(Some(id(2))).unwrap().alignment.is_none());
    }

    #[test]
    fn robots_beyond_the_limit_are_counted_and_told_once() {
        let mut table = RobotOutputsTable::default();
        for system in 1..=64 {
            assert!(table.get_or_add(Some(id(system))).is_some(), "{system}");
        }
        assert_eq!(table.take_overflow_warning(), None);
        for system in [65, 66, 66] {
            assert!(table.get_or_add(Some(id(system))).is_none(), "{system}");
        }
        assert!(table.get_or_add(Some(id(64))).is_some());
        assert_eq!(table.skipped(), 3);
        assert!(table.take_overflow_warning().is_some());
        assert_eq!(table.take_overflow_warning(), None);
    }
}
