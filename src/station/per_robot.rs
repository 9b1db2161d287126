//! One value for each robot of a session, created at the robot's first event.

use std::collections::BTreeSet;

use posebridge_recording::robot_names::RobotNames;
use posebridge_telemetry::{Event, RobotId};

/// A value for each robot. The first exists before any robot was seen.
pub struct PerRobot<T> {
    entries: Vec<RobotEntry<T>>,
    names: RobotNames,
    make: Box<dyn Fn() -> T + Send>,
}

#[derive(Debug)]
pub struct RobotEntry<T> {
    /// `None` before any robot was seen.
    pub robot: Option<RobotId>,
    /// Name, or `link/system/component`; unique. Empty before any robot was seen.
    pub label: String,
    pub value: T,
}

/// The labels of robots as parts of file names, in order. A robot may have any name; the parts are unique, also on file systems that
/// ignore case.
pub fn file_parts<'a>(labels: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let unique = |label: &str| {
        let part = label.replace(|letter: char| !letter.is_ascii_alphanumeric(), "-");
        let mut unique = part.clone();
        let mut number = 1;
        while !taken.insert(unique.to_ascii_lowercase()) {
            number += 1;
            unique = format!("{part}-{number}");
        }
        unique
    };
    labels.into_iter().map(unique).collect()
}

impl<T> PerRobot<T> {
    pub fn new(make: impl Fn() -> T + Send + 'static) -> Self {
        let first = RobotEntry { robot: None, label: String::new(), value: make() };
        Self { entries: vec![first], names: RobotNames::default(), make: Box::new(make) }
    }

    /// In the order of the robots' first events.
    pub fn entries(&self) -> &[RobotEntry<T>] {
        &self.entries
    }

    pub fn entries_mut(&mut self) -> &mut [RobotEntry<T>] {
        &mut self.entries
    }

    pub fn into_entries(self) -> Vec<RobotEntry<T>> {
        self.entries
    }

    /// Passes a robot's event to its own value, and any other to all.
    pub fn try_push<E>(
        &mut self,
        event: &Event,
        mut push: impl FnMut(&mut T, &Event) -> Result<(), E>,
    ) -> Result<(), E> {
        match self.route(event) {
            Some(robot) => push(&mut self.entry(robot).value, event),
            None => self.entries.iter_mut().try_for_each(|entry| push(&mut entry.value, event)),
        }
    }

    /// Passes a robot's event to its own value, and any other to all.
    pub fn push(&mut self, event: &Event, mut push: impl FnMut(&mut T, &Event)) {
        match self.route(event) {
            Some(robot) => push(&mut self.entry(robot).value, event),
            None => self.entries.iter_mut().for_each(|entry| push(&mut entry.value, event)),
        }
    }

    /// The robot of an event; also stores a robot's name.
    fn route(&mut self, event: &Event) -> Option<RobotId> {
        if let Event::RobotNamed { robot, .. } = event {
            self.names.observe(event);
            let label = self.names.label(*robot);
            self.entry(*robot).label = label;
        }
        robot_of(event)
    }

    fn entry(&mut self, robot: RobotId) -> &mut RobotEntry<T> {
        let known = self.entries.iter().position(|entry| entry.robot == Some(robot));
        let index = known.unwrap_or_else(|| self.add(robot));
        &mut self.entries[index]
    }

    /// The first robot takes the value that existed before.
    fn add(&mut self, robot: RobotId) -> usize {
        let label = self.names.label(robot);
        match self.entries.first_mut() {
            Some(first) if first.robot.is_none() => {
                first.robot = Some(robot);
                first.label = label;
                0
            }
            _ => {
                self.entries.push(RobotEntry { robot: Some(robot), label, value: (self.make)() });
                self.entries.len() - 1
            }
        }
    }
}

/// The robot of an event. Events about senders are excluded: these may also be cameras and ground stations.
const fn robot_of(event: &Event) -> Option<RobotId> {
    match event {
        Event::RobotNamed { robot, .. }
        | Event::BrickRestarted { robot }
        | Event::ObservationAligned { robot, .. }
        | Event::ObservationFused { robot, .. }
        | Event::EstimateUpdated { robot, .. }
        | Event::ObservationCompared { robot, .. }
        | Event::EstimateCompared { robot, .. }
        | Event::QuantityUpdated { robot, .. }
        | Event::BrickClockAligned { robot, .. } => Some(*robot),
        Event::RobotDetected { .. }
        | Event::RobotLost { .. }
        | Event::Temperature { .. }
        | Event::CameraClockAligned { .. }
        | Event::Link { .. }
        | Event::Health { .. }
        | Event::ReceiveError { .. }
        | Event::Text { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Address, LinkId, LinkState};

    use super::*;

    #[test]
    fn a_robots_events_are_its_own_and_those_of_links_are_everybodys() {
        let robot = |system| RobotId { link: LinkId(0), address: Address::new(system, 1) };
        let mut restarts = PerRobot::new(|| (0, 0));
        let mut push = |event: Event| {
            restarts.push(&event, |(restarts, links), event| {
                *restarts += i32::from(matches!(event, Event::BrickRestarted { .. }));
                *links += i32::from(matches!(event, Event::Link { .. }));
            });
        };
        push(Event::Link { link: LinkId(0), state: LinkState::Up });
        push(Event::BrickRestarted { robot: robot(1) });
        push(Event::RobotNamed { robot: robot(2), name: "left".to_owned() });
        push(Event::RobotNamed { robot: robot(3), name: "left".to_owned() });
        push(Event::BrickRestarted { robot: robot(2) });
        push(Event::BrickRestarted { robot: robot(2) });
        push(Event::Link { link: LinkId(0), state: LinkState::Down });
        let found: Vec<_> = restarts.entries().iter().map(|entry| (entry.label.clone(), entry.value)).collect();
        assert_eq!(
            found,
            [("0/1/1".to_owned(), (1, 2)), ("left".to_owned(), (2, 1)), ("left 0/3/1".to_owned(), (0, 1))]
        );
    }

    #[test]
    fn no_two_robots_share_a_file() {
        let parts = file_parts(["a 1", "a-1", "A-1", "a-1-2", "0/1/1"]);
        assert_eq!(parts, ["a-1", "a-1-2", "A-1-3", "a-1-2-2", "0-1-1"]);
    }
}
