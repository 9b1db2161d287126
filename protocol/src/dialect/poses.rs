//! Standard messages of poses: external fixes, odometry, and what ground stations draw.
//!
//! Positions and angles are north-east-down, or forward-right-down where a floor frame has no north; [`super::frames`]
//! converts them. ODOMETRY names its frame: MAV_FRAME_LOCAL_NED (1) is the arena, MAV_FRAME_LOCAL_FRD (20) with child
//! MAV_FRAME_BODY_FRD (12) is a pose that drifts, unless the sender is an external observer (estimator type vision or
//! mocap): then forward is the arena's x. Trackers still send the frames of mocap and vision that are reserved since
//! 2019. Source: MAVLink common.xml, MAV_FRAME and MAV_ESTIMATOR_TYPE, and their history.

use mavlink::dialects::common::{
    ATT_POS_MOCAP_DATA, ATTITUDE_DATA, ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, LOCAL_POSITION_NED_DATA,
    VISION_POSITION_ESTIMATE_DATA,
};
use posebridge_telemetry::{
    GeodeticPoint, Heading, LandmarkId, Meters, MetersPerSecond, Pose, Radians, RadiansPerSecond,
};

use super::frames::{
    PlanarPoint, TRIANGLE_LEN, frame, negate, planar, quaternion, triangle, turn_frd, turn_frd_covariance, turn_ned,
    turn_ned_covariance, yaw,
};
use super::ids;
use super::payload::{
    Decoded, Payload, PayloadError, PayloadReader, decode_generated, micros64, millis32, require_finite,
};
use crate::message::{
    EstimatorStatus, GnssFix, LandmarkSighting, Message, Odometry, OdometryPose, PoseFlags, VisionFix, WireStamp,
};

/// MAV_ESTIMATOR_TYPE_UNKNOWN: there is no type for wheels and gyro.
const ESTIMATOR_UNKNOWN: u8 = 0;
/// MAV_ESTIMATOR_TYPE_VISION: an external observer without inertial sensors.
const ESTIMATOR_VISION: u8 = 2;
const ESTIMATOR_MOCAP: u8 = 6;

/// Unit of latitude and longitude.
const DEGREES_E7: f64 = 1e-7;
/// Unit of GPS_RAW_INT.eph and of the accuracies.
const HUNDREDTH: f64 = 1e-2;
pub(super) const MILLIMETER_M: f64 = 1e-3;
/// GPS_RAW_INT.eph and vel when the sender does not know them.
const DILUTION_UNKNOWN: u16 = u16::MAX;
const SPEED_UNKNOWN: u16 = u16::MAX;
/// The error of a range to a satellite, by which a dilution of precision becomes a length: a receiver with the broadcast corrections, one
/// frequency, open sky (GPS Standard Positioning Service Performance Standard, 2020, appendix B).
const USER_RANGE_ERROR_M: f64 = 2.5;
/// GPS_FIX_TYPE_2D_FIX, the lowest that is a position, and GPS_FIX_TYPE_STATIC, the first that is not measured.
const GPS_FIX_2D: u8 = 2;
const GPS_FIX_3D: u8 = 3;
const GPS_FIX_STATIC: u8 = 7;
/// LANDING_TARGET_TYPE_VISION_OTHER.
const LANDING_TARGET_OTHER: u8 = 3;

pub(super) fn attitude(payload: &[u8]) -> Decoded {
    let data: ATTITUDE_DATA = decode_generated(payload)?;
    let yaw_rad = require_finite(ids::ATTITUDE, "yaw", f64::from(data.yaw))?;
    Ok(Some(Message::Attitude {
        stamp: WireStamp::Millis32(data.time_boot_ms),
        heading: heading_from_yaw(yaw_rad),
        turn_rate: RadiansPerSecond(negate(f64::from(data.yawspeed))),
    }))
}

