//! `posebridge calibrate`: calibrates a robot from squares, from any drive with external positions, or at rest.
//!
//! docs/lab/calibration.md explains the drives and the results. The estimation is in `posebridge_lab::calibration`; this module reads
//! files, and writes profiles, tables and pages.

mod path;
mod path_report;
mod profile;
mod rest;
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
}

pub fn execute(args: &CalibrateArgs) -> Result<(), Failure> {
    match &args.by {
        CalibrateBy::Umbmark(args) => umbmark::execute(args),
        CalibrateBy::Path(args) => path::execute(args),
        CalibrateBy::Rest(args) => rest::execute(args),
    }
}
