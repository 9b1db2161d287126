//! `posebridge run`: the station.
//!
//! The station loop decodes, fuses and answers without a queue between socket and reply. The others hang off bounded channels that drop and
//! count when they are full. The recorder's is long, and the recording says what it lacks, because with holes its replay is not exact.

pub mod args;
pub mod clock_alignment;
pub mod clock_step;
mod config_writer;
pub mod dashboard;
pub mod deferred_errors;
pub mod error_to_truth;
pub mod event_collector;
pub mod input_file;
pub mod joined_recording;
pub mod learned_calibration;
pub mod link_flags;
pub mod link_report;
mod links;
pub mod live_status;
pub mod observer;
mod outcome;
pub mod page_history;
pub mod per_robot;
pub mod plotjuggler;
pub mod recorder;
pub mod recording_files;
pub mod recording_parts;
pub mod recording_warnings;
pub mod request_reports;
pub mod requests;
pub mod run;
mod run_outputs;
pub mod run_report;
mod session;
pub mod signals;
pub mod signing;
pub mod simulator;
pub mod station_loop;
pub mod status;
pub mod tlog_writer;
pub mod traffic_log;
pub mod tui;
mod viewers;
pub mod watched_file;
