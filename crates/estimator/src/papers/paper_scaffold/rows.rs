//! What is done to the rows of pose and speeds alike, whatever other rows a filter's state has behind them.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};

use crate::filter::StartPose;

/// What a robot may do while nothing observes its motion: it walks at random with this speed, m/s per sqrt(s). A LEGO robot's
/// walking pace.
pub(in crate::papers) const UNOBSERVED_M_PER_SQRT_S: f64 = 0.3;
/// The same for its heading, rad per sqrt(s).
const UNOBSERVED_RAD_PER_SQRT_S: f64 = 1.0;

/// Moves the pose to a start, independent of all other rows.
pub(in crate::papers) fn initialize_pose<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    start: &StartPose,
) {
    let pose = start.pose;
    for (row, value, sigma) in [
        (X, pose.x.0, start.position_sigma_m),
        (Y, pose.y.0, start.position_sigma_m),
        (HEADING, pose.heading.rad(), start.heading_sigma_rad),
    ] {
        mean[row] = value;
        set_independent_variance(covariance, row, sigma * sigma);
    }
}

/// Adds standard deviations, in m and rad, to the pose.
pub(in crate::papers) fn inflate_pose<const N: usize>(
    covariance: &mut SMatrix<f64, N, N>,
    position_m: f64,
    heading_rad: f64,
) {
    covariance[(X, X)] += position_m * position_m;
    covariance[(Y, Y)] += position_m * position_m;
    covariance[(HEADING, HEADING)] += heading_rad * heading_rad;
}

/// Lets the pose walk at random for `dt_s`.
pub(in crate::papers) fn add_unobserved_motion<const N: usize>(covariance: &mut SMatrix<f64, N, N>, dt_s: f64) {
    let root_s = dt_s.sqrt();
    inflate_pose(covariance, UNOBSERVED_M_PER_SQRT_S * root_s, UNOBSERVED_RAD_PER_SQRT_S * root_s);
}

/// Adds standard deviations, in m and rad, to the pose, and makes the speeds zero with these variances, independent of all other
/// rows.
pub(in crate::papers) fn reset_speeds<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    position_m: f64,
    heading_rad: f64,
    speed_variances: [f64; 2],
) {
    inflate_pose(covariance, position_m, heading_rad);
    for (row, variance) in [FORWARD, TURN].into_iter().zip(speed_variances) {
        mean[row] = 0.0;
        set_independent_variance(covariance, row, variance);
    }
}

/// Takes these speeds, and adds the variance of an unknown path to the position.
pub(in crate::papers) fn bridge_gap<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    speeds: [f64; 2],
    path_m2: f64,
) {
    mean[FORWARD] = speeds[0];
    mean[TURN] = speeds[1];
    covariance[(X, X)] += path_m2;
    covariance[(Y, Y)] += path_m2;
}

/// Gives a row a variance of its own, independent of all other rows.
pub(in crate::papers) fn set_independent_variance<const N: usize>(
    covariance: &mut SMatrix<f64, N, N>,
    row: usize,
    variance: f64,
) {
    covariance.row_mut(row).fill(0.0);
    covariance.column_mut(row).fill(0.0);
    covariance[(row, row)] = variance;
}
