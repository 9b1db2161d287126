//! Labels of the robots of a session, for tables, files and topics.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, RobotId};

/// Limit of robots with names; others are labelled by their ids.
const MAX_NAMES: usize = 1_024;

/// Unique labels of robots: the name, else the ids. If two robots have one name, the ids of the second are appended.
#[derive(Debug, Default)]
pub struct RobotNames {
    names: BTreeMap<RobotId, String>,
}

impl RobotNames {
    pub fn observe(&mut self, event: &Event) {
        if let Event::RobotNamed { robot, name } = event {
            self.insert(*robot, name);
        }
    }

    /// Stores the name of a robot. An empty name, and one beyond the limit, is ignored.
    pub fn insert(&mut self, robot: RobotId, name: &str) {
        if name.is_empty() || self.names.len() >= MAX_NAMES {
            return;
        }
        let mut label = name.to_owned();
        // One block of a configuration may match several robots, and its name is then that of all of them.
        while reads_as_id(&label) || self.is_taken(robot, &label) {
            label = format!("{label} {}", id_text(robot));
        }
        self.names.insert(robot, label);
    }

    fn is_taken(&self, robot: RobotId, label: &str) -> bool {
        self.names.iter().any(|(other, taken)| *other != robot && taken == label)
    }

    pub fn get(&self, robot: RobotId) -> Option<&str> {
        self.names.get(&robot).map(String::as_str)
    }

    /// The name, else the ids as `link/system/component`.
    pub fn label(&self, robot: RobotId) -> String {
        self.get(robot).map_or_else(|| id_text(robot), str::to_owned)
    }
}

/// Link, system and component: `0/1/1`.
fn id_text(robot: RobotId) -> String {
    format!("{}/{}", robot.link, robot.address)
}

/// Whether a name looks like the ids of a robot, possibly another one's.
fn reads_as_id(name: &str) -> bool {
    name.split('/').count() == 3 && name.split('/').all(|part| part.parse::<u16>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, LinkId};

    fn id(system: u8) -> RobotId {
        RobotId { link: LinkId(3), address: Address::new(system, 1) }
    }

    fn named(robot: RobotId, name: &str) -> Event {
        Event::RobotNamed { robot, name: name.to_owned() }
    }

    #[test]
    fn two_robots_with_one_name_stay_apart() {
        let mut names = RobotNames::default();
        for event in [named(id(1), "red"), named(id(2), "red"), named(id(1), "red"), named(id(4), "")] {
            names.observe(&event);
        }
        assert_eq!([1, 2, 4].map(|system| names.label(id(system))), ["red", "red 3/2/1", "3/4/1"]);
    }

    #[test]
    fn a_name_that_is_spelled_like_another_label_is_no_second_one() {
        let mut names = RobotNames::default();
        for (system, name) in [(1, "red"), (2, "red 3/4/1"), (3, "3/5/1"), (4, "red")] {
            names.insert(id(system), name);
        }
        let labels = [1, 2, 3, 4, 5].map(|system| names.label(id(system)));
        assert_eq!(labels, ["red", "red 3/4/1", "3/5/1 3/3/1", "red 3/4/1 3/4/1", "3/5/1"]);
    }
}
