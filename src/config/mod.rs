//! The configuration: from files and flags to validated values.
//! `config/default.toml` is compiled in and documents every key; the structs below are its schema. An unknown key is an error that
//! names it. Units are in the keys; here they become the types of the telemetry crate, and no later code validates them again.

mod bricks;
mod calibration;
mod camera;
mod camera_file;
mod fleet;
mod lengths;
mod link;
mod load;
mod mounting;
mod profile;
mod robot;
mod robot_blocks;
mod robots;
mod ros2;
mod routing;
mod sections;
mod sensor;
mod signing;
mod simulated_camera;
mod station;
mod station_shares;
mod wiring;

pub use bricks::{
    Ev3Distance, Ev3Section, FixSection, LineSection, NxtSection, NxtSensorKind, NxtSensorSection, Place,
};
pub use calibration::{
    CALIBRATION_KEYS, CalibrationEntry, CalibrationKey, RobotCalibration, RobotNoise, learnable_keys,
};
pub use camera::CameraConfig;
pub use camera_file::{CalibrationNote, CameraChoice, CameraFile};
pub use fleet::{FleetSection, FleetSettings};
pub use link::{AtInstant, LinkSection, LinkTarget, OutputSection, PinChoice, load_link_profile, load_scenario};
pub use load::{
    ConfigError, DEFAULT_TOML, Loaded, Overlay, Setting, apply_overrides, apply_profile, config_with_overlay, load,
    load_text, print, sensor_setting,
};
pub use mounting::RobotMounting;
pub use profile::{CalibratedRobot, ProfileFilter, Provenance, RobotProfile, utc_date};
pub use robot::{RobotFile, RobotStart, RobotThermometer};
pub use robot_blocks::{RobotBlockSection, RobotMatchSection};
pub use robots::{
    BundledRobot, ROBOTS, TemplateLink, TemplateValue, UnknownRobot, list as list_of_robots, template, template_of,
    with_values,
};
pub use ros2::Ros2Section;
pub use routing::{ForwardChoice, FrameFilterSection, LimitsSection, MessageRef, RoutingSection};
pub use sections::{
    DashboardSection, FilterSection, MergedSection, NumberedPlace, PLOTJUGGLER_ADDRESS, PlotJugglerSection, PointPlace,
    RecordSection, RecordingLimits, WallPlace, WorldConfig, filter_config, names_of_filters,
};
pub use sensor::SensorSection;
pub use signing::{MemoryRecord, SigningSection, StreamRecord};
pub use station::{ClockConfig, Config, StationSection};
pub use station_shares::StationShare;
pub use wiring::{CameraUnitName, GyroUnitName, RobotWiring};
