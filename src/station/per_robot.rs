//! One value for each robot of a session, made at the robot's first event.

use posebridge_telemetry::{Event, RobotId};

/// A value for each robot. There is always a first one: before any robot was heard it belongs to none.
pub struct PerRobot<T> {
    entries: Vec<RobotEntry<T>>,
    make: Box<dyn Fn() -> T + Send>,
}

/// One robot's value.
#[derive(Debug)]
pub struct RobotEntry<T> {
    /// The robot; `None` if none was heard.
    pub robot: Option<RobotId>,
    /// Its configured name, if it has one.
    pub name: Option<String>,
    /// What is kept of it.
    pub value: T,
}

impl<T> RobotEntry<T> {
    /// What people call it: its name, or `link/system/component`; empty if none was heard.
    #[must_use]
    pub fn label(&self) -> String {
        let id = self.robot.map_or_else(String::new, |robot| format!("{}/{}", robot.link, robot.address));
        self.name.clone().unwrap_or(id)
    }
}

/// A robot's label as a part of a file's name: a robot may have any name.
#[must_use]
pub fn file_part(label: &str) -> String {
    label.replace(|letter: char| !letter.is_ascii_alphanumeric(), "-")
}

impl<T> PerRobot<T> {
    /// A first value, made as those of further robots are.
    pub fn new(make: impl Fn() -> T + Send + 'static) -> Self {
        let first = RobotEntry { robot: None, name: None, value: make() };
        Self { entries: vec![first], make: Box::new(make) }
    }

    /// The robots, in the order in which they were heard.
    #[must_use]
    pub fn entries(&self) -> &[RobotEntry<T>] {
        &self.entries
    }

    /// The same, to be changed.
    pub fn entries_mut(&mut self) -> &mut [RobotEntry<T>] {
        &mut self.entries
    }

    /// The same, given away.
    #[must_use]
    pub fn into_entries(self) -> Vec<RobotEntry<T>> {
        self.entries
    }

    /// Gives a robot's event to its own value, and any other to all.
    ///
    /// # Errors
    /// As `push` does.
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

    /// Gives a robot's event to its own value, and any other to all.
    pub fn push(&mut self, event: &Event, mut push: impl FnMut(&mut T, &Event)) {
        match self.route(event) {
            Some(robot) => push(&mut self.entry(robot).value, event),
            None => self.entries.iter_mut().for_each(|entry| push(&mut entry.value, event)),
        }
    }

    /// The robot that an event is for; a robot's name is kept on the way.
    fn route(&mut self, event: &Event) -> Option<RobotId> {
        if let Event::RobotNamed { robot, name } = event {
            // One block may match two robots; in tables their rows need names of their own.
            let is_taken =
                self.entries.iter().any(|entry| entry.robot != Some(*robot) && entry.name.as_ref() == Some(name));
            let entry = self.entry(*robot);
            entry.name = None;
            entry.name = Some(if is_taken { format!("{name} {}", entry.label()) } else { name.clone() });
        }
        robot_of(event)
    }

    fn entry(&mut self, robot: RobotId) -> &mut RobotEntry<T> {
        let known = self.entries.iter().position(|entry| entry.robot.is_none_or(|known| known == robot));
        let index = known.unwrap_or_else(|| {
            self.entries.push(RobotEntry { robot: None, name: None, value: (self.make)() });
            self.entries.len() - 1
        });
        let entry = &mut self.entries[index];
        entry.robot = Some(robot);
        entry
    }
}

/// The robot that an event is about. Senders that are heard or lost may also be cameras and ground stations.
const fn robot_of(event: &Event) -> Option<RobotId> {
    match event {
        Event::RobotNamed { robot, .. }
        | Event::BrickRestarted { robot }
        | Event::ObservationAligned { robot, .. }
        | Event::ObservationFused { robot, .. }
        | Event::EstimateUpdated { robot, .. }
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
        let found: Vec<_> = restarts.entries().iter().map(|entry| (entry.label(), entry.value)).collect();
        assert_eq!(
            found,
            [("0/1/1".to_owned(), (1, 2)), ("left".to_owned(), (2, 1)), ("left 0/3/1".to_owned(), (0, 1))]
        );
    }
}
