//! Poses and covariances of a robot on a plane as messages in space have them.

use posebridge_telemetry::Estimate;
use posebridge_telemetry::estimate::row;

/// Rows of a pose in space (x, y, z, roll, pitch, yaw) and of the estimate's covariance.
pub(crate) const POSE_ROWS: [(usize, usize); 3] = [(0, row::X), (1, row::Y), (5, row::HEADING)];
/// The same of a velocity in space.
pub(crate) const VELOCITY_ROWS: [(usize, usize); 2] = [(0, row::FORWARD), (5, row::TURN)];

/// 6 x 6, row by row; rows that the estimate does not have get the variance `unmeasured` and no correlation.
pub(crate) fn spatial_covariance(estimate: &Estimate, rows: &[(usize, usize)], unmeasured: f64) -> [f64; 36] {
    let mut matrix = [0.0; 36];
    for axis in 0..6 {
        matrix[7 * axis] = unmeasured;
    }
    for (i, from_i) in rows {
        for (j, from_j) in rows {
            matrix[6 * i + j] = estimate.covariance[*from_i][*from_j];
        }
    }
    matrix
}

/// x, y, z, w of a rotation about the vertical.
pub(crate) fn quaternion_about_z(angle_rad: f64) -> [f64; 4] {
    let (z, w) = (angle_rad / 2.0).sin_cos();
    [0.0, 0.0, z, w]
}