pub(super) fn write_attitude(stamp: WireStamp, heading: Heading, turn_rate: RadiansPerSecond) -> Payload {
    let data = ATTITUDE_DATA {
        time_boot_ms: millis32(stamp),
        yaw: yaw_from_heading(heading) as f32,
        yawspeed: negate(turn_rate.0) as f32,
        ..ATTITUDE_DATA::DEFAULT
    };
    Payload::encode(&data)
}

pub(super) fn local_position(payload: &[u8]) -> Decoded {
    let data: LOCAL_POSITION_NED_DATA = decode_generated(payload)?;
    let checked = |field, value: f32| require_finite(ids::LOCAL_POSITION_NED, field, f64::from(value));
    Ok(Some(Message::LocalPosition {
        stamp: WireStamp::Millis32(data.time_boot_ms),
        x: Meters(checked("y", data.y)?),
        y: Meters(checked("x", data.x)?),
        x_speed: MetersPerSecond(f64::from(data.vy)),
        y_speed: MetersPerSecond(f64::from(data.vx)),
    }))
}

/// `x` and `y` are the arena's, east and north.
pub(super) fn write_local_position(
    stamp: WireStamp,
    x: Meters,
    y: Meters,
    x_speed: MetersPerSecond,
    y_speed: MetersPerSecond,
) -> Payload {
    let data = LOCAL_POSITION_NED_DATA {
        time_boot_ms: millis32(stamp),
        x: y.0 as f32,
        y: x.0 as f32,
        vx: y_speed.0 as f32,
        vy: x_speed.0 as f32,
        ..LOCAL_POSITION_NED_DATA::DEFAULT
    };
    Payload::encode(&data)
}

pub(super) fn vision_position(message_id: u32, payload: &[u8]) -> Decoded {
    let data: VISION_POSITION_ESTIMATE_DATA = decode_generated(payload)?;
    let checked = |field, value: f32| require_finite(message_id, field, f64::from(value));
    Ok(Some(Message::VisionPosition(VisionFix {
        stamp: WireStamp::Micros64(data.usec),
        x: Meters(checked("y", data.y)?),
        y: Meters(checked("x", data.x)?),
        heading: data.yaw.is_finite().then(|| heading_from_yaw(f64::from(data.yaw))),
        covariance: fix_covariance(&data.covariance),
        reset_counter: data.reset_counter,
        tag: None,
    })))
}

/// A position that two or three dimensions are known of; others are no fix.
pub(super) fn gnss_fix(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    let [latitude, longitude, _altitude]: [i32; 3] = std::array::from_fn(|_| reader.number());
    let horizontal_dilution = reader.number::<u16>();
    let _vertical_dilution = reader.number::<u16>();
    let ground_speed_cm_per_s = reader.number::<u16>();
    let _course = reader.number::<u16>();
    let fix_type = reader.number::<u8>();
    // The number of satellites, and as an extension the altitude above the ellipsoid.
    reader.skip::<5>();
    let horizontal_accuracy_mm = reader.number::<u32>();
    let in_degrees = |value: i32| f64::from(value) * DEGREES_E7;
    let is_on_earth = in_degrees(latitude).abs() <= 90.0 && in_degrees(longitude).abs() <= 180.0;
    if !(GPS_FIX_2D..GPS_FIX_STATIC).contains(&fix_type) || !is_on_earth {
        return None;
    }
    let sigma_m = match (horizontal_accuracy_mm, horizontal_dilution) {
        (0, 0 | DILUTION_UNKNOWN) => None,
        (0, dilution) => Some(f64::from(dilution) * HUNDREDTH * USER_RANGE_ERROR_M),
        (accuracy_mm, _) => Some(f64::from(accuracy_mm) * MILLIMETER_M),
    };
    Some(Message::GnssFix(GnssFix {
        stamp,
        position: geodetic_point(latitude, longitude),
        sigma: sigma_m.map(Meters),
        ground_speed: (ground_speed_cm_per_s != SPEED_UNKNOWN)
            .then(|| MetersPerSecond(f64::from(ground_speed_cm_per_s) * HUNDREDTH)),
    }))
}

