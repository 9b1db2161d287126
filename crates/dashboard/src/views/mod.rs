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
mod view;

pub(crate) use retained_series::MAX_ROBOTS;
pub use retained_series::RetentionPolicy;
pub use view::{FrameContent, View, ViewConfig, ViewInput, parse_robot_name, robot_name};

/// A row of [`VIEWS`].
pub struct ViewEntry {
    pub name: &'static str,
    pub build: fn(&ViewConfig) -> Box<dyn View>,
}

/// Every view. A new one needs a file here and a line in this table.
pub const VIEWS: &[ViewEntry] = &[
    // First, so that the robots are in the order of detection.
    ViewEntry { name: "robots", build: |_| Box::new(robots::Robots::default()) },
    ViewEntry { name: "estimates", build: |config| Box::new(robots::Estimates::new(config)) },
    ViewEntry { name: "fixes", build: |config| Box::new(observations::Fixes::new(config)) },
    ViewEntry { name: "fusion", build: |config| Box::new(observations::Fusion::new(config)) },
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
