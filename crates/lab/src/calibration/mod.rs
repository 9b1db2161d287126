//! Calibrates a robot: wheels, track, tag position, inertial sensors, overhead camera.
//!
//! The experiments of the papers begin with a manual calibration. Here each is a function from measurements to parameters with standard
//! deviations. No IO: the program's `calibrate` command does that.
//!
//! - [`umbmark`]: squares in both directions, end positions only (Borenstein and Feng, 1996);
//! - [`free_path`]: any recorded drive with a camera or ground truth;
//! - [`at_rest`]: gyro and accelerometers of a standing robot;
//! - [`camera`]: from pixels to the floor by known points.
//!
//! docs/lab/calibration.md has the equations.

pub mod at_rest;
pub mod camera;
pub mod free_path;
mod least_squares;
pub mod umbmark;

/// Why there is no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    #[error("{what}: {found} found, {needed} or more are needed")]
    TooFewData { what: &'static str, found: usize, needed: usize },
    #[error("the measurements do not separate these numbers: {0}")]
    Undetermined(&'static str),
    #[error("the descent does not become still; the data fit no robot of this kind")]
    Diverged,
    #[error("{what} is {value}, which is not valid")]
    ImplausibleValue { what: &'static str, value: f64 },
}
