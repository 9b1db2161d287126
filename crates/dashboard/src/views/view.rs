//! The interface of a view, and its inputs.

use posebridge_telemetry::{Address, Event, HostClock, LinkId, RobotId, Timestamp};

use super::retained_series::RetentionPolicy;
use crate::feed::{SimulatedTruth, StationStatus};
use crate::model::Frame;

/// One input of a view.
#[derive(Clone, Copy, Debug)]
pub enum ViewInput<'a> {
    /// An event.
    Event(&'a Event),
    /// A sample of the truth.
    Truth(&'a SimulatedTruth),
    /// The current status.
    Status(&'a StationStatus),
}

/// The content of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameContent {
    /// The updates.
    Delta,
    /// The updates, and the data that is sent once a second.
    DeltaAndSummary,
}

/// The configuration of a view.
#[derive(Clone, Debug)]
pub struct ViewConfig {
    /// The URL of each link.
    pub links: Vec<String>,
    /// The points retained for the history.
    pub retention: RetentionPolicy,
}

impl ViewConfig {
    pub(super) fn link_name(&self, link: LinkId) -> String {
        let name = self.links.get(usize::from(link.0));
        name.cloned().unwrap_or_else(|| format!("link {link}"))
    }
}

/// One panel's part of the messages.
pub trait View: Send {
    /// Handles an input at this instant.
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>);

    /// Adds the updates since the last call to a message.
    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent);

    /// Adds the retained data to a history.
    fn add_history(&self, history: &mut Frame);

    /// The points dropped since the start.
    fn dropped(&self) -> u64 {
        0
    }
}

/// A robot as messages name it: link, system and component.
pub fn robot_name(robot: RobotId) -> String {
    robot.path()
}

/// The robot that messages name so.
pub fn parse_robot_name(name: &str) -> Option<RobotId> {
    let mut parts = name.split('/');
    let link = LinkId(parts.next()?.parse().ok()?);
    let address = Address::new(parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let robot = RobotId { link, address };
    // Other spellings of the numbers, such as `+1`, are no names.
    (robot_name(robot) == name).then_some(robot)
}
