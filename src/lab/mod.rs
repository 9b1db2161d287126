//! Experiments: `posebridge lab`, `calibrate`, `identify` and `tune`. Nothing but the command line names this part.

pub mod calibrate;
pub mod drives;
pub mod experiments;
pub mod identify;
pub mod parallel;
pub mod tune;
