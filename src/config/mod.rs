//! The configuration: from a file and flags to validated values.
//!
//! `config/default.toml` is compiled in and is the documentation of every key; the structs below are its schema. A key that is
//! not there is an error that names it. Units stand in the keys; here they become the types of the vocabulary, and
//! nothing behind this module checks them again.

mod bricks;
mod calibrated;
mod calibration;
mod dashboard;
mod default_toml;
mod filter;
mod link;
mod link_target;
mod load;
mod noise;
mod origin;
mod overlay;
mod plotjuggler;
mod profile;
mod record;
mod robot;
mod robot_blocks;
mod robots;
mod routing;
mod setting;
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
pub use default_toml::DEFAULT_TOML;
pub use filter::{FilterSection, filter_config, names_of_filters};
pub use link::{AtInstant, LinkSection, OutputSection};
pub use link_target::{LinkTarget, load_scenario};
pub use load::{ConfigError, Loaded, apply_overrides, load, load_text};
pub use noise::RobotNoise;
pub use origin::{Origin, print};
pub use overlay::{Overlay, config_with_overlay};
pub use plotjuggler::{PLOTJUGGLER_ADDRESS, PlotJugglerSection};
pub use profile::{ProfileFilter, RobotProfile};
pub use record::{RecordSection, RecordingLimits};
pub use robot::{RobotFile, RobotStart};
pub use robot_blocks::{RobotBlockSection, RobotMatchSection};
pub use robots::{BundledRobot, ROBOTS, UnknownRobot, list as list_of_robots};
pub use routing::{ForwardChoice, FrameFilterSection, LimitsSection, MessageRef, RoutingSection};
pub use setting::Setting;
pub use signing::{MemoryRecord, SigningSection, StreamRecord};
pub use station::{CameraConfig, ClockConfig, Config, StationSection};
pub use template::{TemplateLink, template};
pub use thermometer::RobotThermometer;
pub use world::{NumberedPlace, PointPlace, WallPlace, WorldConfig};
