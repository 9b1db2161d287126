//! What happened, made into what is shown: one file per panel, and one table.
//!
//! A view is a value that is given everything that happens, in its order, and says what of it is new and what of it belongs into
//! the history. It knows no clock, no socket and no thread: the same events give the same messages, live and from a recording.

mod calibration;
mod clock;
mod estimates;
mod fixes;
mod fusion;
mod links;
mod log;
mod parameters;
mod robots;
mod simulator;
mod switches;
mod tallies;
mod trail;
mod truth;

pub use trail::Keep;

use posebridge_telemetry::{Event, HostClock, LinkId, RobotId, Stamp};

use crate::feed::{Standing, TruthSample};
use crate::model::Frame;

/// One thing that a view is told.
#[derive(Clone, Copy, Debug)]
pub enum Told<'a> {
    /// Something happened.
    Event(&'a Event),
    /// Where the simulated robot was.
    Truth(&'a TruthSample),
    /// What stands.
    Standing(&'a Standing),
}

/// What belongs into a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// What is new.
    News,
    /// That, and what is told once a second.
    Second,
}

/// What a view is built from.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The URL of each link.
    pub links: Vec<String>,
    /// What is kept for the history.
    pub keep: Keep,
}

impl Setting {
    fn link_name(&self, link: LinkId) -> String {
        let name = self.links.get(usize::from(link.0));
        name.cloned().unwrap_or_else(|| format!("link {link}"))
    }
}

/// One panel's share of the messages.
pub trait View: Send {
    /// Takes note of what happened at this instant.
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>);

    /// Puts what is new since the last time into a message.
    fn add_news(&mut self, frame: &mut Frame, pace: Pace);

    /// Puts what is kept into a history.
    fn add_history(&self, history: &mut Frame);

    /// So many points found no room since the beginning.
    fn dropped(&self) -> u64 {
        0
    }
}

/// A row of [`VIEWS`].
pub struct ViewEntry {
    /// The panel's name.
    pub name: &'static str,
    /// Builds it.
    pub build: fn(&Setting) -> Box<dyn View>,
}

macro_rules! views {
    ($($module:ident::$view:ident),+ $(,)?) => {
        /// Every view. Adding one: a file here and a line in this table.
        pub const VIEWS: &[ViewEntry] = &[
            $(ViewEntry {
                name: stringify!($module),
                build: |setting| Box::new($module::$view::new(setting)),
            }),+
        ];
    };
}

views![
    // First, so that the robots stand in the order in which they were heard.
    robots::Robots,
    estimates::Estimates,
    fixes::Fixes,
    fusion::Fusion,
    tallies::Tallies,
    calibration::Calibrations,
    truth::Truth,
    links::Links,
    clock::Clock,
    log::Log,
    parameters::Parameters,
    switches::Switches,
    simulator::Simulator,
];

/// A robot as messages name it: link, system and component.
#[must_use]
pub fn robot_name(robot: RobotId) -> String {
    format!("{}/{}", robot.link, robot.address)
}

#[cfg(test)]
pub(crate) mod tests;
