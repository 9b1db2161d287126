//! How far dead reckoning alone ends up from where the robot was seen.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::numerics::statistics;

use super::drive::FreePath;
use super::hypotheses::estimate_start_heading;
use super::predict::{PathPredictor, RobotParameters};

/// Distances between dead reckoning and sights, in metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeadReckoningError {
    /// Root mean square.
    pub rms_m: f64,
    /// The largest.
    pub max_m: f64,
    /// At the last sight.
    pub end_m: f64,
}

/// A drive by dead reckoning alone, compared with its sights.
#[derive(Clone, Debug, PartialEq)]
pub struct DeadReckonedPath {
    /// Where the tag would have been seen, of each sight: x, y in metres.
    pub positions_m: Vec<[f64; 2]>,
    /// How far that is off.
    pub error: DeadReckoningError,
}

/// The heading with which a drive begins when its own description is followed: as given, or the best one if it is unknown.
pub fn start_heading(config: &FilterConfig, numbers: &RobotParameters, path: &FreePath) -> f64 {
    if path.start.heading_sigma_rad <= 1.0 {
        return path.start.pose[2];
    }
    estimate_start_heading(&predictor(config, numbers), path)
}

/// Reckons a drive with these numbers from a start with this heading.
pub fn dead_reckon(
    config: &FilterConfig,
    numbers: &RobotParameters,
    path: &FreePath,
    heading_rad: f64,
) -> DeadReckonedPath {
    let reckoned = predictor(config, numbers).predict_tags(path, heading_rad);
    let places_m: Vec<[f64; 2]> = reckoned.iter().map(|reckoned| reckoned.tag_m).collect();
    let off = places_m
        .iter()
        .zip(&path.fixes)
        .map(|(ours, sight)| (ours[0] - sight.position_m[0]).hypot(ours[1] - sight.position_m[1]));
    let off: Vec<f64> = off.collect();
    let error = DeadReckoningError {
        rms_m: statistics::root_mean_square(&off).unwrap_or(0.0),
        max_m: off.iter().copied().fold(0.0, f64::max),
        end_m: off.last().copied().unwrap_or(0.0),
    };
    DeadReckonedPath { positions_m: places_m, error }
}

/// The mean of each figure over runs.
pub fn mean_error(errors: &[DeadReckoningError]) -> DeadReckoningError {
    let mean = |of: fn(&DeadReckoningError) -> f64| statistics::mean(errors.iter().map(of)).unwrap_or(0.0);
    DeadReckoningError {
        rms_m: mean(|error| error.rms_m),
        max_m: mean(|error| error.max_m),
        end_m: mean(|error| error.end_m),
    }
}

fn predictor<'a>(config: &'a FilterConfig, numbers: &RobotParameters) -> PathPredictor<'a> {
    PathPredictor { parameters: *numbers, noise: &config.noise }
}
