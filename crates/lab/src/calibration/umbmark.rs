//! UMBmark: wheel diameters and track from squares driven in both directions.
//!
//! # Model
//! ```text
//! e  = measured end - end by odometry, in the space of the start       mean over the runs of one direction
//! alpha = (x_cw + x_ccw) / (-4 L) = (y_cw - y_ccw) / (-4 L)            turned too little at each corner, rad
//! beta  = (x_cw - x_ccw) / (-4 L) = (y_cw + y_ccw) / (-4 L)            turned along each side, rad
//! R   = (L / 2) / sin(beta / 2)                                        radius of a bent side
//! E_d = D_R / D_L = (R + b/2) / (R - b/2)
//! E_b = 90 deg / (90 deg - alpha)
//! b  <- E_b b      c_L = 2 / (E_d + 1)      c_R = 2 / (1 / E_d + 1)    factors on the wheels; their mean stays
//! ```
//! `alpha` and `beta` are the means over x and y. The mean wheel size is not observable in a closed square.
//!
//! # Assumptions
//! Errors are small: the sine of an angle is the angle. The runs of one direction differ by chance only.
//!
//! # Source
//! Borenstein and Feng (1996), IEEE Transactions on Robotics and Automation 12(6), 869-880.

use std::f64::consts::{FRAC_PI_2, TAU};

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::UncertainValue;

