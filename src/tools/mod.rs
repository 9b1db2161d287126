//! All other commands, one module each, for files and links, with their helper modules.

#[cfg(feature = "camera")]
pub mod camera;
pub mod config;
pub mod csv_table;
pub mod dataset;
pub mod dialect;
pub mod doctor;
pub mod experiment_output;
pub mod export;
pub mod ground_truth;
pub mod import;
pub mod init;
pub mod inspect;
pub mod key;
pub mod man;
pub mod own_recording;
pub mod play;
pub mod raster;
pub mod relay;
pub mod replay;
pub mod report;
pub mod ros2_bag;
pub mod score;
pub mod session_history;
pub mod session_report;
pub mod sim;
