//! Views: the panels of the page, and one table of them.
//!
//! A view gets every event in order and adds its updates to the next message and its history to the first one. It has no clock, socket
//! or thread: the same events give the same messages, live and from a recording.

mod links;
mod log;
mod observations;
mod retained_series;
mod robots;
mod status;
mod truth;

use posebridge_telemetry::{Address, Event, HostClock, LinkId, RobotId, Timestamp};

use crate::feed::{SimulatedTruth, StationStatus};
use crate::model::Frame;

pub(crate) use retained_series::MAX_ROBOTS;
pub use retained_series::RetentionPolicy;

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
    fn link_name(&self, link: LinkId) -> String {
        let name = self.links.get(usize::from(link.0));
        name.cloned().unwrap_or_else(|| format!("link {link}"))
    }
}

/// One panel's part of the messages.
pub trait View: Send {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>);

    /// True once after a change.
    fn take_change(&mut self) -> bool {
        false
    }

    /// Adds the updates since the last call: unless a view does better, all that it retains, when it has changed and once a second,
    /// because a reader that was slow may have missed the change.
    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        if self.take_change() || content == FrameContent::DeltaAndSummary {
            self.add_history(frame);
        }
    }

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

pub fn parse_robot_name(name: &str) -> Option<RobotId> {
    let mut parts = name.split('/');
    let link = LinkId(parts.next()?.parse().ok()?);
    let address = Address::new(parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let robot = RobotId { link, address };
    // Other spellings of the numbers, such as `+1`, are no names.
    (robot_name(robot) == name).then_some(robot)
}

/// One of each view.
pub(crate) struct ViewSet(Vec<Box<dyn View>>);

impl ViewSet {
    pub(crate) fn new(links: Vec<String>, retention: RetentionPolicy) -> Self {
        let config = ViewConfig { links, retention };
        Self(VIEWS.iter().map(|entry| (entry.build)(&config)).collect())
    }

    pub(crate) fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        self.0.iter_mut().for_each(|view| view.observe(now, input));
    }

    pub(crate) fn updates(&mut self, now_s: f64, content: FrameContent) -> Frame {
        let mut frame = Frame { now_s, ..Frame::default() };
        self.0.iter_mut().for_each(|view| view.add_updates(&mut frame, content));
        frame
    }

    pub(crate) fn history(&self, now_s: f64) -> Frame {
        let mut history = Frame { now_s, ..Frame::default() };
        self.0.iter().for_each(|view| view.add_history(&mut history));
        history
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.0.iter().map(|view| view.dropped()).sum()
    }
}

/// A row of [`VIEWS`].
pub struct ViewEntry {
    pub name: &'static str,
    pub build: fn(&ViewConfig) -> Box<dyn View>,
}

/// Every view. A new one needs a file here and a line in this table.
pub const VIEWS: &[ViewEntry] = &[
    // First, so that the robots are in the order of detection.
    ViewEntry { name: "robots", build: |_| Box::new(robots::Robots::default()) },
    ViewEntry { name: "estimates", build: |config| Box::new(robots::estimates(config)) },
    ViewEntry { name: "fixes", build: |config| Box::new(observations::fixes(config)) },
    ViewEntry { name: "fusion", build: |config| Box::new(observations::fusion(config)) },
    ViewEntry { name: "tallies", build: |config| Box::new(observations::Tallies::new(config)) },
    ViewEntry { name: "calibration", build: |config| Box::new(status::Calibrations::new(config)) },
    ViewEntry { name: "truth", build: |config| Box::new(truth::Truth::new(config)) },
    ViewEntry { name: "links", build: |config| Box::new(links::Links::new(config)) },
    ViewEntry { name: "clock", build: |_| Box::new(links::Clock::default()) },
    ViewEntry { name: "log", build: |config| Box::new(log::Log::new(config)) },
    ViewEntry { name: "parameters", build: |_| Box::new(status::parameters()) },
    ViewEntry { name: "switches", build: |_| Box::new(status::Switches::default()) },
    ViewEntry { name: "simulator", build: |_| Box::new(status::simulator()) },
];

#[cfg(test)]
pub(crate) mod tests;
