//! How far the heading is off, on the circle.

use posebridge_estimator::numerics::statistics::root_mean_square;
use posebridge_telemetry::Heading;

use super::error::PoseError;

/// Root mean square of the heading errors that are there, in radians; each is wrapped into (-pi, pi] first.
pub fn rms_rad(errors: &[PoseError]) -> Option<f64> {
    let turns_rad: Vec<f64> = errors
        .iter()
        .filter(|error| error.is_finite())
        .filter_map(|error| error.heading_rad)
        .map(|turn_rad| Heading::from_rad(turn_rad).rad())
        .collect();
    root_mean_square(&turns_rad)
}
