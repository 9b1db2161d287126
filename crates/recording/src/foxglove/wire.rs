//! The messages of Foxglove that are written here, as protocol buffers.
//!
//! Field numbers and types are those of the descriptors beside this file, which go into the recording as schemas; a
//! test compares the two.
//!
//! Source: the `foxglove.*` schemas of the Foxglove SDK, version 0.30.3 (`descriptors/README.md`).

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
    /// What has the same id as an earlier entity replaces it.
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
    /// Its whole extents: both axes of the ellipse at its foot, and its height.
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
