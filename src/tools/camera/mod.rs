//! `posebridge camera`: tags to print, and tags in pictures (docs/camera.md).

mod calibrate;
mod calibration_report;
mod camera_evidence;
mod detect;
mod recorded_drive;
mod sheet;

use clap::{Args, Subcommand};

use crate::exit::Failure;

/// Flags of `camera`.
#[derive(Args, Clone, Debug)]
pub struct CameraArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: CameraAction,
}

/// What to do with cameras.
#[derive(Clone, Debug, Subcommand)]
pub enum CameraAction {
    /// Write sheets with tags to print: one for the floor, one for each robot, as SVG and PDF (docs/camera.md).
    Sheet(sheet::SheetArgs),
    /// Find the place and the lens of a camera from pictures of the floor sheet, a drive, or measured points (docs/camera.md).
    Calibrate(calibrate::CalibrateCameraArgs),
    /// Find the tags in pictures, and with a calibrated camera where they are: whether they can be seen from where the camera is (docs/camera.md).
    Detect(detect::DetectArgs),
}

pub fn execute(args: &CameraArgs) -> Result<(), Failure> {
    match &args.action {
        CameraAction::Sheet(args) => sheet::execute(args),
        CameraAction::Calibrate(args) => calibrate::execute(args),
        CameraAction::Detect(args) => detect::execute(args),
    }
}
