//! What nodes of ROS 2 ask of a robot: speeds, and fixes of another localisation.
//!
//! # Sources
//! common_interfaces of ROS 2 Jazzy for the fields; REP 103 and REP 105 for axes and frames.

use posebridge_telemetry::{Fix, Heading, Meters, MetersPerSecond, Point2, PositionCovariance, RadiansPerSecond};
use thiserror::Error;

use super::cdr_reader::{CdrError, CdrReader};
use super::definitions::{MessageType, POSE_WITH_COVARIANCE_STAMPED};

const TWIST: MessageType = MessageType {
    name: "geometry_msgs/msg/Twist",
    hash: "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
};
const TWIST_STAMPED: MessageType = MessageType {
    name: "geometry_msgs/msg/TwistStamped",
    hash: "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
};

/// A variance of the heading from which on it counts as unknown, rad².
const UNKNOWN_HEADING_RAD2: f64 = 10.0;

/// The topics of a robot that it takes requests on: the last part of the name, and the type.
pub const REQUEST_TOPICS: [(&str, RosRequestType); 3] = [
    ("cmd_vel", RosRequestType::Twist),
    ("cmd_vel", RosRequestType::TwistStamped),
    ("pose_fix", RosRequestType::PoseFix),
];

/// A type of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RosRequestType {
    Twist,
    TwistStamped,
    PoseFix,
}

/// What a node asks of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RosRequest {
    Drive {
        forward: MetersPerSecond,
        turn: RadiansPerSecond,
    },
    /// Of mid-axle, in the arena.
    Fix {
        /// Since 1970; 0 if the node says none.
        unix_nanos: i64,
        fix: Fix,
    },
}

/// Why a message is no request.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RosRequestError {
    #[error("{0}")]
    Content(#[from] CdrError),
    #[error("a number is not finite, or a variance is negative")]
    Number,
    #[error("its frame is `{0}`; a fix is one in `map`, the arena")]
    Frame(String),
}

impl RosRequestType {
    pub const fn message_type(self) -> MessageType {
        match self {
            Self::Twist => TWIST,
            Self::TwistStamped => TWIST_STAMPED,
            Self::PoseFix => POSE_WITH_COVARIANCE_STAMPED,
        }
    }

    /// Never panics.
    pub fn decode(self, message: &[u8]) -> Result<RosRequest, RosRequestError> {
        let mut reader = CdrReader::open(message)?;
        match self {
            Self::Twist => read_twist(&mut reader),
            Self::TwistStamped => {
                read_header(&mut reader)?;
                read_twist(&mut reader)
            }
            Self::PoseFix => read_fix(&mut reader),
        }
    }
}

/// Time since 1970 in nanoseconds, and the frame.
fn read_header<'a>(reader: &mut CdrReader<'a>) -> Result<(i64, &'a str), RosRequestError> {
    let (sec, nanosec) = (reader.i32()?, reader.u32()?);
    Ok((i64::from(sec) * 1_000_000_000 + i64::from(nanosec), reader.text()?))
}

fn read_twist(reader: &mut CdrReader<'_>) -> Result<RosRequest, RosRequestError> {
    let [forward, _, _, _, _, turn] = reader.doubles::<6>()?;
    if !(forward.is_finite() && turn.is_finite()) {
        return Err(RosRequestError::Number);
    }
    Ok(RosRequest::Drive { forward: MetersPerSecond(forward), turn: RadiansPerSecond(turn) })
}

