//! The experiments, calibrations and identifications of the lab, by the real program.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken, and show the figures that they check"
)]

#[path = "../support/mod.rs"]
mod support;

mod calibrate;
mod experiments;
mod identify;
mod live;
mod recorded;
mod tune;
