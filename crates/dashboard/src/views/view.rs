//! The interface of a view.

use posebridge_telemetry::{Address, Event, HostClock, LinkId, RobotId, Timestamp};

use super::retained_series::RetentionPolicy;
use crate::feed::{SimulatedTruth, StationStatus};
use crate::model::Frame;

/// An event, truth sample or status for a view.
#[derive(Clone, Copy, Debug)]
pub enum ViewInput<'a> {
    Event(&'a Event),
    Truth(&'a SimulatedTruth),
    Status(&'a StationStatus),
}

/// The content of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameContent {
    Delta,
    /// Updates and the data that is sent once a second.
    DeltaAndSummary,
}

/// The links and the history length of a view.
#[derive(Clone, Debug)]
pub struct ViewConfig {
    pub links: Vec<String>,
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
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>);

    /// Adds the updates since the last call.
    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent);

    /// Adds the retained data.
    fn add_history(&self, history: &mut Frame);

    /// Points dropped since the start.
    fn dropped(&self) -> u64 {
        0
    }
}

pub fn robot_name(robot: RobotId) -> String {
    robot.path()
}

/// Inverse of `robot_name`.
pub fn parse_robot_name(name: &str) -> Option<RobotId> {
    let mut parts = name.split('/');
    let link = LinkId(parts.next()?.parse().ok()?);
    let address = Address::new(parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let robot = RobotId { link, address };
    // Other spellings of the numbers, such as `+1`, are no names.
    (robot_name(robot) == name).then_some(robot)
}
