//! Planar poses, covariances and velocities as Foxglove's messages for three dimensions.

use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{Arena, Ellipse, Estimate, Pose};

use super::wire;

/// Name of [`Arena`] in messages.
pub(super) const ARENA: &str = "arena";
/// Name of [`posebridge_telemetry::Body`] of the first robot in messages.
pub(super) const BODY: &str = "body";
/// Radius, in standard deviations, that holds 95 % of a normal distribution in the plane: sqrt(-2 ln 0.05).
const SIGMAS_95: f64 = 2.447_746_830_680_816;
/// Height of the ellipse's disc, m: flat, but not so flat that a viewer lets it flicker.
const DISC_HEIGHT_M: f64 = 0.002;

/// Pose and speeds with their covariances, of the robot whose body has this name.
pub(super) fn odometry_of(estimate: &Estimate, body: &str, timestamp: Option<wire::Timestamp>) -> wire::Odometry {
    // Rows of a pose in space, and of a velocity, that a robot on a plane has.
    const POSE_ROWS: [(usize, usize); 3] = [(0, row::X), (1, row::Y), (5, row::HEADING)];
    const VELOCITY_ROWS: [(usize, usize); 2] = [(0, row::FORWARD), (5, row::TURN)];
    let spread = |rows: &[(usize, usize)]| {
        let mut matrix = vec![0.0; 36];
        for (i, from_i) in rows {
            for (j, from_j) in rows {
                if let Some(entry) = matrix.get_mut(6 * i + j) {
                    *entry = estimate.covariance[*from_i][*from_j];
                }
            }
        }
        matrix
    };
    let vector = |x, z| Some(wire::Vector3 { x, y: 0.0, z });
    wire::Odometry {
        timestamp,
        frame_id: ARENA.to_owned(),
        body_frame_id: body.to_owned(),
        pose: Some(pose_of(&estimate.pose)),
        linear_velocity: vector(estimate.forward_speed.0, 0.0),
        angular_velocity: vector(0.0, estimate.turn_rate.0),
        pose_covariance: spread(&POSE_ROWS),
        velocity_covariance: spread(&VELOCITY_ROWS),
    }
}

/// The disc in which the robot is with a probability of 95 %.
pub(super) fn ellipse_of(estimate: &Estimate, timestamp: Option<wire::Timestamp>) -> Option<wire::SceneUpdate> {
    let of = |i: usize, j: usize| estimate.covariance[i][j];
    let ellipse = Ellipse::from_covariance(of(row::X, row::X), of(row::X, row::Y), of(row::Y, row::Y), SIGMAS_95)?;
    let disc = wire::Cylinder {
        pose: Some(wire::Pose {
            position: pose_of(&estimate.pose).position,
            orientation: Some(rotation_about_z(ellipse.direction_rad)),
        }),
        size: Some(wire::Vector3 { x: 2.0 * ellipse.semi_major_m, y: 2.0 * ellipse.semi_minor_m, z: DISC_HEIGHT_M }),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(wire::Color { r: 0.1, g: 0.4, b: 0.8, a: 0.35 }),
    };
    let entity =
        wire::SceneEntity { timestamp, frame_id: ARENA.to_owned(), id: "ellipse".to_owned(), cylinders: vec![disc] };
    let entities = vec![entity];
    Some(wire::SceneUpdate { entities })
}

/// A pose on the plane in space.
pub(super) fn pose_of(pose: &Pose<Arena>) -> wire::Pose {
    wire::Pose {
        position: Some(wire::Vector3 { x: pose.x.0, y: pose.y.0, z: 0.0 }),
        orientation: Some(rotation_about_z(pose.heading.rad())),
    }
}

/// A turn about the vertical as a quaternion.
fn rotation_about_z(angle_rad: f64) -> wire::Quaternion {
    let (z, w) = (angle_rad / 2.0).sin_cos();
    wire::Quaternion { x: 0.0, y: 0.0, z, w }
}

/// `foxglove.LogLevel` of a MAVLink severity.
pub(super) const fn log_level(severity: u8) -> i32 {
    match severity {
        0..=2 => 5,
        3 => 4,
        4 => 3,
        5 | 6 => 2,
        _ => 1,
    }
}
