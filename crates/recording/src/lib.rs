//! Recordings: what the pipeline was given, kept on disk, and what other people have recorded, brought in.
//!
//! [`container`] writes and reads the pipeline's own inputs, bit for bit, in an MCAP file that survives a crash.
//! [`foxglove`] turns what came out of the pipeline into messages for viewers and notebooks, which stand beside the inputs.
//! [`tlog`] reads and writes the telemetry logs of ground stations.
//! [`csv`] and [`tum`] write what a run has made for other programs.
//! [`dataset`] turns foreign CSV-like recordings into observations, as a TOML descriptor says.
//!
//! Pure: bytes, text and time come in as arguments; the caller opens files and reads clocks. This crate estimates
//! nothing, and of wire formats it knows only how long a MAVLink frame is.

pub mod container;
pub mod csv;
pub mod dataset;
pub mod foxglove;
pub mod tlog;
pub mod tum;
