//! Views: the panels of the page, and one table of them.
//!
//! A view gets every event in order and adds its updates to the next message and its history to the first one. It has no clock, socket
//! or thread: the same events give the same messages, live and from a recording.

mod comparison;
mod links;
mod log;
mod observations;
mod odometry;
mod quantities;
mod retained_series;
mod robots;
mod status;
mod truth;
mod truth_samples;
mod view;

use posebridge_telemetry::{HostClock, Timestamp};

use crate::model::Frame;

pub(crate) use retained_series::MAX_ROBOTS;
pub use view::{FrameContent, RetentionPolicy, View, ViewConfig, ViewInput, parse_robot_name, robot_name};

/// One of each view.
pub(crate) struct ViewSet(Vec<Box<dyn View>>);

impl ViewSet {
    pub(crate) fn new(config: &ViewConfig) -> Self {
        Self(VIEWS.iter().map(|entry| (entry.build)(config)).collect())
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
    ViewEntry { name: "odometry", build: |config| Box::new(odometry::Odometry::new(config)) },
    ViewEntry { name: "fixes", build: |config| Box::new(observations::fixes(config)) },
    ViewEntry { name: "fusion", build: |config| Box::new(observations::fusion(config)) },
    ViewEntry { name: "tallies", build: |config| Box::new(observations::Tallies::new(config)) },
    ViewEntry { name: "quantities", build: |config| Box::new(quantities::quantities(config)) },
    ViewEntry { name: "thermometers", build: |config| Box::new(quantities::thermometers(config)) },
    ViewEntry { name: "compared paths", build: |config| Box::new(comparison::compared_paths(config)) },
    ViewEntry { name: "comparison", build: |_| Box::new(comparison::Comparison::default()) },
    ViewEntry { name: "is comparing", build: |_| Box::new(status::is_comparing()) },
    ViewEntry { name: "calibration", build: |config| Box::new(status::Calibrations::new(config)) },
    ViewEntry { name: "truth", build: |config| Box::new(truth::Truth::new(config)) },
    ViewEntry { name: "links", build: |config| Box::new(links::Links::new(config)) },
    ViewEntry { name: "clock", build: |_| Box::new(links::Clock::default()) },
    ViewEntry { name: "log", build: |config| Box::new(log::Log::new(config)) },
    ViewEntry { name: "parameters", build: |_| Box::new(status::parameters()) },
    ViewEntry { name: "switches", build: |_| Box::new(status::Switches::default()) },
    ViewEntry { name: "setup", build: |_| Box::new(status::setup()) },
    ViewEntry { name: "simulator", build: |_| Box::new(status::simulator()) },
];

#[cfg(test)]
pub(crate) mod tests;
