//! `posebridge calibrate`: what a robot's own numbers are, from squares, from any watched drive, at rest, and of the camera above.
//!
//! docs/lab/calibration.md says what to drive and what the figures mean. The estimates are `posebridge_lab::calibration`'s; here
//! files are read, and profiles, tables and pages written.

mod camera;
mod path;
mod path_report;
mod profile;
mod rest;
pub(super) mod source;
mod umbmark;

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
    /// UMBmark: wheel difference and track from squares in both directions.
    Umbmark(umbmark::UmbmarkArgs),
    /// Wheels, track, tag and camera delay from any recorded drive with fixes or a ground truth.
    Path(path::PathArgs),
    /// Gyro and accelerometers from the times at which the robot stood still.
    Rest(rest::RestArgs),
    /// Overhead camera from points with known positions on the floor.
    Camera(camera::CameraArgs),
}

pub fn execute(args: &CalibrateArgs) -> Result<(), Failure> {
    match &args.by {
        CalibrateBy::Umbmark(args) => umbmark::execute(args),
        CalibrateBy::Path(args) => path::execute(args),
        CalibrateBy::Rest(args) => rest::execute(args),
        CalibrateBy::Camera(args) => camera::execute(args),
    }
}
