//! The Foxglove messages in use, as protocol buffers, and conversions of planar poses, covariances and velocities to three dimensions.
//!
//! Field numbers and types are those of the descriptors in this folder, which recordings contain as schemas; a test compares the two.
//!
//! Source: the `foxglove.*` schemas of the Foxglove SDK, version 0.30.3 (`descriptors/README.md`).

use posebridge_telemetry::{Arena, Estimate, Pose};

use crate::planar::{POSE_ROWS, VELOCITY_ROWS, quaternion_about_z, spatial_covariance};

/// A message under construction, field by field. Zeros and empty texts are the format's defaults and not written.
///
/// Source: Protocol Buffers, "Encoding": a key is `number << 3 | wire type`; 0 varint, 1 eight bytes, 2 counted bytes.
#[derive(Clone, Debug, Default)]
pub(super) struct Message(Vec<u8>);

impl Message {
    fn double(mut self, number: u8, value: f64) -> Self {
        if value != 0.0 {
            self.0.push(number << 3 | 1);
            self.0.extend(value.to_le_bytes());
        }
        self
    }

    fn doubles(self, number: u8, values: &[f64]) -> Self {
        self.bytes(number, values.iter().copied().map(f64::to_le_bytes).collect::<Vec<_>>().as_flattened())
    }

    fn integer(mut self, number: u8, value: u64) -> Self {
        if value != 0 {
            self.0.push(number << 3);
            self.push_varint(value);
        }
        self
    }

    fn text(self, number: u8, text: &str) -> Self {
        if text.is_empty() { self } else { self.bytes(number, text.as_bytes()) }
    }

    fn message(self, number: u8, message: &Self) -> Self {
        self.bytes(number, &message.0)
    }

    fn bytes(mut self, number: u8, bytes: &[u8]) -> Self {
        self.0.push(number << 3 | 2);
        self.push_varint(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    fn push_varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}

/// Name of [`Arena`] in messages.
pub(super) const ARENA: &str = "arena";
/// Name, of the first robot, of the frame of poses that are relative to where it started.
pub(super) const START: &str = "start";
/// Name of [`posebridge_telemetry::Body`] of the first robot in messages.
pub(super) const BODY: &str = "body";
/// Flat, but thick enough that viewers draw it without flicker.
const DISC_HEIGHT_M: f64 = 0.002;

/// `google.protobuf.Timestamp`: seconds, nanoseconds.
pub(super) fn timestamp(unix_nanos: i128) -> Message {
    let seconds = unix_nanos.div_euclid(1_000_000_000) as u64;
    Message::default().integer(1, seconds).integer(2, unix_nanos.rem_euclid(1_000_000_000) as u64)
}

/// `foxglove.Odometry`: timestamp, frame, body frame, pose, linear and angular velocity; covariances, 6 x 6 row by row, of x, y, z,
/// roll, pitch, yaw and of their rates. `body` is the robot's body frame.
pub(super) fn odometry(estimate: &Estimate, frame: &str, body: &str, timestamp: &Message) -> Message {
    in_frame(frame, timestamp)
        .text(3, body)
        .message(4, &pose_in_space(estimate.pose))
        .message(5, &vector(estimate.forward_speed.0, 0.0, 0.0))
        .message(6, &vector(0.0, 0.0, estimate.turn_rate.0))
        .doubles(7, &spatial_covariance(estimate, &POSE_ROWS, 0.0))
        .doubles(8, &spatial_covariance(estimate, &VELOCITY_ROWS, 0.0))
}

/// `foxglove.PoseInFrame`: timestamp, frame, pose.
pub(super) fn pose_in_frame(pose: Pose<Arena>, frame: &str, timestamp: &Message) -> Message {
    in_frame(frame, timestamp).message(3, &pose_in_space(pose))
}

/// `foxglove.PosesInFrame`: timestamp, frame, poses.
pub(super) fn poses_in_frame(poses: &[Pose<Arena>], frame: &str, timestamp: &Message) -> Message {
    poses.iter().fold(in_frame(frame, timestamp), |message, pose| message.message(3, &pose_in_space(*pose)))
}

/// `foxglove.FrameTransform`: timestamp, parent frame, child frame, translation, rotation.
pub(super) fn transform(pose: Pose<Arena>, frame: &str, body: &str, timestamp: &Message) -> Message {
    let (position, rotation) = (vector(pose.x.0, pose.y.0, 0.0), rotation_about_z(pose.heading.rad()));
    in_frame(frame, timestamp).text(3, body).message(4, &position).message(5, &rotation)
}

/// The 95 % confidence ellipse as a disc. `foxglove.SceneUpdate`: entities of timestamp, frame, id (replaces an earlier entity with it)
/// and cylinders of pose, full extents, bottom and top scale, colour.
pub(super) fn ellipse(estimate: &Estimate, frame: &str, timestamp: &Message) -> Option<Message> {
    let ellipse = estimate.ellipse_95()?;
    let pose = pose_message(estimate.pose, ellipse.direction_rad);
    let size = vector(2.0 * ellipse.semi_major_m, 2.0 * ellipse.semi_minor_m, DISC_HEIGHT_M);
    let color = vector(0.1, 0.4, 0.8).double(4, 0.35);
    let disc = Message::default().message(1, &pose).message(2, &size).double(3, 1.0).double(4, 1.0).message(5, &color);
    let entity = in_frame(frame, timestamp).text(3, "ellipse").message(10, &disc);
    Some(Message::default().message(2, &entity))
}

/// `foxglove.Log`: timestamp, level, message, name. `severity` is MAVLink's: 0 emergency to 7 debug.
pub(super) fn log(severity: u8, name: &str, text: &str, timestamp: &Message) -> Message {
    let level = match severity {
        0..=2 => 5,
        3 => 4,
        4 => 3,
        5 | 6 => 2,
        _ => 1,
    };
    Message::default().message(1, timestamp).integer(2, level).text(3, text).text(4, name)
}

/// The first two fields of most messages.
fn in_frame(frame: &str, timestamp: &Message) -> Message {
    Message::default().message(1, timestamp).text(2, frame)
}

fn pose_in_space(pose: Pose<Arena>) -> Message {
    pose_message(pose, pose.heading.rad())
}

/// `foxglove.Pose` at the position of `pose`: position, orientation.
fn pose_message(pose: Pose<Arena>, angle_rad: f64) -> Message {
    Message::default().message(1, &vector(pose.x.0, pose.y.0, 0.0)).message(2, &rotation_about_z(angle_rad))
}

/// `foxglove.Quaternion`: x, y, z, w.
fn rotation_about_z(angle_rad: f64) -> Message {
    let [x, y, z, w] = quaternion_about_z(angle_rad);
    vector(x, y, z).double(4, w)
}

/// `foxglove.Vector3`: x, y, z.
fn vector(x: f64, y: f64, z: f64) -> Message {
    Message::default().double(1, x).double(2, y).double(3, z)
}
