//! The configuration: from a file and flags to validated values.
//!
//! `config/default.toml` is compiled in and is the documentation of every key; the structs below are its schema. A key that is
//! not there is an error that names it. Units stand in the keys; here they become the types of the vocabulary, and
//! nothing behind this module checks them again.

mod load;
mod merge;
mod robot;
mod robot_of;
mod station;

pub use load::{ConfigError, Loaded, lay_over, load, load_text};
pub use merge::{Origin, Setting, print};
pub use robot::{RobotFile, RobotNoise, RobotStart};
pub use robot_of::robot_of;
pub use station::{
    AtInstant, CameraConfig, ClockConfig, Config, FilterSection, LinkSection, OutputSection,
    RecordSection, StationConfig,
};

/// The configuration that `posebridge` alone uses, and the documentation of every key.
pub const DEFAULT_TOML: &str = include_str!("../../config/default.toml");
