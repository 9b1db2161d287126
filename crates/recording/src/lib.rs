//! Recordings and foreign files: readers and writers.
//!
//! - [`container`] writes and reads the station's inputs, bit for bit, in an MCAP file that survives a crash.
//! - [`foxglove`] converts the station's outputs to messages for viewers and notebooks, stored beside the inputs.
//! - [`ros2`] writes the station's outputs as a ROS 2 bag.
//! - [`json_log`] writes and reads JSON messages in MCAP.
//! - [`merge`] makes one recording of those of several stations.
//! - [`tlog`] reads and writes the telemetry logs of ground stations.
//! - [`event_json`] writes every event as a line of JSON.
//! - [`csv`] and [`tum`] write the results of a run for other programs.
//! - [`robot_names`] creates the labels of robots in all of these.
//! - [`csv_dialect`] finds what separates the columns of a CSV file, and its decimal mark.
//! - [`dataset`] converts foreign CSV-like recordings to observations by a TOML descriptor.
//!
//! Pure: bytes, text and time are arguments; the caller opens files and reads clocks. This crate estimates nothing, and of wire formats
//! it knows only the length of a MAVLink frame.

mod chunk_compression;
mod clock_alignment;
pub mod container;
pub mod csv;
pub mod csv_dialect;
pub mod dataset;
pub mod event_json;
pub mod foxglove;
pub mod json_log;
pub mod merge;
mod planar;
pub mod robot_names;
pub mod ros2;
pub mod tlog;
pub mod tum;
