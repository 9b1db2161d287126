//! How far the position is off.

use posebridge_estimator::numerics::statistics::root_mean_square;

use super::error::PoseError;

/// Root mean square of the distances, in metres; errors that are not finite are left out.
pub fn rms_m(errors: &[PoseError]) -> Option<f64> {
    root_mean_square(&distances_m(errors))
}

/// The largest distance, in metres; errors that are not finite are left out.
pub fn max_m(errors: &[PoseError]) -> Option<f64> {
    distances_m(errors).into_iter().reduce(f64::max)
}

/// The distance of the last error that is finite, in metres.
pub fn end_m(errors: &[PoseError]) -> Option<f64> {
    distances_m(errors).last().copied()
}

fn distances_m(errors: &[PoseError]) -> Vec<f64> {
    errors.iter().filter(|error| error.is_finite()).map(PoseError::position_m).collect()
}
