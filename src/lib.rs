//! The shell: it wires links, engine, recorder, simulated brick and reports together.
//!
//! No formula and no byte layout stands here: physics is in the crates, and what happens to data between a socket and a reply is
//! the pipeline's business. The shell opens files and links, owns the threads and talks to people.

pub mod aligned;
pub mod cli;
pub mod collect;
pub mod commands;
pub mod config;
pub mod data;
pub mod drawn;
pub mod failures;
pub mod import;
pub mod input_file;
pub mod known;
pub mod learned;
pub mod link_flags;
pub mod link_profile;
pub mod link_target;
pub mod notes;
pub mod own_recording;
pub mod parallel;
pub mod plotjuggler;
pub mod progress;
pub mod raster;
pub mod report;
pub mod score;
pub mod signing;
pub mod stderr;
pub mod stdout;
pub mod tasks;
pub mod tlog;
pub mod trails;
pub mod truth_file;
pub mod tui;
pub mod virtual_run;
