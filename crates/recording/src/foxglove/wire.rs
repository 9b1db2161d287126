//! The Foxglove messages in use, as protocol buffers, and conversions of planar poses, covariances and velocities to three dimensions.
//!
//! Field numbers and types are those of the descriptors in this folder, which recordings contain as schemas; a test compares the two.
//!
//! Source: the `foxglove.*` schemas of the Foxglove SDK, version 0.30.3 (`descriptors/README.md`).

use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{Arena, Estimate, Pose as PlanarPose};
use prost::Message;

/// `google.protobuf.Timestamp`: Unix time.
#[derive(Clone, Copy, PartialEq, Eq, Message)]
pub(super) struct Timestamp {
    #[prost(int64, tag = "1")]
    pub(super) seconds: i64,
    #[prost(int32, tag = "2")]
    pub(super) nanos: i32,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Vector3 {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
    #[prost(double, tag = "3")]
    pub(super) z: f64,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Quaternion {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
    #[prost(double, tag = "3")]
    pub(super) z: f64,
    #[prost(double, tag = "4")]
    pub(super) w: f64,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Pose {
    #[prost(message, optional, tag = "1")]
    pub(super) position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    pub(super) orientation: Option<Quaternion>,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Color {
    #[prost(double, tag = "1")]
    pub(super) r: f64,
    #[prost(double, tag = "2")]
    pub(super) g: f64,
    #[prost(double, tag = "3")]
    pub(super) b: f64,
    #[prost(double, tag = "4")]
    pub(super) a: f64,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Odometry {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) body_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(super) pose: Option<Pose>,
    #[prost(message, optional, tag = "5")]
    pub(super) linear_velocity: Option<Vector3>,
    #[prost(message, optional, tag = "6")]
    pub(super) angular_velocity: Option<Vector3>,
    /// 6 x 6, row by row: x, y, z, roll, pitch, yaw.
    #[prost(double, repeated, tag = "7")]
    pub(super) pose_covariance: Vec<f64>,
    /// 6 x 6, row by row: forward, left, up, roll rate, pitch rate, yaw rate.
    #[prost(double, repeated, tag = "8")]
    pub(super) velocity_covariance: Vec<f64>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub(super) pose: Option<Pose>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct PosesInFrame {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, repeated, tag = "3")]
    pub(super) poses: Vec<Pose>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(super) translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    pub(super) rotation: Option<Quaternion>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneUpdate {
    #[prost(message, repeated, tag = "2")]
    pub(super) entities: Vec<SceneEntity>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneEntity {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    /// Replaces an earlier entity with the same id.
    #[prost(string, tag = "3")]
    pub(super) id: String,
    #[prost(message, repeated, tag = "10")]
    pub(super) cylinders: Vec<Cylinder>,
}

/// `foxglove.CylinderPrimitive`.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Cylinder {
    #[prost(message, optional, tag = "1")]
    pub(super) pose: Option<Pose>,
    /// Full extents: both axes of the ellipse, and the height.
    #[prost(message, optional, tag = "2")]
    pub(super) size: Option<Vector3>,
    #[prost(double, tag = "3")]
    pub(super) bottom_scale: f64,
    #[prost(double, tag = "4")]
    pub(super) top_scale: f64,
    #[prost(message, optional, tag = "5")]
    pub(super) color: Option<Color>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Log {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    /// `foxglove.LogLevel`.
    #[prost(int32, tag = "2")]
    pub(super) level: i32,
    #[prost(string, tag = "3")]
    pub(super) message: String,
    #[prost(string, tag = "4")]
    pub(super) name: String,
}

/// Name of [`Arena`] in messages.
pub(super) const ARENA: &str = "arena";
/// Name of [`posebridge_telemetry::Body`] of the first robot in messages.
pub(super) const BODY: &str = "body";
/// Flat, but thick enough that viewers draw it without flicker.
const DISC_HEIGHT_M: f64 = 0.002;

/// Pose and speeds with covariances, of the robot whose body frame is `body`.
pub(super) fn odometry_of(estimate: &Estimate, body: &str, timestamp: Option<Timestamp>) -> Odometry {
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
    let vector = |x, z| Some(Vector3 { x, y: 0.0, z });
    Odometry {
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

/// The 95 % confidence ellipse as a disc.
pub(super) fn ellipse_of(estimate: &Estimate, timestamp: Option<Timestamp>) -> Option<SceneUpdate> {
    let ellipse = estimate.ellipse_95()?;
    let disc = Cylinder {
        pose: Some(Pose {
            position: pose_of(&estimate.pose).position,
            orientation: Some(rotation_about_z(ellipse.direction_rad)),
        }),
        size: Some(Vector3 { x: 2.0 * ellipse.semi_major_m, y: 2.0 * ellipse.semi_minor_m, z: DISC_HEIGHT_M }),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(Color { r: 0.1, g: 0.4, b: 0.8, a: 0.35 }),
    };
    let entity = SceneEntity { timestamp, frame_id: ARENA.to_owned(), id: "ellipse".to_owned(), cylinders: vec![disc] };
    Some(SceneUpdate { entities: vec![entity] })
}

pub(super) fn pose_of(pose: &PlanarPose<Arena>) -> Pose {
    Pose {
        position: Some(Vector3 { x: pose.x.0, y: pose.y.0, z: 0.0 }),
        orientation: Some(rotation_about_z(pose.heading.rad())),
    }
}

fn rotation_about_z(angle_rad: f64) -> Quaternion {
    let (z, w) = (angle_rad / 2.0).sin_cos();
    Quaternion { x: 0.0, y: 0.0, z, w }
}

/// Converts a MAVLink severity to `foxglove.LogLevel`.
pub(super) const fn log_level(severity: u8) -> i32 {
    match severity {
        0..=2 => 5,
        3 => 4,
        4 => 3,
        5 | 6 => 2,
        _ => 1,
    }
}
