//! Calibrates a robot: wheels, track, tag position, inertial sensors.
//!
//! docs/lab/calibration.md has the equations.

pub mod free_path;
mod least_squares;
pub mod umbmark;

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
