//! What people call the robots of a session.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, RobotId};

/// Most robots that are called by their names; those beyond go by their ids.
const MAX_NAMES: usize = 1_024;

/// The names that events gave to robots, no two alike.
#[derive(Debug, Default)]
pub(crate) struct RobotNames {
    names: BTreeMap<RobotId, String>,
}

impl RobotNames {
    /// Keeps the name that an event gives to a robot.
    pub(crate) fn observe(&mut self, event: &Event) {
        let Event::RobotNamed { robot, name } = event else {
            return;
        };
        if name.is_empty() || self.names.len() >= MAX_NAMES {
            return;
        }
        // One block of a configuration may match several robots, and its name is then that of all of them.
        let is_taken = self.names.iter().any(|(other, taken)| other != robot && taken == name);
        let name = if is_taken { format!("{name} {}", id_text(*robot)) } else { name.clone() };
        self.names.insert(*robot, name);
    }

    /// The name of a robot, if an event gave it one.
    pub(crate) fn get(&self, robot: RobotId) -> Option<&str> {
        self.names.get(&robot).map(String::as_str)
    }

    /// The name of a robot, else its ids.
    pub(crate) fn label(&self, robot: RobotId) -> String {
        self.get(robot).map_or_else(|| id_text(robot), str::to_owned)
    }
}

/// Link, system and component: `0/1/1`.
fn id_text(robot: RobotId) -> String {
    format!("{}/{}", robot.link, robot.address)
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
}
