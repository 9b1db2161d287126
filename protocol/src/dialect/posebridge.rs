//! The five messages of our own dialect; `definitions/posebridge.xml` defines their scalings.
//!
//! They use our coordinate frames and signs already.

use posebridge_telemetry::{
    EncoderTicks, Heading, Meters, MetersPerSecond, MetersPerSecondSquared, Pose, Radians, RadiansPerSecond, SensorId,
    TimeDelta,
};

use super::generated::posebridge::{
    PB_FUSION_HEALTH_DATA, PB_INERTIAL_DATA, PB_PLANAR_POSE_DATA, PB_ROBOT_DESCRIPTION_DATA, PB_WHEEL_TICKS_DATA,
};
use super::ids;
use super::payload::{Decoded, Payload, PayloadError, decode_generated, micros32, require_finite, text_from, text_to};
use crate::message::{FusionHealth, Inertial, Message, PlanarPose, PoseFlags, RobotDescription, WheelTicks, WireStamp};

const TURN_RATE_UNIT_RAD_PER_S: f64 = 0.5e-3;
/// Unit of PB_INERTIAL.turn_urad.
const TURN_UNIT_RAD: f64 = 1e-6;
/// Unit of PB_INERTIAL.accel_*.
const ACCELERATION_UNIT_M_PER_S2: f64 = 1e-3;
/// PB_PLANAR_POSE.fix_age_ms before the first fix.
const NO_FIX: u16 = u16::MAX;

const LEFT_VALID: u8 = 1 << 0;
const RIGHT_VALID: u8 = 1 << 1;

const TURN_RATE_VALID: u8 = 1 << 0;
const TURN_VALID: u8 = 1 << 1;
const ACCELERATIONS_VALID: u8 = 1 << 2;

const NANOS_PER_MILLI: i64 = 1_000_000;

pub(super) fn wheel_ticks(payload: &[u8]) -> Decoded {
    Ok(ticks_of(payload)?.map(Message::WheelTicks))
}

/// Both wheels' counts; `None` if the sender lacks one.
#[inline]
pub(super) fn ticks_of(payload: &[u8]) -> Result<Option<WheelTicks>, PayloadError> {
    let data: PB_WHEEL_TICKS_DATA = decode_generated(payload)?;
    let both = LEFT_VALID | RIGHT_VALID;
    if data.flags & both != both {
        return Ok(None);
    }
    Ok(Some(WheelTicks {
        stamp: WireStamp::Micros32(data.time_us),
        left: EncoderTicks(i64::from(data.left)),
        right: EncoderTicks(i64::from(data.right)),
    }))
}

pub(super) fn write_ticks(ticks: &WheelTicks) -> Payload {
    let data = PB_WHEEL_TICKS_DATA {
        time_us: micros32(ticks.stamp),
        left: ticks.left.0 as i32,
        right: ticks.right.0 as i32,
        flags: LEFT_VALID | RIGHT_VALID,
    };
    Payload::encode(&data)
}

pub(super) fn inertial(payload: &[u8]) -> Decoded {
    Ok(Some(Message::Inertial(inertial_of(payload)?)))
}

#[inline]
pub(super) fn inertial_of(payload: &[u8]) -> Result<Inertial, PayloadError> {
    let data: PB_INERTIAL_DATA = decode_generated(payload)?;
    let has = |flag: u8| data.valid & flag != 0;
    let acceleration = |raw: i16| MetersPerSecondSquared(f64::from(raw) * ACCELERATION_UNIT_M_PER_S2);
    Ok(Inertial {
        stamp: WireStamp::Micros32(data.time_us),
        turn_rate: has(TURN_RATE_VALID).then(|| RadiansPerSecond(f64::from(data.turn_rate) * TURN_RATE_UNIT_RAD_PER_S)),
        turn: has(TURN_VALID).then(|| Radians(f64::from(data.turn_urad) * TURN_UNIT_RAD)),
        wheel_accelerations: has(ACCELERATIONS_VALID)
            .then(|| (acceleration(data.accel_left), acceleration(data.accel_right))),
    })
}

pub(super) fn write_inertial(inertial: &Inertial) -> Payload {
    let mut data = PB_INERTIAL_DATA { time_us: micros32(inertial.stamp), ..PB_INERTIAL_DATA::DEFAULT };
    if let Some(turn_rate) = inertial.turn_rate {
        data.turn_rate = (turn_rate.0 / TURN_RATE_UNIT_RAD_PER_S).round() as i16;
        data.valid |= TURN_RATE_VALID;
    }
    if let Some(turn) = inertial.turn {
        // Through 64 bits, so that the total wraps instead of saturating.
        data.turn_urad = (turn.0 / TURN_UNIT_RAD).round() as i64 as i32;
        data.valid |= TURN_VALID;
    }
    if let Some((left, right)) = inertial.wheel_accelerations {
        data.accel_left = (left.0 / ACCELERATION_UNIT_M_PER_S2).round() as i16;
        data.accel_right = (right.0 / ACCELERATION_UNIT_M_PER_S2).round() as i16;
        data.valid |= ACCELERATIONS_VALID;
    }
    Payload::encode(&data)
}

