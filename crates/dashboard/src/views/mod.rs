//! Views: one file per panel, and one table.
//!
//! A view gets every event in order and adds its updates to the next message and its history to the first one. It uses
//! no clock, socket or thread: the same events give the same messages, live and from a recording.

mod calibration;
mod clock;
mod estimates;
mod fixes;
mod fusion;
mod links;
mod log;
mod parameters;
mod retained_series;
mod robots;
mod simulator;
mod switches;
mod tallies;
mod truth;
mod view;

pub(crate) use retained_series::MAX_ROBOTS;
pub use retained_series::RetentionPolicy;
pub use view::{FrameContent, View, ViewConfig, ViewInput, parse_robot_name, robot_name};

/// A row of [`VIEWS`].
pub struct ViewEntry {
    /// The panel's name.
    pub name: &'static str,
    /// Creates the view.
    pub build: fn(&ViewConfig) -> Box<dyn View>,
}

macro_rules! views {
    ($($name:literal: $module:ident::$view:ident),+ $(,)?) => {
        /// Every view. A new one needs a file here and a line in this table.
        pub const VIEWS: &[ViewEntry] = &[
            $(ViewEntry { name: $name, build: |setting| Box::new($module::$view::new(setting)) }),+
        ];
    };
}

views![
    // First, so that the robots are in the order of detection.
    "robots": robots::Robots,
    "estimates": estimates::Estimates,
    "fixes": fixes::Fixes,
    "fusion": fusion::Fusion,
    "tallies": tallies::Tallies,
    "calibration": calibration::Calibrations,
    "truth": truth::Truth,
    "links": links::Links,
    "clock": clock::Clock,
    "log": log::Log,
    "parameters": parameters::Parameters,
    "switches": switches::Switches,
    "simulator": simulator::Simulator,
];

#[cfg(test)]
pub(crate) mod tests;
