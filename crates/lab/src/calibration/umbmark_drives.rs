//! UMBmark from recorded squares: the wheels can be reckoned anew, so the formulae are applied until nothing changes.
//!
//! The formulae of [`umbmark`](super::umbmark) are of first order. With typed ends they are applied once, as the paper does; here the
//! ends by odometry follow the numbers that were found, and what the first round left is the input of the next.

use std::f64::consts::TAU;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::UncertainValue;

use super::CalibrationError;
use super::free_path::{FreePath, RobotParameters, dead_reckon};
use super::umbmark::{SquareDirection, SquareError, SquareRobot, SquareRun, Umbmark, estimate_umbmark, square_error};

/// Rounds after which it is said not to settle; three are usual.
const MAX_ROUNDS: u32 = 12;
/// Settled, when neither number moves by more.
const CONVERGED: f64 = 1e-7;
/// A square turns by one turn, perhaps with one corner more at its end, by a description that is off by a fifth; in radians.
const TURNS_RAD: [f64; 2] = [0.75 * TAU, 1.5 * TAU];

/// What recorded squares say.
#[derive(Clone, Debug, PartialEq)]
pub struct SquareCalibration {
    /// The last round's numbers, added up over all rounds.
    pub estimate: Umbmark,
    /// The robot before.
    pub before: RobotParameters,
    /// The robot after.
    pub after: RobotParameters,
    /// The ends before.
    pub runs_before: Vec<SquareRun>,
    /// The ends after.
    pub runs_after: Vec<SquareRun>,
    /// The figure of merit after.
    pub error_after: SquareError,
    /// Length of a side, in metres.
    pub side_m: f64,
    /// How many rounds it took.
    pub rounds: u32,
}

/// Calibrates by recorded squares; `side_m` is taken from the wheels' way if it is not given.
///
/// # Errors
/// As [`estimate_umbmark()`]; [`CalibrationError::ImplausibleValue`] for a drive that does not turn once.
pub fn calibrate_squares(
    config: &FilterConfig,
    paths: &[FreePath],
    side_m: Option<f64>,
) -> Result<SquareCalibration, CalibrationError> {
    let before = RobotParameters::from_config(config);
    let mut after = before;
    let side_m = side_m.unwrap_or_else(|| mean_side_m(paths));
    let runs_before = closing_runs(config, &before, paths)?;
    let mut runs = runs_before.clone();
    let mut found: Option<Umbmark> = None;
    for rounds in 1..=MAX_ROUNDS {
        let robot = SquareRobot { track_width_m: after.track_width_m, side_m };
        let step = estimate_umbmark(&runs, robot)?;
        after.track_width_m *= 1.0 + step.track_scale.value;
        after.radius_difference += step.radius_difference.value;
        runs = closing_runs(config, &after, paths)?;
        found = Some(sum_estimates(found, step, &before, &after));
        let moved = step.track_scale.value.abs().max(step.radius_difference.value.abs());
        if let (true, Some(found)) = (moved < CONVERGED, found) {
            return Ok(SquareCalibration {
                estimate: found,
                before,
                after,
                error_after: square_error(&runs)?,
                runs_before,
                runs_after: runs,
                side_m,
                rounds,
            });
        }
    }
    Err(CalibrationError::Diverged)
}

/// The first round with the totals of all.
fn sum_estimates(first: Option<Umbmark>, step: Umbmark, before: &RobotParameters, after: &RobotParameters) -> Umbmark {
    let first = first.unwrap_or(step);
    let difference = after.radius_difference - before.radius_difference;
    Umbmark {
        track_scale: UncertainValue { value: after.track_width_m / before.track_width_m - 1.0, ..first.track_scale },
        radius_difference: UncertainValue { value: difference, ..first.radius_difference },
        left_factor: 1.0 - 0.5 * difference,
        right_factor: 1.0 + 0.5 * difference,
        ..first
    }
}

/// The ends of the drives with these numbers, each in the space of its start.
///
/// # Errors
/// [`CalibrationError::ImplausibleValue`] for a drive that does not turn once, [`CalibrationError::TooFewData`] for one without sights.
pub fn closing_runs(
    config: &FilterConfig,
    numbers: &RobotParameters,
    paths: &[FreePath],
) -> Result<Vec<SquareRun>, CalibrationError> {
    let end = |path: &FreePath| {
        let heading_rad = path.start.pose[2];
        let reckoned = dead_reckon(config, numbers, path, heading_rad);
        let (Some(ours), Some(seen)) = (reckoned.positions_m.last(), path.fixes.last()) else {
            return Err(CalibrationError::TooFewData {
                what: "places where the robot was seen at the end of a square",
                found: 0,
                needed: 1,
            });
        };
        let [x, y] = [seen.position_m[0] - ours[0], seen.position_m[1] - ours[1]];
        let (sin, cos) = heading_rad.sin_cos();
        Ok(SquareRun { direction: direction(path, numbers)?, ahead_m: cos * x + sin * y, left_m: cos * y - sin * x })
    };
    paths.iter().map(end).collect()
}

fn direction(path: &FreePath, numbers: &RobotParameters) -> Result<SquareDirection, CalibrationError> {
    let turns = path.steps.iter().map(|step| step.travel.right_m - step.travel.left_m);
    let turned_rad = turns.sum::<f64>() / numbers.track_width_m;
    let [least_rad, most_rad] = TURNS_RAD;
    if !(least_rad..=most_rad).contains(&turned_rad.abs()) {
        return Err(CalibrationError::ImplausibleValue {
            what: "the turn of a square by its wheels (rad; one lap to either side is 6.3)",
            value: turned_rad,
        });
    }
    Ok(if turned_rad > 0.0 { SquareDirection::CounterClockwise } else { SquareDirection::Clockwise })
}

fn mean_side_m(paths: &[FreePath]) -> f64 {
    let lengths = paths.iter().map(FreePath::length_m);
    lengths.sum::<f64>() / (4.0 * paths.len().max(1) as f64)
}
