//! `posebridge calibrate`: what a robot's own numbers are, from squares, from any watched drive, at rest, and of the camera above.
//!
//! docs/lab/calibration.md says what to drive and what the figures mean. The estimates are `posebridge_lab::calibration`'s; here
//! files are read, and profiles, tables and pages written.

mod camera;
mod path;
mod path_args;
mod path_online;
mod path_report;
mod profile;
mod rest;
mod segments;
pub(super) mod source;
mod umbmark;
mod umbmark_source;

use clap::{Args, Subcommand};

use crate::exit::Failure;

/// Flags of `calibrate`.
#[derive(Args, Clone, Debug)]
pub struct CalibrateArgs {
    /// What to calibrate by.
    #[command(subcommand)]
    pub by: CalibrateBy,
}

/// The ways.
#[derive(Clone, Debug, Subcommand)]
pub enum CalibrateBy {
    /// Wheel difference and track from squares in both directions: UMBmark.
    Umbmark(umbmark::UmbmarkArgs),
    /// Wheels, track, tag and camera delay from any recorded drive with fixes or a truth.
    Path(path_args::PathArgs),
    /// Gyro and accelerometers from the times at which a robot stood.
    Rest(rest::RestArgs),
    /// The overhead camera from points whose places on the floor are known.
    Camera(camera::CameraArgs),
}

/// Calibrates.
///
/// # Errors
/// As the way says.
pub fn execute(args: &CalibrateArgs) -> Result<(), Failure> {
    match &args.by {
        CalibrateBy::Umbmark(args) => umbmark::execute(args),
        CalibrateBy::Path(args) => path::execute(args),
        CalibrateBy::Rest(args) => rest::execute(args),
        CalibrateBy::Camera(args) => camera::execute(args),
    }
}
