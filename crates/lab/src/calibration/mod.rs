//! What a robot's own numbers really are: wheels, track, the place of its tag, its inertial sensors, the camera above it.
//!
//! The experiments of the papers begin with a calibration by hand. Here each of them is a function from what was measured to
//! numbers with standard deviations. Nothing is read or written; the program's `calibrate` does that.
//!
//! - [`umbmark`]: squares in both directions, end positions only (Borenstein and Feng, 1996); [`umbmark_drives`]: recorded ones;
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
pub mod umbmark_drives;

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// Less was measured than there is to find.
    #[error("{what}: {found} found, {needed} or more are needed")]
    TooFewData {
        /// Of what.
        what: &'static str,
        /// How much there is.
        found: usize,
        /// How much there has to be.
        needed: usize,
    },
    /// The measurements do not separate the unknowns.
    #[error("the measurements do not separate these numbers: {0}")]
    Undetermined(&'static str),
    /// The descent does not become still.
    #[error("the descent does not become still; the data fit no robot of this kind")]
    Diverged,
    /// A number is not finite or out of the range that makes sense.
    #[error("{what} is {value}, which is not valid")]
    ImplausibleValue {
        /// What it is.
        what: &'static str,
        /// The number.
        value: f64,
    },
}