/// From the unit of the wire.
pub(super) fn geodetic_point(latitude: i32, longitude: i32) -> GeodeticPoint {
    let [latitude, longitude] =
        [latitude, longitude].map(|value| Radians((f64::from(value) * DEGREES_E7).to_radians()));
    GeodeticPoint { latitude, longitude }
}

/// In the unit of the wire.
pub(super) fn latitude_e7(point: GeodeticPoint) -> i32 {
    (point.latitude.0.to_degrees() / DEGREES_E7).round() as i32
}

/// In the unit of the wire.
pub(super) fn longitude_e7(point: GeodeticPoint) -> i32 {
    (point.longitude.0.to_degrees() / DEGREES_E7).round() as i32
}

pub(super) fn write_gnss_fix(fix: &GnssFix) -> Payload {
    let accuracy_mm = fix.sigma.map_or(0, |sigma| (sigma.0 / MILLIMETER_M).round() as u32);
    let speed = fix.ground_speed.map_or(SPEED_UNKNOWN, |speed| (speed.0 / HUNDREDTH).round() as u16);
    let (altitude_mm, satellites, no_course) = (0, u8::MAX, u16::MAX);
    Payload::new(ids::GPS_RAW_INT)
        .number::<u64>(micros64(fix.stamp))
        .number::<i32>(latitude_e7(fix.position))
        .number::<i32>(longitude_e7(fix.position))
        .number::<i32>(altitude_mm)
        .number::<u16>(DILUTION_UNKNOWN)
        .number::<u16>(DILUTION_UNKNOWN)
        .number::<u16>(speed)
        .number::<u16>(no_course)
        .number::<u8>(GPS_FIX_3D)
        .number::<u8>(satellites)
        .number::<i32>(altitude_mm)
        .number::<u32>(accuracy_mm)
}

/// Only positions that the sender calls valid, in the vehicle's own axes: angles in a picture need its camera.
pub(super) fn landing_target(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    reader.skip::<{ 5 * 4 }>();
    let (target, target_frame) = (reader.number::<u8>(), reader.number::<u8>());
    let [forward, right, _down] = reader.f32s();
    reader.skip::<{ 4 * 4 + 1 }>();
    let is_position_valid = reader.number::<u8>() == 1;
    if !is_position_valid || !matches!(target_frame, frame::BODY_FRD | frame::BODY_NED) {
        return Ok(None);
    }
    let forward_m = require_finite(ids::LANDING_TARGET, "x", f64::from(forward))?;
    let left_m = negate(require_finite(ids::LANDING_TARGET, "y", f64::from(right))?);
    Ok(Some(Message::LandmarkSighting(LandmarkSighting {
        stamp,
        landmark: LandmarkId(u32::from(target)),
        forward: Meters(forward_m),
        left: Meters(left_m),
    })))
}

pub(super) fn write_landing_target(sighting: &LandmarkSighting) -> Payload {
    let LandmarkSighting { forward, left, .. } = sighting;
    let distance_m = forward.0.hypot(left.0);
    let (kind, position_valid) = (LANDING_TARGET_OTHER, 1);
    Payload::new(ids::LANDING_TARGET)
        .number::<u64>(micros64(sighting.stamp))
        .f32s(&[0.0, 0.0, distance_m as f32, 0.0, 0.0])
        .number::<u8>(sighting.landmark.0 as u8)
        .number::<u8>(frame::BODY_FRD)
        .f32s(&[forward.0 as f32, negate(left.0) as f32, 0.0])
        .f32s(&[1.0, 0.0, 0.0, 0.0])
        .number::<u8>(kind)
        .number::<u8>(position_valid)
}

