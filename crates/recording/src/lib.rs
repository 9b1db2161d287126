//! Recordings: what the pipeline was given, kept on disk, and what other people have recorded, brought in.
//!
//! [`container`] writes and reads the pipeline's own inputs, bit for bit, in an MCAP file that survives a crash.
//! [`dataset`] turns foreign CSV-like recordings into observations, as a TOML descriptor says.
//!
//! Pure: bytes, text and time come in as arguments; the caller opens files and reads clocks. This crate estimates
//! nothing and knows no wire format.

pub mod container;
pub mod dataset;
