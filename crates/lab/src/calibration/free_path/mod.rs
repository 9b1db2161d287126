//! Calibrates wheels, track, tag and camera delay from any drive with external positions: from a camera, a ground truth, or a tape at a
//! few points.
//!
//! # Model
//! ```text
//! 1. sanity      wheels exchanged? half the track? counts off by a factor? Continue with the likeliest description.
//! 2. length      e_m from the length of the way over short windows: no heading takes part in it
//! 3. shape       e_b, e_d, tau, l_f, l_l and headings at the start by least squares over whitened innovations, e_m given; a heading
//!                that is roughly known pulls by (th - th_0) / sigma
//! ```
//! The order matters. In a single fit a start heading error of one degree would bias wheel size and track; the length of the path does
//! not depend on headings. So the result is not the optimum of one likelihood but of two, each insensitive to the errors of the other.
//!
//! A parameter is only estimated where its prior has a sigma, where the drive determines it better than the prior, and where it does
//! not degrade the track: on a drive that turns to one side only, unequal wheels and a wrong track look alike. Otherwise it keeps its
//! described value, the report states why, and the uncertainty of its prior enters the other parameters (Schmidt, 1966).
//!
//! # Source
//! docs/lab/calibration.md section 3.

mod drive;
mod hypotheses;
mod parameter_fit;
mod predict;

use posebridge_estimator::FilterConfig;

use self::hypotheses::test_hypotheses;
use self::parameter_fit::ParameterSolver;
use self::predict::PathPredictor;
use super::CalibrationError;

pub use self::drive::{FreePath, PathStart, PositionFix, TravelStep, seconds};
pub use self::hypotheses::{AS_GIVEN, Hypothesis, HypothesisTest, Wiring};
pub use self::parameter_fit::{CalibrationUnknown, PathCalibration, UNKNOWNS, UnknownEstimate, UnknownStatus};
pub use self::predict::{
    DeadReckonedPath, DeadReckoningError, RobotParameters, dead_reckon, mean_error, start_heading,
};

/// Rounds over the second and the third step; the second round changes values by hundredths of their sigmas.
const MAX_ROUNDS: u32 = 3;

/// `config` is the robot's description with the priors.
pub fn calibrate_path(config: &FilterConfig, paths: &[FreePath]) -> Result<PathCalibration, CalibrationError> {
    check_data(paths)?;
    let before = RobotParameters::from_config(config);
    let prediction = PathPredictor { parameters: before, noise: &config.noise };
    let sanity = test_hypotheses(&prediction, paths);
    let hypothesis = sanity.as_ref().map_or(AS_GIVEN, |sanity| sanity.found);
    let paths: Vec<FreePath> = paths.iter().map(|path| path.with_hypothesis(&hypothesis)).collect();
    let mut shape = ParameterSolver::new(config, &paths, hypothesis.track_factor);
    let mut length = shape.estimate_length();
    shape.initialize_track();
    let (mut chosen, mut standings) = shape.select_unknowns(length)?;
    for _ in 1..MAX_ROUNDS {
        // The second step knows the tag and the delay only by the third.
        shape.adopt(&chosen);
        length = shape.estimate_length();
        (chosen, standings) = shape.select_unknowns(length)?;
    }
    Ok(PathCalibration { hypothesis_test: sanity, before, ..shape.report(&chosen, standings, length) })
}

fn check_data(paths: &[FreePath]) -> Result<(), CalibrationError> {
    let steps: usize = paths.iter().map(|path| path.steps.len()).sum();
    let fix_count: usize = paths.iter().map(|path| path.fixes.len()).sum();
    for (what, found, needed) in
        [("intervals in which the wheels turned", steps, 2), ("places where the robot was seen", fix_count, 3)]
    {
        if found < needed {
            return Err(CalibrationError::TooFewData { what, found, needed });
        }
    }
    Ok(())
}