use super::CalibrationError;
use super::free_path::{FreePath, RobotParameters, dead_reckon};
use crate::statistics::centroid;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SquareDirection {
    Clockwise,
    CounterClockwise,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SquareRun {
    pub direction: SquareDirection,
    /// Measured minus odometry end, ahead of the start.
    pub ahead_m: f64,
    /// Measured minus odometry end, to the left of the start.
    pub left_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SquareRobot {
    pub track_width_m: f64,
    pub side_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Umbmark {
    pub track_scale: UncertainValue,
    /// Relative difference of the radii, right minus left.
    pub radius_difference: UncertainValue,
    /// alpha.
    pub corner_rad: f64,
    /// beta.
    pub bend_rad: f64,
    pub left_factor: f64,
    pub right_factor: f64,
    /// Largest difference between alpha or beta by x and by y; if it is large beside them, no square was driven.
    pub disagreement_rad: f64,
    pub error: SquareError,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SquareError {
    /// Mean (ahead, left) of the clockwise runs.
    pub clockwise_m: [f64; 2],
    pub counter_clockwise_m: [f64; 2],
    /// The larger distance of both means from the start: E_max,syst.
    pub systematic_m: f64,
    /// Root mean square distance of the runs from the mean of their direction.
    pub scatter_m: f64,
}

const MIN_RUNS: usize = 1;

pub fn square_error(runs: &[SquareRun]) -> Result<SquareError, CalibrationError> {
    let (clockwise, by_cw) = mean_of(runs, SquareDirection::Clockwise)?;
    let (counter, by_ccw) = mean_of(runs, SquareDirection::CounterClockwise)?;
    let count = runs.len() as f64;
    Ok(SquareError {
        clockwise_m: clockwise,
        counter_clockwise_m: counter,
        systematic_m: clockwise[0].hypot(clockwise[1]).max(counter[0].hypot(counter[1])),
        scatter_m: ((by_cw.iter().sum::<f64>() + by_ccw.iter().sum::<f64>()) / count).sqrt(),
    })
}

/// Mean end of a direction, and the sums of squares about it along both axes.
fn mean_of(runs: &[SquareRun], direction: SquareDirection) -> Result<([f64; 2], [f64; 2]), CalibrationError> {
    let ends: Vec<[f64; 2]> =
        runs.iter().filter(|run| run.direction == direction).map(|run| [run.ahead_m, run.left_m]).collect();
    if ends.len() < MIN_RUNS {
        return Err(CalibrationError::TooFewData {
            what: match direction {
                SquareDirection::Clockwise => "squares driven clockwise",
                SquareDirection::CounterClockwise => "squares driven counter-clockwise",
            },
            found: ends.len(),
            needed: MIN_RUNS,
        });
    }
    if let Some(value) = ends.iter().flatten().find(|value| !value.is_finite()) {
        return Err(CalibrationError::ImplausibleValue { what: "the end of a square", value: *value });
    }
    let mean = centroid(&ends);
    let squares = [0, 1].map(|axis| {
        let apart = ends.iter().map(|end| (end[axis] - mean[axis]).powi(2));
        apart.sum::<f64>()
    });
    Ok((mean, squares))
}

pub fn estimate_umbmark(runs: &[SquareRun], robot: SquareRobot) -> Result<Umbmark, CalibrationError> {
    for (what, value) in [("the side of the square", robot.side_m), ("the track width", robot.track_width_m)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(CalibrationError::ImplausibleValue { what, value });
        }
    }
    let error = square_error(runs)?;
    let ([x_cw, y_cw], [x_ccw, y_ccw]) = (error.clockwise_m, error.counter_clockwise_m);
    let four_sides_m = 4.0 * robot.side_m;
    let alphas = [(x_cw + x_ccw) / -four_sides_m, (y_cw - y_ccw) / -four_sides_m];
    let betas = [(x_cw - x_ccw) / -four_sides_m, (y_cw + y_ccw) / -four_sides_m];
    let alpha = f64::midpoint(alphas[0], alphas[1]);
    let beta = f64::midpoint(betas[0], betas[1]);
    if alpha.abs() >= 0.5 * FRAC_PI_2 || beta.abs() >= 0.5 * FRAC_PI_2 {
        let value = if alpha.abs() > beta.abs() { alpha } else { beta };
        return Err(CalibrationError::ImplausibleValue { what: "the error of a corner (rad)", value });
    }
    let ratio = wheel_ratio(beta, robot);
    let sigma = angle_sigma(runs, robot.side_m)?;
    Ok(Umbmark {
        track_scale: UncertainValue { value: FRAC_PI_2 / (FRAC_PI_2 - alpha) - 1.0, sigma: sigma / FRAC_PI_2 },
        radius_difference: UncertainValue {
            value: 2.0 * (ratio - 1.0) / (ratio + 1.0),
            // d E_d / d beta = b / L for small angles.
            sigma: sigma * robot.track_width_m / robot.side_m,
        },
        corner_rad: alpha,
        bend_rad: beta,
        left_factor: 2.0 / (ratio + 1.0),
        right_factor: 2.0 / (1.0 / ratio + 1.0),
        disagreement_rad: (alphas[0] - alphas[1]).abs().max((betas[0] - betas[1]).abs()),
        error,
    })
}

/// E_d; a straight side has an infinite radius.
fn wheel_ratio(beta: f64, robot: SquareRobot) -> f64 {
    let half_track_m = 0.5 * robot.track_width_m;
    // (R + b/2) / (R - b/2) with the curvature 1/R, so that a straight side divides by nothing that is zero.
    let curvature_per_m = (0.5 * beta).sin() / (0.5 * robot.side_m);
    (1.0 + curvature_per_m * half_track_m) / (1.0 - curvature_per_m * half_track_m)
}

/// One standard deviation of alpha and of beta, from the scatter of the runs; both are means of two sums of two means, over 4 L.
fn angle_sigma(runs: &[SquareRun], side_m: f64) -> Result<f64, CalibrationError> {
    let mut variance_m2 = 0.0;
    for direction in [SquareDirection::Clockwise, SquareDirection::CounterClockwise] {
        let (_, squares) = mean_of(runs, direction)?;
        let count = runs.iter().filter(|run| run.direction == direction).count() as f64;
        if count > 1.0 {
            variance_m2 += (squares[0] + squares[1]) / ((count - 1.0) * count);
        }
    }
    Ok(0.5 * variance_m2.sqrt() / (4.0 * side_m))
}

// UMBmark from recorded squares: the wheels can be reckoned anew, so the formulae are applied until nothing changes.
//
// The formulae of [`umbmark`](super::umbmark) are of first order. With typed ends they are applied once, as the paper does; here the
// ends by odometry follow the numbers that were found, and what the first round left is the input of the next.

/// Rounds before it counts as not converging; three are usual.
const MAX_ROUNDS: u32 = 12;
/// Converged when neither parameter changes by more.
const CONVERGED: f64 = 1e-7;
/// Plausible total turn of a square: one turn, possibly one more corner at its end, by a description that is off by a fifth.
const TURNS_RAD: [f64; 2] = [0.75 * TAU, 1.5 * TAU];

#[derive(Clone, Debug, PartialEq)]
pub struct SquareCalibration {
    /// Results of the last round, accumulated over all rounds.
    pub estimate: Umbmark,
    pub before: RobotParameters,
    pub after: RobotParameters,
    pub runs_before: Vec<SquareRun>,
    pub runs_after: Vec<SquareRun>,
    pub side_m: f64,
}

/// Calibrates by recorded squares; without `side_m` the side is estimated from the wheel travel.
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
    for _ in 0..MAX_ROUNDS {
        let robot = SquareRobot { track_width_m: after.track_width_m, side_m };
        let step = estimate_umbmark(&runs, robot)?;
        after.track_width_m *= 1.0 + step.track_scale.value;
        after.radius_difference += step.radius_difference.value;
        runs = closing_runs(config, &after, paths)?;
        found = Some(sum_estimates(found, step, &before, &after));
        let moved = step.track_scale.value.abs().max(step.radius_difference.value.abs());
        if let (true, Some(found)) = (moved < CONVERGED, found) {
            return Ok(SquareCalibration { estimate: found, before, after, runs_before, runs_after: runs, side_m });
        }
    }
    Err(CalibrationError::Diverged)
}

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

/// The ends of the drives with these parameters, each in the space of its start.
pub fn closing_runs(
    config: &FilterConfig,
    numbers: &RobotParameters,
    paths: &[FreePath],
) -> Result<Vec<SquareRun>, CalibrationError> {
    let end = |path: &FreePath| {
        let heading_rad = path.start.pose[2];
        let reckoned = dead_reckon(config, numbers, path, heading_rad);
        let (Some(ours), Some(last_fix)) = (reckoned.positions_m.last(), path.fixes.last()) else {
            return Err(CalibrationError::TooFewData {
                what: "places where the robot was seen at the end of a square",
                found: 0,
                needed: 1,
            });
        };
        let [x, y] = [last_fix.position_m[0] - ours[0], last_fix.position_m[1] - ours[1]];
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Where a robot with these true numbers ends that drives a square by the nominal ones, integrated finely.
    fn end(direction: SquareDirection, track_scale: f64, difference: f64) -> SquareRun {
        const SIDE_M: f64 = 4.0;
        const TRACK_M: f64 = 0.34;
        const PARTS: u32 = 400;
        let sign = match direction {
            SquareDirection::Clockwise => -1.0,
            SquareDirection::CounterClockwise => 1.0,
        };
        let (mut x, mut y, mut heading) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut roll = |forward: f64, turn: f64| {
            let left = (forward - 0.5 * turn * TRACK_M) * (1.0 - 0.5 * difference);
            let right = (forward + 0.5 * turn * TRACK_M) * (1.0 + 0.5 * difference);
            let turned = (right - left) / (TRACK_M * (1.0 + track_scale));
            let middle = heading + 0.5 * turned;
            x += 0.5 * (left + right) * middle.cos();
            y += 0.5 * (left + right) * middle.sin();
            heading += turned;
        };
        for _ in 0..4 {
            for _ in 0..PARTS {
                roll(SIDE_M / f64::from(PARTS), 0.0);
            }
            for _ in 0..PARTS {
                roll(0.0, sign * FRAC_PI_2 / f64::from(PARTS));
            }
        }
        SquareRun { direction, ahead_m: x, left_m: y }
    }

    const ROBOT: SquareRobot = SquareRobot { track_width_m: 0.34, side_m: 4.0 };

    #[test]
    fn squares_of_a_wrong_robot_tell_what_is_wrong() {
        for (track_scale, difference) in [(0.01, 0.0), (-0.01, 0.0), (0.0, 0.001), (0.0, -0.001), (0.012, -0.0007)] {
            let runs = [SquareDirection::Clockwise, SquareDirection::CounterClockwise]
                .map(|direction| end(direction, track_scale, difference));
            let found = estimate_umbmark(&runs, ROBOT).unwrap();
            // The formulae are of first order: what is left is the square of a corner's error.
            assert!(
                (found.track_scale.value - track_scale).abs() < 0.05 * track_scale.abs() + 5e-5,
                "{track_scale} {difference}: {found:?}"
            );
            assert!(
                (found.radius_difference.value - difference).abs() < 0.05 * difference.abs() + 2e-5,
                "{track_scale} {difference}: {found:?}"
            );
            assert!((found.right_factor / found.left_factor - 1.0 - difference).abs() < 1e-4);
            assert!((found.left_factor + found.right_factor - 2.0).abs() < 1e-6);
        }
    }

    #[test]
    fn by_hand_from_the_equations() {
        let run = |direction, ahead_m, left_m| SquareRun { direction, ahead_m, left_m };
        // L = 4: alpha = 0.02 and beta = 0.01 give x_cw = -0.24, x_ccw = -0.08, y_cw = -0.24, y_ccw = 0.08.
        let runs = [run(SquareDirection::Clockwise, -0.24, -0.24), run(SquareDirection::CounterClockwise, -0.08, 0.08)];
        let found = estimate_umbmark(&runs, ROBOT).unwrap();
        assert!((found.corner_rad - 0.02).abs() < 1e-12 && (found.bend_rad - 0.01).abs() < 1e-12);
        assert!(found.disagreement_rad < 1e-12);
        assert!((found.error.systematic_m - 0.24_f64.hypot(0.24)).abs() < 1e-12);
        // R = 2 / sin 0.005 = 400.00167; E_d = 400.17167 / 399.83167.
        assert!((found.right_factor / found.left_factor - 1.000_850_357).abs() < 1e-8);
    }

    #[test]
    fn the_scatter_of_the_runs_becomes_sigmas() {
        let mut runs = Vec::new();
        for direction in [SquareDirection::Clockwise, SquareDirection::CounterClockwise] {
            for off_m in [-0.01, 0.0, 0.01] {
                runs.push(SquareRun { direction, ahead_m: off_m, left_m: -off_m });
            }
        }
        let found = estimate_umbmark(&runs, ROBOT).unwrap();
        // Variance of a mean of three along an axis: 1e-4 / 3; four of them, half their root, over 16 m.
        let sigma_rad = 0.5 * (4.0 * 1e-4_f64 / 3.0).sqrt() / 16.0;
        assert!((found.track_scale.sigma - sigma_rad / FRAC_PI_2).abs() < 1e-12);
        assert!((found.error.scatter_m - (2.0_f64 * 4e-4 * 2.0 / 2.0 / 6.0).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn one_direction_and_numbers_that_are_none_are_refused() {
        let one = [SquareRun { direction: SquareDirection::Clockwise, ahead_m: 0.1, left_m: 0.0 }];
        assert!(matches!(estimate_umbmark(&one, ROBOT), Err(CalibrationError::TooFewData { found: 0, .. })));
        let mut both = [one[0], one[0]];
        both[1].direction = SquareDirection::CounterClockwise;
        both[1].left_m = f64::NAN;
        assert!(estimate_umbmark(&both, ROBOT).is_err());
        both[1].left_m = 1e9;
        assert!(estimate_umbmark(&both, ROBOT).is_err());
        let side_m = 0.0;
        assert!(estimate_umbmark(&one, SquareRobot { side_m, ..ROBOT }).is_err());
    }
}
