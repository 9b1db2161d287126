//! Standard messages of poses: fixes from outside, odometry, and what ground stations draw.
//!
//! Positions and angles are north-east-down, or forward-right-down where a floor frame has no north; [`super::spaces`]
//! turns them. ODOMETRY says in its own frame field which it is: MAV_FRAME_LOCAL_NED (1) is the arena, MAV_FRAME_LOCAL_FRD
//! (20) with child MAV_FRAME_BODY_FRD (12) is a pose that drifts. Source: MAVLink common.xml.

use mavlink::dialects::common::{
    ATT_POS_MOCAP_DATA, ATTITUDE_DATA, ESTIMATOR_STATUS_DATA, EstimatorStatusFlags,
    LOCAL_POSITION_NED_DATA, VISION_POSITION_ESTIMATE_DATA,
};
use posebridge_telemetry::{Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond};

use super::payload::{Payload, Reader, Writer, micros64, millis32, read};
use super::spaces::{
    Planar, TRIANGLE, flip, planar, quaternion, triangle, turn_frd, turn_frd_covariance, turn_ned,
    turn_ned_covariance, yaw,
};
use super::{Decoded, PayloadError, finite, ids};
use crate::framing::WireVersion;
use crate::message::{
    EstimatorStatus, Message, Odometry, OdometryPose, PoseFlags, VisionFix, WireStamp,
};

/// MAV_FRAME values of ODOMETRY.
mod frame {
    pub(super) const LOCAL_NED: u8 = 1;
    pub(super) const LOCAL_ENU: u8 = 4;
    /// Superseded by `BODY_FRD`, same axes.
    pub(super) const BODY_NED: u8 = 8;
    pub(super) const BODY_FRD: u8 = 12;
    /// Reserved since 2019, formerly BODY_FLU, still sent.
    pub(super) const BODY_FLU: u8 = 13;
    pub(super) const LOCAL_FRD: u8 = 20;
    pub(super) const LOCAL_FLU: u8 = 21;
}

/// MAV_ESTIMATOR_TYPE_UNKNOWN: none of the listed ones is wheels and gyro.
const ESTIMATOR_UNKNOWN: u8 = 0;

pub(super) fn attitude(payload: &[u8]) -> Decoded {
    let data: ATTITUDE_DATA = read(payload)?;
    let yaw_rad = finite(ids::ATTITUDE, "yaw", f64::from(data.yaw))?;
    Ok(Some(Message::Attitude {
        stamp: WireStamp::Millis32(data.time_boot_ms),
        heading: heading_from_yaw(yaw_rad),
        turn_rate: RadiansPerSecond(flip(f64::from(data.yawspeed))),
    }))
}

pub(super) fn local_position(payload: &[u8]) -> Decoded {
    let data: LOCAL_POSITION_NED_DATA = read(payload)?;
    let checked = |field, value: f32| finite(ids::LOCAL_POSITION_NED, field, f64::from(value));
    Ok(Some(Message::LocalPosition {
        stamp: WireStamp::Millis32(data.time_boot_ms),
        x: Meters(checked("y", data.y)?),
        y: Meters(checked("x", data.x)?),
        x_speed: MetersPerSecond(f64::from(data.vy)),
        y_speed: MetersPerSecond(f64::from(data.vx)),
    }))
}

pub(super) fn vision_position(payload: &[u8]) -> Decoded {
    let data: VISION_POSITION_ESTIMATE_DATA = read(payload)?;
    let checked =
        |field, value: f32| finite(ids::VISION_POSITION_ESTIMATE, field, f64::from(value));
    Ok(Some(Message::VisionPosition(VisionFix {
        stamp: WireStamp::Micros64(data.usec),
        x: Meters(checked("y", data.y)?),
        y: Meters(checked("x", data.x)?),
        heading: data
            .yaw
            .is_finite()
            .then(|| heading_from_yaw(f64::from(data.yaw))),
        covariance: fix_covariance(&data.covariance),
        reset_counter: data.reset_counter,
    })))
}

fn write_vision(version: WireVersion, fix: &VisionFix) -> Payload {
    let data = VISION_POSITION_ESTIMATE_DATA {
        usec: micros64(fix.stamp),
        x: fix.y.0 as f32,
        y: fix.x.0 as f32,
        z: 0.0,
        roll: 0.0,
        pitch: 0.0,
        yaw: fix
            .heading
            .map_or(f32::NAN, |heading| yaw_from_heading(heading) as f32),
        covariance: fix_triangle(fix.covariance),
        reset_counter: fix.reset_counter,
    };
    Payload::of(version, &data)
}

