//! The laboratory from outside, on drives and sensors whose truth is known.
#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers outside #[test] stop where the set-up is broken, and show the figures that they check"
)]

mod accuracy;
mod calibration_path;
mod camera_delay;
mod clocks;
mod hindsight;
mod identification;
mod lesson;
mod support;
mod tuning;
