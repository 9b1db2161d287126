//! Our bytes against those of rosbags, which `golden.py` makes of the same values.

use super::*;

const GOLDEN: &str = include_str!("golden.txt");

const STAMP: RosTime = RosTime { sec: 1_700_000_000, nanosec: 123_456_789 };
const POSE: SpatialPose = SpatialPose { position: [1.5, -0.25, 0.0], orientation: [0.0, 0.0, 0.6, 0.8] };

/// The bytes behind the name and the length of the message.
fn golden(name: &str) -> Vec<u8> {
    let mut lines = GOLDEN.lines().skip_while(|line| line.split(' ').next() != Some(name));
    let length: usize = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
    let digits: String = lines.take_while(|line| !line.contains(' ')).collect();
    assert_eq!(digits.len(), 2 * length, "{name}");
    (0..length).map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).unwrap()).collect()
}

fn assert_golden(name: &str, bytes: &[u8]) {
    assert_eq!(bytes, golden(name), "{name}");
}

fn header(frame_id: &str) -> Header<'_> {
    Header { stamp: STAMP, frame_id }
}

fn covariance<const SIZE: usize>(step: f64) -> [f64; SIZE] {
    std::array::from_fn(|index| step * index as f64)
}

#[test]
fn odometry_has_the_bytes_of_rosbags() {
    let message = Odometry {
        header: header("map"),
        child_frame_id: "left/base_link",
        pose: POSE,
        pose_covariance: covariance(0.5),
        linear: [0.25, 0.0, 0.0],
        angular: [0.0, 0.0, -0.5],
        twist_covariance: covariance(0.25),
    };
    assert_golden("odometry", &message.encode());
}

#[test]
fn a_pose_has_the_bytes_of_rosbags() {
    let message = PoseWithCovarianceStamped { header: header("odom"), pose: POSE, covariance: covariance(0.5) };
    assert_golden("pose_with_covariance_stamped", &message.encode());
}

#[test]
fn an_imu_has_the_bytes_of_rosbags() {
    let message = Imu {
        header: header("base_link"),
        orientation: [0.0, 0.0, 0.0, 1.0],
        orientation_covariance: covariance(1.0),
        angular_velocity: [0.0, 0.0, -0.5],
        angular_velocity_covariance: covariance(2.0),
        linear_acceleration: [0.0, 0.0, 9.75],
        linear_acceleration_covariance: covariance(4.0),
    };
    assert_golden("imu", &message.encode());
}

#[test]
fn transforms_have_the_bytes_of_rosbags() {
    let between =
        |frame_id, child_frame_id| TransformStamped { header: header(frame_id), child_frame_id, transform: POSE };
    let bytes = encode_transforms(&[between("map", "odom"), between("odom", "base_link")]);
    assert_golden("tf_message", &bytes);
}

#[test]
fn diagnostics_have_the_bytes_of_rosbags() {
    let statuses = [
        DiagnosticStatus {
            level: DiagnosticLevel::Error,
            name: "posebridge: link 0".to_owned(),
            message: "down".to_owned(),
            values: vec![("frames_in", "12".to_owned()), ("b", String::new())],
        },
        DiagnosticStatus {
            level: DiagnosticLevel::Ok,
            name: "r\u{f6}bot".to_owned(),
            message: String::new(),
            values: Vec::new(),
        },
    ];
    assert_golden("diagnostic_array", &encode_diagnostics(&header(""), &statuses));
}

#[test]
fn a_time_has_whole_seconds_and_nanoseconds_from_zero() {
    let of = |nanos| RosTime::from_unix_nanos(nanos);
    assert_eq!(of(1_500_000_001), RosTime { sec: 1, nanosec: 500_000_001 });
    assert_eq!(of(-1), RosTime { sec: -1, nanosec: 999_999_999 });
    assert_eq!(of(i128::from(u64::MAX)).sec, i32::MAX);
}