fn read_fix(reader: &mut CdrReader<'_>) -> Result<RosRequest, RosRequestError> {
    let (unix_nanos, frame) = read_header(reader)?;
    if !(frame == "map" || frame.is_empty()) {
        return Err(RosRequestError::Frame(frame.chars().take(64).collect()));
    }
    let [x_m, y_m, _, qx, qy, qz, qw] = reader.doubles::<7>()?;
    let covariance = reader.doubles::<36>()?;
    let [xx_m2, xy_m2, yy_m2, heading_rad2] = [covariance[0], covariance[1], covariance[7], covariance[35]];
    let numbers = [x_m, y_m, qx, qy, qz, qw, xx_m2, xy_m2, yy_m2, heading_rad2];
    if !numbers.iter().all(|number| number.is_finite()) || [xx_m2, yy_m2].iter().any(|variance| *variance < 0.0) {
        return Err(RosRequestError::Number);
    }
    let heading_rad = (2.0 * (qw * qz + qx * qy)).atan2(1.0 - 2.0 * (qy * qy + qz * qz));
    let has_heading = (0.0..UNKNOWN_HEADING_RAD2).contains(&heading_rad2);
    // Zeros: the node does not say it, and the configured noise holds.
    let is_known = xx_m2 > 0.0 && yy_m2 > 0.0;
    let heading_rad2 = if has_heading && heading_rad2 > 0.0 { heading_rad2 } else { f64::INFINITY };
    Ok(RosRequest::Fix {
        unix_nanos,
        fix: Fix {
            position: Point2::new(Meters(x_m), Meters(y_m)),
            heading: has_heading.then(|| Heading::from_rad(heading_rad)),
            covariance: is_known.then_some(PositionCovariance { xx_m2, xy_m2, yy_m2, heading_rad2 }),
            tag_in_body: Point2::new(Meters(0.0), Meters(0.0)),
            reset_counter: 0,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By rosbags 0.11.9 with its own definitions.
    const TWIST_HEX: &str =
        "00010000000000000000d03f0000000000000000000000000000000000000000000000000000000000000000000000000000e0bf";
    const STAMPED_HEX: &str = "0001000000f1536580b2e60e040000006d617000000000000000d03f000000000000000000000000000000000000000000000000\
         0000000000000000000000000000e0bf";
    const POSE_HEX: &str = "0001000000f1536580b2e60e040000006d617000000000000000f83f000000000000e8bf00000000000000000000000000000000\
         0000000000000000333333333333e33f9a9999999999e93f2d431cebe2361a3ff168e388b5f8f43e000000000000000000000000\
         0000000000000000000000000000000000000000f168e388b5f8f43e2d431cebe2363a3f00000000000000000000000000000000\
         00000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         00000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         00000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         000000000000000000000000000000000000000000000000000000000000000000000000000000000000000092cb7f48bf7d4d3f";

    fn bytes(hex: &str) -> Vec<u8> {
        (0..hex.len() / 2).map(|index| u8::from_str_radix(&hex[2 * index..2 * index + 2], 16).unwrap()).collect()
    }

    #[test]
    fn speeds_and_fixes_of_a_foreign_encoder_are_read() {
        let drive = RosRequest::Drive { forward: MetersPerSecond(0.25), turn: RadiansPerSecond(-0.5) };
        assert_eq!(RosRequestType::Twist.decode(&bytes(TWIST_HEX)), Ok(drive));
        assert_eq!(RosRequestType::TwistStamped.decode(&bytes(STAMPED_HEX)), Ok(drive));
        let RosRequest::Fix { unix_nanos, fix } = RosRequestType::PoseFix.decode(&bytes(POSE_HEX)).unwrap() else {
            panic!("a fix");
        };
        assert_eq!(unix_nanos, 1_700_000_000_250_000_000);
        assert_eq!((fix.position.x, fix.position.y), (Meters(1.5), Meters(-0.75)));
        assert!((fix.heading.unwrap().rad() - 2.0 * 0.6_f64.atan2(0.8)).abs() < 1e-15);
        let covariance = PositionCovariance { xx_m2: 1e-4, xy_m2: 2e-5, yy_m2: 4e-4, heading_rad2: 9e-4 };
        assert_eq!(fix.covariance, Some(covariance));
    }

    #[test]
    fn every_cut_and_a_foreign_frame_are_refused() {
        let pose = bytes(POSE_HEX);
        for len in 0..pose.len() {
            assert!(RosRequestType::PoseFix.decode(&pose[..len]).is_err(), "{len} bytes");
        }
        let mut odom = pose;
        odom[16] = b'x';
        assert_eq!(RosRequestType::PoseFix.decode(&odom), Err(RosRequestError::Frame("xap".to_owned())));
        let mut infinite = bytes(TWIST_HEX);
        infinite[4..12].copy_from_slice(&f64::INFINITY.to_le_bytes());
        assert_eq!(RosRequestType::Twist.decode(&infinite), Err(RosRequestError::Number));
    }
}
