//! The engine: decode, align clocks, estimate, publish, as one deterministic value.
//!
//! [`Station`] takes the inputs of links, people and recordings and returns events and bytes to send. It reads no
//! clock, opens nothing and does not depend on a runtime; live runs, replays, simulations and tests use the same code.
//!
//! ```text
//! bytes > framing > messages > readings > clock > estimator > publisher > events, bytes
//! ```

mod battery_monitor;
mod camera_fixes;
mod camera_table;
pub mod clock;
mod clock_alignment;
mod commands;
mod compared_estimators;
pub mod config;
mod decoder;
mod egress;
mod estimate_messages;
mod estimate_output;
mod estimate_publisher;
mod estimator;
mod fix_requests;
mod forwarded_frame;
mod fusion_alarms;
mod host_times;
mod link_command;
mod link_context;
mod mavlink1_probe;
mod message_requests;
mod metadata_files;
mod missing_sensor_report;
mod mission;
mod mission_service;
mod motion_source_selection;
mod observation_extractor;
mod observations;
mod observers;
mod operator;
mod output_queue;
mod output_schedule;
mod ownership;
mod ownership_status;
mod parameter_reports;
mod peer_framers;
mod receive;
mod receive_pass;
mod recorded_stations;
mod robot;
mod robot_snapshot;
mod robot_table;
mod sender_identity;
mod sender_pins;
mod sensor_health;
mod sessions;
mod set_origin;
mod station;
mod status_text;
mod temperatures;
mod thermometer_bank;
mod token_bucket;
mod transmitter;
mod vehicle_proxy;
mod vehicle_status;

#[cfg(test)]
extern crate self as posebridge_station;
#[cfg(test)]
#[path = "../tests/station/support/config.rs"]
mod test_config;

pub use config::{
    AcceptedVersions, AnnouncedAs, BrickLink, BuildError, DescriptionPolicy, FixRequestConfig, GoalPolicy, LinkConfig,
    OUTPUTS, OutputInfo, OutputInstant, OutputKind, OutputStream, OwnershipPolicy, RobotBlock, RobotConfig, RobotMatch,
    RpmMeaning, StationConfig, ThermometerConfig,
};
pub use ownership_status::OwnershipStatus;
pub use recorded_stations::{RecordedStation, RecordedStations};
pub use robot::Robot;
pub use sender_pins::PinPolicy;
pub use station::Station;