pub(super) fn write_vision(fix: &VisionFix) -> Payload {
    let data = VISION_POSITION_ESTIMATE_DATA {
        usec: micros64(fix.stamp),
        x: fix.y.0 as f32,
        y: fix.x.0 as f32,
        yaw: fix.heading.map_or(f32::NAN, |heading| yaw_from_heading(heading) as f32),
        covariance: fix_triangle(fix.covariance),
        reset_counter: fix.reset_counter,
        ..VISION_POSITION_ESTIMATE_DATA::DEFAULT
    };
    Payload::encode(&data)
}

/// ATT_POS_MOCAP has no reset counter: it reads as 0.
pub(super) fn mocap_position(payload: &[u8]) -> Decoded {
    let data: ATT_POS_MOCAP_DATA = decode_generated(payload)?;
    let checked = |field, value: f32| require_finite(ids::ATT_POS_MOCAP, field, f64::from(value));
    Ok(Some(Message::MocapPosition(VisionFix {
        stamp: WireStamp::Micros64(data.time_usec),
        x: Meters(checked("y", data.y)?),
        y: Meters(checked("x", data.x)?),
        heading: yaw(data.q).map(heading_from_yaw),
        covariance: fix_covariance(&data.covariance),
        reset_counter: 0,
        tag: None,
    })))
}

pub(super) fn write_mocap(fix: &VisionFix) -> Payload {
    let data = ATT_POS_MOCAP_DATA {
        time_usec: micros64(fix.stamp),
        q: fix.heading.map_or([f32::NAN; 4], |heading| quaternion(yaw_from_heading(heading))),
        x: fix.y.0 as f32,
        y: fix.x.0 as f32,
        z: 0.0,
        covariance: fix_triangle(fix.covariance),
    };
    Payload::encode(&data)
}