/// ATT_POS_MOCAP has no reset counter: it reads as 0.
pub(super) fn mocap_position(payload: &[u8]) -> Decoded {
    let data: ATT_POS_MOCAP_DATA = read(payload)?;
    let checked = |field, value: f32| finite(ids::ATT_POS_MOCAP, field, f64::from(value));
    Ok(Some(Message::MocapPosition(VisionFix {
        stamp: WireStamp::Micros64(data.time_usec),
        x: Meters(checked("y", data.y)?),
        y: Meters(checked("x", data.x)?),
        heading: yaw(data.q).map(heading_from_yaw),
        covariance: fix_covariance(&data.covariance),
        reset_counter: 0,
    })))
}

fn write_mocap(version: WireVersion, fix: &VisionFix) -> Payload {
    let data = ATT_POS_MOCAP_DATA {
        time_usec: micros64(fix.stamp),
        q: fix.heading.map_or([f32::NAN; 4], |heading| {
            quaternion(yaw_from_heading(heading))
        }),
        x: fix.y.0 as f32,
        y: fix.x.0 as f32,
        z: 0.0,
        covariance: fix_triangle(fix.covariance),
    };
    Payload::of(version, &data)
}

pub(super) fn odometry(payload: &[u8]) -> Decoded {
    let mut reader = Reader::new(payload);
    let stamp = WireStamp::Micros64(reader.u64());
    let [x, y, _z] = reader.f32s();
    let attitude: [f32; 4] = reader.f32s();
    let [forward, _side, _down] = reader.f32s();
    let [_roll_rate, _pitch_rate, yaw_rate] = reader.f32s();
    let pose_covariance: [f32; TRIANGLE] = reader.f32s();
    reader.skip::<{ 4 * TRIANGLE }>();
    let (pose_frame, twist_frame) = (reader.u8(), reader.u8());
    let reset_counter = reader.u8();
    let _estimator = reader.u8();
    let quality = reader.i8();

    let wire = Planar {
        x: finite(ids::ODOMETRY, "x", f64::from(x))?,
        y: finite(ids::ODOMETRY, "y", f64::from(y))?,
        angle: finite(ids::ODOMETRY, "q", yaw(attitude).unwrap_or(f64::NAN))?,
    };
    let (pose, covariance) = odometry_pose(pose_frame, wire, planar(&pose_covariance))?;
    let turn_rate = match twist_frame {
        frame::BODY_FRD | frame::BODY_NED => flip(f64::from(yaw_rate)),
        frame::BODY_FLU => f64::from(yaw_rate),
        other => return Err(unknown_frame(other)),
    };
    Ok(Some(Message::Odometry(Odometry {
        stamp,
        pose,
        forward_speed: MetersPerSecond(f64::from(forward)),
        turn_rate: RadiansPerSecond(turn_rate),
        covariance,
        reset_counter,
        quality,
    })))
}

type PoseAndCovariance = (OdometryPose, Option<[f64; 6]>);

fn odometry_pose(
    frame: u8,
    wire: Planar,
    covariance: Option<[f64; 6]>,
) -> Result<PoseAndCovariance, PayloadError> {
    let arena = |ours: Planar| OdometryPose::Arena(pose_from(ours));
    let odom = |ours: Planar| OdometryPose::Odom(pose_from(ours));
    Ok(match frame {
        frame::LOCAL_NED => (arena(turn_ned(wire)), covariance.map(turn_ned_covariance)),
        frame::LOCAL_ENU => (arena(wire), covariance),
        frame::LOCAL_FRD => (odom(turn_frd(wire)), covariance.map(turn_frd_covariance)),
        frame::LOCAL_FLU => (odom(wire), covariance),
        other => return Err(unknown_frame(other)),
    })
}

fn pose_from<S>(planar: Planar) -> Pose<S> {
    Pose::new(
        Meters(planar.x),
        Meters(planar.y),
        Heading::from_rad(planar.angle),
    )
}

const fn unknown_frame(frame: u8) -> PayloadError {
    PayloadError::Space {
        message_id: ids::ODOMETRY,
        frame,
    }
}

fn write_odometry(version: WireVersion, odometry: &Odometry) -> Payload {
    let (frame, wire, covariance) = match odometry.pose {
        OdometryPose::Arena(pose) => (
            frame::LOCAL_NED,
            turn_ned(planar_from(pose)),
            odometry.covariance.map(turn_ned_covariance),
        ),
        OdometryPose::Odom(pose) => (
            frame::LOCAL_FRD,
            turn_frd(planar_from(pose)),
            odometry.covariance.map(turn_frd_covariance),
        ),
    };
    Writer::new()
        .u64(micros64(odometry.stamp))
        .f32s(&[wire.x as f32, wire.y as f32, 0.0])
        .f32s(&quaternion(wire.angle))
        .f32s(&[odometry.forward_speed.0 as f32, 0.0, 0.0])
        .f32s(&[0.0, 0.0, flip(odometry.turn_rate.0) as f32])
        .f32s(&triangle(covariance))
        .f32s(&triangle(None))
        .u8(frame)
        .u8(frame::BODY_FRD)
        .extensions()
        .u8(odometry.reset_counter)
        .u8(ESTIMATOR_UNKNOWN)
        .i8(odometry.quality)
        .finish(version)
}

