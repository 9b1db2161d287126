//! `posebridge run`: the station.
//! The station loop decodes, fuses and answers without a queue between socket and reply. All other consumers use bounded channels that
//! drop and count when full, and whose readers may stand still: a terminal, a disk, a browser. The recorder's channel is long, and the recording states its gaps, because its replay is then not exact.

pub mod args;
pub mod bag_recorder;
#[cfg_attr(not(feature = "camera"), path = "no_cameras.rs")]
mod cameras;
mod dead_reckoning;
pub mod event_collector;
pub mod event_file;
#[cfg_attr(not(feature = "fleet"), path = "no_fleet.rs")]
pub mod fleet;
pub mod input_file;
pub mod learned_calibration;
pub mod link_frames;
pub mod link_log;
pub mod link_report;
mod links;
pub mod live_status;
pub mod observer;
pub mod page_history;
pub mod per_robot;
pub mod plotjuggler;
pub mod recorded_session;
pub mod recorder;
pub mod recording_files;
pub mod recording_parts;
pub mod requests;
#[cfg_attr(not(feature = "fleet"), path = "no_ros2.rs")]
pub mod ros2;
pub mod run;
pub mod run_report;
mod session;
pub mod setup;
pub mod side_file;
pub mod signing;
pub mod simulator;
pub mod station_loop;
pub mod tlog_writer;
pub mod tui;
pub mod viewers;
pub mod watchdog;
pub mod wiring_fix;
pub mod writer_thread;
