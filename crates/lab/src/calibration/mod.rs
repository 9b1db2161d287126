//! What a robot's own numbers really are: wheels, track, the place of its tag, its inertial sensors, the camera above it.
//!
//! The experiments of the papers begin with a calibration by hand. Here each of them is a function from what was measured to
//! numbers with standard deviations. Nothing is read or written; the program's `calibrate` does that.
//!
//! - [`umbmark`]: squares in both directions, end positions only (Borenstein and Feng, 1996);
//! - [`free_path`]: any recorded drive under a camera or with a truth;
//! - [`at_rest`]: gyro and accelerometers of a robot that stands;
//! - [`camera`]: from pixels to the floor by known points.
//!
//! docs/lab/calibration.md has the equations.

pub mod at_rest;
pub mod camera;
pub mod free_path;
mod least_squares;
pub mod umbmark;

/// Why there is no calibration.
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