pub(super) fn odometry(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    let [x, y, _z] = reader.f32s();
    let attitude: [f32; 4] = reader.f32s();
    let [forward, _side, _down] = reader.f32s();
    let [_roll_rate, _pitch_rate, yaw_rate] = reader.f32s();
    let pose_covariance: [f32; TRIANGLE_LEN] = reader.f32s();
    reader.skip::<{ 4 * TRIANGLE_LEN }>();
    let (pose_frame, twist_frame) = (reader.number::<u8>(), reader.number::<u8>());
    let reset_counter = reader.number::<u8>();
    let estimator = reader.number::<u8>();
    let quality = reader.number::<i8>();
    if quality < 0 {
        let message_id = ids::ODOMETRY;
        return Err(PayloadError::SenderFailed { message_id });
    }

    let wire = PlanarPoint {
        x: require_finite(ids::ODOMETRY, "x", f64::from(x))?,
        y: require_finite(ids::ODOMETRY, "y", f64::from(y))?,
        angle: require_finite(ids::ODOMETRY, "q", yaw(attitude).unwrap_or(f64::NAN))?,
    };
    let (pose, covariance) = odometry_pose(pose_frame, wire, planar(&pose_covariance))?;
    let pose = match pose {
        OdometryPose::Odom(pose) if matches!(estimator, ESTIMATOR_VISION | ESTIMATOR_MOCAP) => {
            OdometryPose::Arena(Pose::new(pose.x, pose.y, pose.heading))
        }
        pose @ (OdometryPose::Arena(_) | OdometryPose::Odom(_)) => pose,
    };
    let turn_rate = match twist_frame {
        frame::BODY_FRD | frame::BODY_NED => negate(f64::from(yaw_rate)),
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
    wire: PlanarPoint,
    covariance: Option<[f64; 6]>,
) -> Result<PoseAndCovariance, PayloadError> {
    let arena = |ours: PlanarPoint| OdometryPose::Arena(pose_from(ours));
    let odom = |ours: PlanarPoint| OdometryPose::Odom(pose_from(ours));
    Ok(match frame {
        frame::LOCAL_NED | frame::MOCAP_NED | frame::VISION_NED => {
            (arena(turn_ned(wire)), covariance.map(turn_ned_covariance))
        }
        frame::LOCAL_ENU | frame::MOCAP_ENU | frame::VISION_ENU => (arena(wire), covariance),
        frame::LOCAL_FRD => (odom(turn_frd(wire)), covariance.map(turn_frd_covariance)),
        frame::LOCAL_FLU => (odom(wire), covariance),
        other => return Err(unknown_frame(other)),
    })
}

fn pose_from<S>(planar: PlanarPoint) -> Pose<S> {
    Pose::new(Meters(planar.x), Meters(planar.y), Heading::from_rad(planar.angle))
}

const fn unknown_frame(frame: u8) -> PayloadError {
    PayloadError::UnknownFrame { message_id: ids::ODOMETRY, frame }
}

pub(super) fn write_odometry(odometry: &Odometry) -> Payload {
    let (frame, wire, covariance) = match odometry.pose {
        OdometryPose::Arena(pose) => {
            (frame::LOCAL_NED, turn_ned(planar_from(pose)), odometry.covariance.map(turn_ned_covariance))
        }
        OdometryPose::Odom(pose) => {
            (frame::LOCAL_FRD, turn_frd(planar_from(pose)), odometry.covariance.map(turn_frd_covariance))
        }
    };
    Payload::new(ids::ODOMETRY)
        .number::<u64>(micros64(odometry.stamp))
        .f32s(&[wire.x as f32, wire.y as f32, 0.0])
        .f32s(&quaternion(wire.angle))
        .f32s(&[odometry.forward_speed.0 as f32, 0.0, 0.0])
        .f32s(&[0.0, 0.0, negate(odometry.turn_rate.0) as f32])
        .f32s(&triangle(covariance))
        .f32s(&triangle(None))
        .number::<u8>(frame)
        .number::<u8>(frame::BODY_FRD)
        .number::<u8>(odometry.reset_counter)
        .number::<u8>(ESTIMATOR_UNKNOWN)
        .number::<i8>(odometry.quality)
}

fn planar_from<S>(pose: Pose<S>) -> PlanarPoint {
    PlanarPoint { x: pose.x.0, y: pose.y.0, angle: pose.heading.rad() }
}

pub(super) fn estimator_status(payload: &[u8]) -> Decoded {
    let data: ESTIMATOR_STATUS_DATA = decode_generated(payload)?;
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

/// A position by dead reckoning is "relative" and not "absolute". There is no flag for "predicted".
pub(super) fn write_estimator_status(status: &EstimatorStatus) -> Payload {
    let valid = status.flags;
    let mut flags = EstimatorStatusFlags::empty();
    flags.set(EstimatorStatusFlags::ESTIMATOR_ATTITUDE, valid.heading_valid);
    flags.set(EstimatorStatusFlags::ESTIMATOR_VELOCITY_HORIZ, valid.speeds_valid);
    flags.set(EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_REL, valid.position_valid);
    flags.set(EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS, valid.position_valid && !valid.dead_reckoning);
    let data = ESTIMATOR_STATUS_DATA {
        time_usec: micros64(status.stamp),
        pos_horiz_ratio: status.position_ratio as f32,
        pos_horiz_accuracy: status.position_sigma.0 as f32,
        flags,
        ..ESTIMATOR_STATUS_DATA::DEFAULT
    };
    Payload::encode(&data)
}

pub(super) fn heading_from_yaw(yaw_rad: f64) -> Heading {
    let pose = PlanarPoint { x: 0.0, y: 0.0, angle: yaw_rad };
    Heading::from_rad(turn_ned(pose).angle)
}

pub(super) fn yaw_from_heading(heading: Heading) -> f64 {
    heading_from_yaw(heading.rad()).rad()
}

/// xx, xy, yy and heading variance in the arena from a north-east-down triangle.
fn fix_covariance(wire: &[f32; TRIANGLE_LEN]) -> Option<[f64; 4]> {
    let [xx, xy, _, yy, _, hh] = turn_ned_covariance(planar(wire)?);
    Some([xx, xy, yy, hh])
}

fn fix_triangle(covariance: Option<[f64; 4]>) -> [f32; TRIANGLE_LEN] {
    triangle(covariance.map(|[xx, xy, yy, hh]| turn_ned_covariance([xx, xy, 0.0, yy, 0.0, hh])))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use posebridge_telemetry::{Arena, Odom};

    /// Places of frame, reset counter, estimator type and quality in the payload of ODOMETRY, in wire order (common.xml).
    const FRAME: usize = 228;
    const ESTIMATOR: usize = 231;
    const QUALITY: usize = 232;

    /// The payload of a pose in the arena, with some of its bytes replaced.
    fn decoded(changes: &[(usize, u8)]) -> Result<Odometry, PayloadError> {
        let pose = Pose::<Arena>::new(Meters(1.0), Meters(2.0), Heading::from_rad(0.25));
        let payload = write_odometry(&Odometry {
            stamp: WireStamp::Micros64(7),
            pose: OdometryPose::Arena(pose),
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            covariance: None,
            reset_counter: 9,
            quality: 80,
        });
        let mut bytes = payload.bytes;
        for (offset, byte) in changes {
            bytes[*offset] = *byte;
        }
        match odometry(&bytes)? {
            Some(Message::Odometry(odometry)) => Ok(odometry),
            other => panic!("{other:?}"),
        }
    }

    /// x, y and heading, rounded to six digits, in the arena.
    fn in_arena(odometry: &Odometry) -> [f64; 3] {
        let OdometryPose::Arena(pose) = odometry.pose else {
            panic!("{:?}", odometry.pose);
        };
        [pose.x.0, pose.y.0, pose.heading.rad()].map(|value| (value * 1e6).round() / 1e6)
    }

    #[test]
    fn frames_of_trackers_that_are_reserved_today_are_the_arena() {
        // North 2, east 1 on the wire, clockwise from north.
        let yaw_rad = ((FRAC_PI_2 - 0.25) * 1e6).round() / 1e6;
        for frame in [1, 14, 16] {
            let odometry = decoded(&[(FRAME, frame)]).unwrap();
            assert_eq!(in_arena(&odometry), [1.0, 2.0, 0.25], "{frame}");
            assert_eq!((odometry.reset_counter, odometry.quality), (9, 80));
        }
        for frame in [4, 15, 17] {
            let odometry = decoded(&[(FRAME, frame)]).unwrap();
            assert_eq!(in_arena(&odometry), [2.0, 1.0, yaw_rad], "{frame}");
        }
    }

    #[test]
    fn an_outside_observers_floor_is_the_arena_and_others_drift() {
        let yaw_rad = ((0.25 - FRAC_PI_2) * 1e6).round() / 1e6;
        for estimator in [ESTIMATOR_VISION, ESTIMATOR_MOCAP] {
            let odometry = decoded(&[(FRAME, 20), (ESTIMATOR, estimator)]).unwrap();
            assert_eq!(in_arena(&odometry), [2.0, -1.0, yaw_rad], "{estimator}");
        }
        for estimator in [0, 3, 8] {
            let odometry = decoded(&[(FRAME, 20), (ESTIMATOR, estimator)]).unwrap();
            let OdometryPose::Odom(pose) = odometry.pose else {
                panic!("{odometry:?}");
            };
            let expected = Pose::<Odom>::new(Meters(2.0), Meters(-1.0), pose.heading);
            assert_eq!(pose, expected, "{estimator}");
        }
    }

    #[test]
    fn an_unusable_pose_is_refused_with_the_reason() {
        for (changes, expected) in
            [([(FRAME, 5)], "MAV_FRAME 5"), ([(FRAME, 18)], "MAV_FRAME 18"), ([(QUALITY, 0xFF)], "it has failed")]
        {
            let error = decoded(&changes).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert_eq!(decoded(&[(QUALITY, 0)]).unwrap().quality, 0);
    }
}