pub(super) fn planar_pose(payload: &[u8]) -> Decoded {
    let data: PB_PLANAR_POSE_DATA = decode_generated(payload)?;
    let checked = |field, value: f32| require_finite(ids::PB_PLANAR_POSE, field, f64::from(value));
    Ok(Some(Message::PlanarPose(PlanarPose {
        stamp: WireStamp::Micros32(data.time_us),
        pose: Pose::new(
            Meters(checked("x", data.x)?),
            Meters(checked("y", data.y)?),
            Heading::from_rad(checked("heading", data.heading)?),
        ),
        forward_speed: MetersPerSecond(f64::from(data.forward_speed)),
        turn_rate: RadiansPerSecond(f64::from(data.turn_rate)),
        covariance: data.covariance.map(f64::from),
        fix_age: (data.fix_age_ms != NO_FIX).then(|| TimeDelta::from_millis(i64::from(data.fix_age_ms))),
        reset_counter: data.reset_counter,
        flags: flags_from_bits(data.flags),
        epoch: data.epoch,
    })))
}

pub(super) fn write_pose(pose: &PlanarPose) -> Payload {
    let fix_age_ms = pose.fix_age.map_or(NO_FIX, |age| {
        let millis = age.as_nanos() / NANOS_PER_MILLI;
        millis.clamp(0, i64::from(NO_FIX - 1)) as u16
    });
    let data = PB_PLANAR_POSE_DATA {
        time_us: micros32(pose.stamp),
        x: pose.pose.x.0 as f32,
        y: pose.pose.y.0 as f32,
        heading: pose.pose.heading.rad() as f32,
        forward_speed: pose.forward_speed.0 as f32,
        turn_rate: pose.turn_rate.0 as f32,
        covariance: pose.covariance.map(|element| element as f32),
        fix_age_ms,
        reset_counter: pose.reset_counter,
        flags: flags_to_bits(pose.flags),
        epoch: pose.epoch,
    };
    Payload::encode(&data)
}

fn flags_from_bits(bits: u8) -> PoseFlags {
    PoseFlags {
        position_valid: bits & (1 << 0) != 0,
        heading_valid: bits & (1 << 1) != 0,
        speeds_valid: bits & (1 << 2) != 0,
        dead_reckoning: bits & (1 << 3) != 0,
        predicted: bits & (1 << 4) != 0,
    }
}

fn flags_to_bits(flags: PoseFlags) -> u8 {
    u8::from(flags.position_valid)
        | u8::from(flags.heading_valid) << 1
        | u8::from(flags.speeds_valid) << 2
        | u8::from(flags.dead_reckoning) << 3
        | u8::from(flags.predicted) << 4
}

pub(super) fn fusion_health(payload: &[u8]) -> Decoded {
    let data: PB_FUSION_HEALTH_DATA = decode_generated(payload)?;
    Ok(Some(Message::FusionHealth(FusionHealth {
        stamp: WireStamp::Micros32(data.time_us),
        sensor: SensorId(data.sensor),
        verdict: data.verdict,
        nis_per_dof: f64::from(data.nis_per_dof),
        innovation: data.innovation.map(f64::from),
        lag: TimeDelta::from_millis(i64::from(data.lag_ms)),
        accepted: data.accepted,
        refused: data.refused,
    })))
}

pub(super) fn write_health(health: &FusionHealth) -> Payload {
    let lag_ms = health.lag.as_nanos() / NANOS_PER_MILLI;
    let data = PB_FUSION_HEALTH_DATA {
        time_us: micros32(health.stamp),
        innovation: health.innovation.map(|component| component as f32),
        nis_per_dof: health.nis_per_dof as f32,
        lag_ms: lag_ms.clamp(0, i64::from(u16::MAX)) as u16,
        accepted: health.accepted,
        refused: health.refused,
        sensor: health.sensor.0,
        verdict: health.verdict,
    };
    Payload::encode(&data)
}

pub(super) fn robot_description(payload: &[u8]) -> Decoded {
    let data: PB_ROBOT_DESCRIPTION_DATA = decode_generated(payload)?;
    let checked = |field, value: f32| require_finite(ids::PB_ROBOT_DESCRIPTION, field, f64::from(value));
    Ok(Some(Message::RobotDescription(RobotDescription {
        name: text_from(&*data.name),
        left_wheel_radius: Meters(checked("left_wheel_radius", data.left_wheel_radius)?),
        right_wheel_radius: Meters(checked("right_wheel_radius", data.right_wheel_radius)?),
        track_width: Meters(checked("track_width", data.track_width)?),
        ticks_per_turn: checked("ticks_per_turn", data.ticks_per_turn)?,
        gyro_sigma: RadiansPerSecond(checked("gyro_sigma", data.gyro_sigma)?),
        gyro_resolution: RadiansPerSecond(checked("gyro_resolution", data.gyro_resolution)?),
    })))
}

pub(super) fn write_robot(robot: &RobotDescription) -> Payload {
    let data = PB_ROBOT_DESCRIPTION_DATA {
        left_wheel_radius: robot.left_wheel_radius.0 as f32,
        right_wheel_radius: robot.right_wheel_radius.0 as f32,
        track_width: robot.track_width.0 as f32,
        ticks_per_turn: robot.ticks_per_turn as f32,
        gyro_sigma: robot.gyro_sigma.0 as f32,
        gyro_resolution: robot.gyro_resolution.0 as f32,
        name: text_to::<16>(&robot.name).into(),
    };
    Payload::encode(&data)
}
