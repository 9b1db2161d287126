//! The configuration: from a file and flags to validated values.
//!
//! `config/default.toml` is compiled in and is the documentation of every key; the structs below are its schema. A key that is
//! not there is an error that names it. Units stand in the keys; here they become the types of the vocabulary, and
//! nothing behind this module checks them again.

mod bricks;
mod calibrated;
mod calibration;
mod dashboard;
mod filter;
mod load;
mod merge;
mod noise;
mod plotjuggler;
mod profile;
mod robot;
mod robots;
mod routing;
mod signing;
mod station;
mod template;
mod thermometer;
mod world;

pub use bricks::{
    Ev3Distance, Ev3Section, FixSection, LineSection, NxtSection, NxtSensorKind, NxtSensorSection, Place,
};
pub use calibrated::{CalibratedRobot, Provenance, utc_date};
pub use calibration::{CALIBRATION_KEYS, CalibrationEntry, CalibrationKey, RobotCalibration};
pub use dashboard::DashboardSection;
pub use filter::{FilterSection, filter_config, names_of_filters};
pub use load::{ConfigError, Loaded, lay_over, load, load_text};
pub use merge::{Origin, Setting, print};
pub use noise::RobotNoise;
pub use plotjuggler::{PLOTJUGGLER_ADDRESS, PlotJugglerSection};
pub use profile::{ProfileFilter, RobotProfile};
pub use robot::{RobotFile, RobotStart};
pub use robots::{BundledRobot, ROBOTS, UnknownRobot, list as list_of_robots};
pub use routing::{ForwardChoice, FrameFilterSection, LimitsSection, MessageRef, RoutingSection};
pub use signing::{MemoryRecord, SigningSection, StreamRecord};
pub use station::{
    AtInstant, CameraConfig, ClockConfig, Config, LinkSection, OutputSection, RecordSection, StationConfig,
};
pub use template::{TemplateLink, template};
pub use thermometer::RobotThermometer;
pub use world::{NumberedPlace, PointPlace, WallPlace, WorldConfig};

/// The configuration that `posebridge` alone uses, and the documentation of every key.
pub const DEFAULT_TOML: &str = include_str!("../../config/default.toml");