fn planar_from<S>(pose: Pose<S>) -> Planar {
    Planar {
        x: pose.x.0,
        y: pose.y.0,
        angle: pose.heading.rad(),
    }
}

pub(super) fn estimator_status(payload: &[u8]) -> Decoded {
    let data: ESTIMATOR_STATUS_DATA = read(payload)?;
    let has = |flag| data.flags.contains(flag);
    let is_absolute = has(EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS);
    let is_relative = has(EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_REL);
    Ok(Some(Message::EstimatorStatus(EstimatorStatus {
        stamp: WireStamp::Micros64(data.time_usec),
        flags: PoseFlags {
            position_valid: is_absolute || is_relative,
            heading_valid: has(EstimatorStatusFlags::ESTIMATOR_ATTITUDE),
            speeds_valid: has(EstimatorStatusFlags::ESTIMATOR_VELOCITY_HORIZ),
            dead_reckoning: is_relative && !is_absolute,
            predicted: false,
        },
        position_ratio: f64::from(data.pos_horiz_ratio),
        position_sigma: Meters(f64::from(data.pos_horiz_accuracy)),
    })))
}

/// A position that lives on dead reckoning is "relative" and not "absolute". There is no flag for "predicted".
fn write_estimator_status(version: WireVersion, status: &EstimatorStatus) -> Payload {
    let valid = status.flags;
    let mut flags = EstimatorStatusFlags::empty();
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_ATTITUDE,
        valid.heading_valid,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_VELOCITY_HORIZ,
        valid.speeds_valid,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_REL,
        valid.position_valid,
    );
    flags.set(
        EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS,
        valid.position_valid && !valid.dead_reckoning,
    );
    let data = ESTIMATOR_STATUS_DATA {
        time_usec: micros64(status.stamp),
        vel_ratio: 0.0,
        pos_horiz_ratio: status.position_ratio as f32,
        pos_vert_ratio: 0.0,
        mag_ratio: 0.0,
        hagl_ratio: 0.0,
        tas_ratio: 0.0,
        pos_horiz_accuracy: status.position_sigma.0 as f32,
        pos_vert_accuracy: 0.0,
        flags,
    };
    Payload::of(version, &data)
}

/// Writes the messages of this module; `None` for all others.
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "the encoder's match is the exhaustive one and sends only these here"
)]
pub(super) fn write(version: WireVersion, message: &Message) -> Option<(u32, Payload)> {
    let written = match message {
        Message::VisionPosition(fix) => (ids::VISION_POSITION_ESTIMATE, write_vision(version, fix)),
        Message::MocapPosition(fix) => (ids::ATT_POS_MOCAP, write_mocap(version, fix)),
        Message::Odometry(odometry) => (ids::ODOMETRY, write_odometry(version, odometry)),
        Message::EstimatorStatus(status) => (
            ids::ESTIMATOR_STATUS,
            write_estimator_status(version, status),
        ),
        Message::LocalPosition {
            stamp,
            x,
            y,
            x_speed,
            y_speed,
        } => {
            let data = LOCAL_POSITION_NED_DATA {
                time_boot_ms: millis32(*stamp),
                x: y.0 as f32,
                y: x.0 as f32,
                z: 0.0,
                vx: y_speed.0 as f32,
                vy: x_speed.0 as f32,
                vz: 0.0,
            };
            (ids::LOCAL_POSITION_NED, Payload::of(version, &data))
        }
        Message::Attitude {
            stamp,
            heading,
            turn_rate,
        } => {
            let data = ATTITUDE_DATA {
                time_boot_ms: millis32(*stamp),
                roll: 0.0,
                pitch: 0.0,
                yaw: yaw_from_heading(*heading) as f32,
                rollspeed: 0.0,
                pitchspeed: 0.0,
                yawspeed: flip(turn_rate.0) as f32,
            };
            (ids::ATTITUDE, Payload::of(version, &data))
        }
        _ => return None,
    };
    Some(written)
}

fn heading_from_yaw(yaw_rad: f64) -> Heading {
    let pose = Planar {
        x: 0.0,
        y: 0.0,
        angle: yaw_rad,
    };
    Heading::from_rad(turn_ned(pose).angle)
}

fn yaw_from_heading(heading: Heading) -> f64 {
    heading_from_yaw(heading.rad()).rad()
}

/// xx, xy, yy and heading variance in the arena from a north-east-down triangle.
fn fix_covariance(wire: &[f32; TRIANGLE]) -> Option<[f64; 4]> {
    let [xx, xy, _, yy, _, hh] = turn_ned_covariance(planar(wire)?);
    Some([xx, xy, yy, hh])
}

fn fix_triangle(covariance: Option<[f64; 4]>) -> [f32; TRIANGLE] {
    triangle(covariance.map(|[xx, xy, yy, hh]| turn_ned_covariance([xx, xy, 0.0, yy, 0.0, hh])))
}
