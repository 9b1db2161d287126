//! Experiments: `posebridge lab`, `calibrate`, `identify` and `tune`. Only the command line depends on this module.

pub mod calibrate;
pub mod drives;
pub mod experiments;
pub mod identify;
pub mod parallel;
mod sample_table;
pub mod source;
pub mod tune;
