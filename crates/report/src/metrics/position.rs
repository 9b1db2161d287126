//! How far the position is off.

use super::error::PoseError;
use super::root_mean_square::{largest, root_mean_square};

/// Root mean square of the distances, in metres; errors that are not finite are left out.
pub fn rms_m(errors: &[PoseError]) -> Option<f64> {
    root_mean_square(&distances_m(errors))
}

/// The largest distance, in metres; errors that are not finite are left out.
pub fn max_m(errors: &[PoseError]) -> Option<f64> {
    largest(&distances_m(errors))
}

/// The distance of the last error that is finite, in metres.
pub fn end_m(errors: &[PoseError]) -> Option<f64> {
    distances_m(errors).last().copied()
}

fn distances_m(errors: &[PoseError]) -> Vec<f64> {
    errors.iter().filter(|error| error.is_finite()).map(PoseError::position_m).collect()
}
