//! The messages of a bag as far as we write them, field by field in the order of their definitions.

use super::cdr::CdrMessage;

/// `builtin_interfaces/Time`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RosTime {
    pub(super) sec: i32,
    pub(super) nanosec: u32,
}

/// `std_msgs/Header`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header<'a> {
    pub(super) stamp: RosTime,
    pub(super) frame_id: &'a str,
}

/// `geometry_msgs/Pose`, and `geometry_msgs/Transform`, whose fields are the same.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpatialPose {
    pub(super) position: [f64; 3],
    /// x, y, z, w.
    pub(super) orientation: [f64; 4],
}

/// `nav_msgs/Odometry`. Covariances are 6 x 6, row by row: x, y, z, roll, pitch, yaw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Odometry<'a> {
    pub(super) header: Header<'a>,
    pub(super) child_frame_id: &'a str,
    pub(super) pose: SpatialPose,
    pub(super) pose_covariance: [f64; 36],
    pub(super) linear: [f64; 3],
    pub(super) angular: [f64; 3],
    pub(super) twist_covariance: [f64; 36],
}

/// `geometry_msgs/PoseWithCovarianceStamped`.
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseWithCovarianceStamped<'a> {
    pub(super) header: Header<'a>,
    pub(super) pose: SpatialPose,
    pub(super) covariance: [f64; 36],
}

/// `sensor_msgs/Imu`. A covariance that begins with -1 says that the quantity is not measured, one of zeros that it is not known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Imu<'a> {
    pub(super) header: Header<'a>,
    pub(super) orientation: [f64; 4],
    pub(super) orientation_covariance: [f64; 9],
    pub(super) angular_velocity: [f64; 3],
    pub(super) angular_velocity_covariance: [f64; 9],
    pub(super) linear_acceleration: [f64; 3],
    pub(super) linear_acceleration_covariance: [f64; 9],
}

/// `geometry_msgs/TransformStamped`.
#[derive(Clone, Copy, Debug)]
pub(super) struct TransformStamped<'a> {
    pub(super) header: Header<'a>,
    pub(super) child_frame_id: &'a str,
    pub(super) transform: SpatialPose,
}

/// The constants of `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum DiagnosticLevel {
    Ok = 0,
    Warn = 1,
    Error = 2,
    Stale = 3,
}

/// `diagnostic_msgs/DiagnosticStatus`, without a hardware id.
#[derive(Clone, Debug)]
pub(super) struct DiagnosticStatus {
    pub(super) level: DiagnosticLevel,
    pub(super) name: String,
    pub(super) message: String,
    /// Keys and values.
    pub(super) values: Vec<(&'static str, String)>,
}

impl RosTime {
    /// Seconds are 32 bits wide: times beyond 2038 stay at the last one.
    pub(super) fn from_unix_nanos(nanos: i128) -> Self {
        let seconds = nanos.div_euclid(1_000_000_000);
        let sec = i32::try_from(seconds).unwrap_or(if seconds < 0 { i32::MIN } else { i32::MAX });
        Self { sec, nanosec: nanos.rem_euclid(1_000_000_000) as u32 }
    }
}

impl Odometry<'_> {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = CdrMessage::new();
        push_header(&mut out, &self.header);
        out.push_text(self.child_frame_id);
        push_pose(&mut out, &self.pose);
        out.push_doubles(&self.pose_covariance);
        out.push_doubles(&self.linear);
        out.push_doubles(&self.angular);
        out.push_doubles(&self.twist_covariance);
        out.into_bytes()
    }
}

impl PoseWithCovarianceStamped<'_> {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = CdrMessage::new();
        push_header(&mut out, &self.header);
        push_pose(&mut out, &self.pose);
        out.push_doubles(&self.covariance);
        out.into_bytes()
    }
}

impl Imu<'_> {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = CdrMessage::new();
        push_header(&mut out, &self.header);
        out.push_doubles(&self.orientation);
        out.push_doubles(&self.orientation_covariance);
        out.push_doubles(&self.angular_velocity);
        out.push_doubles(&self.angular_velocity_covariance);
        out.push_doubles(&self.linear_acceleration);
        out.push_doubles(&self.linear_acceleration_covariance);
        out.into_bytes()
    }
}

/// `tf2_msgs/TFMessage`.
pub(super) fn encode_transforms(transforms: &[TransformStamped<'_>]) -> Vec<u8> {
    let mut out = CdrMessage::new();
    out.push_count(transforms.len());
    for one in transforms {
        push_header(&mut out, &one.header);
        out.push_text(one.child_frame_id);
        push_pose(&mut out, &one.transform);
    }
    out.into_bytes()
}

/// `diagnostic_msgs/DiagnosticArray`.
pub(super) fn encode_diagnostics(header: &Header<'_>, statuses: &[DiagnosticStatus]) -> Vec<u8> {
    let mut out = CdrMessage::new();
    push_header(&mut out, header);
    out.push_count(statuses.len());
    for status in statuses {
        out.push_u8(status.level as u8);
        out.push_text(&status.name);
        out.push_text(&status.message);
        out.push_text("");
        out.push_count(status.values.len());
        for (key, value) in &status.values {
            out.push_text(key);
            out.push_text(value);
        }
    }
    out.into_bytes()
}

fn push_header(out: &mut CdrMessage, header: &Header<'_>) {
    out.push_i32(header.stamp.sec);
    out.push_u32(header.stamp.nanosec);
    out.push_text(header.frame_id);
}

fn push_pose(out: &mut CdrMessage, pose: &SpatialPose) {
    out.push_doubles(&pose.position);
    out.push_doubles(&pose.orientation);
}

#[cfg(test)]
mod tests;
