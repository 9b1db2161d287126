//! Standard messages about a vehicle as ground stations show and steer it. Source: MAVLink common.xml.

use posebridge_telemetry::{GeodeticPoint, Heading, Meters, MetersPerSecond, RadiansPerSecond, SystemId};

use super::frames::{frame, negate, quaternion, yaw};
use super::ids;
use super::payload::{Decoded, Payload, PayloadReader, micros64, millis32, require_finite};
use super::poses::{MILLIMETER_M, geodetic_point, heading_from_yaw, latitude_e7, longitude_e7, yaw_from_heading};
use crate::message::{
    AttitudeQuaternion, Battery, GlobalPosition, GlobalReference, HeadUpDisplay, ManualControl, Message,
    PositionTarget, SetGlobalOrigin, Setpoint, SystemStatus, WireStamp,
};

const CENTIMETER_PER_S: f64 = 1e-2;
/// GLOBAL_POSITION_INT.hdg when the sender does not know it.
const HEADING_UNKNOWN: u16 = u16::MAX;
const MILLIVOLT_V: f64 = 1e-3;
const CENTIAMPERE_A: f64 = 1e-2;
/// SYS_STATUS.voltage_battery and BATTERY_STATUS.voltages when the sender does not know them.
const VOLTAGE_UNKNOWN: u16 = u16::MAX;
/// Currents and remaining shares that the sender does not know.
const UNKNOWN: i8 = -1;
/// BATTERY_STATUS.temperature when the sender does not know it.
const TEMPERATURE_UNKNOWN: i16 = i16::MAX;
/// Cells of BATTERY_STATUS.voltages and of its extension, voltages_ext.
const CELLS: usize = 10;
const EXTENSION_CELLS: usize = 4;
/// BATTERY_STATUS.id.
const FIRST_BATTERY: u8 = 0;
/// MAV_BATTERY_FUNCTION_ALL and MAV_BATTERY_TYPE_UNKNOWN.
const BATTERY_FOR_ALL: u8 = 1;
const BATTERY_TYPE_UNKNOWN: u8 = 0;
/// MAV_VTOL_STATE_UNDEFINED and MAV_LANDED_STATE_ON_GROUND.
const NO_VTOL: u8 = 0;
const ON_GROUND: u8 = 1;
/// MANUAL_CONTROL: an axis runs from -1000 to 1000, and this is one that the sender does not have.
const FULL_STICK: f64 = 1_000.0;
const NO_AXIS: i16 = i16::MAX;
/// POSITION_TARGET_TYPEMASK: a bit that is set is a field that is not used.
const IGNORED_POSITION: u16 = 0b11;
const IGNORED_FORWARD_SPEED: u16 = 1 << 3;
const IGNORED_YAW_RATE: u16 = 1 << 11;

pub(super) fn global_position(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Millis32(reader.number::<u32>());
    let position = read_point(&mut reader);
    let altitude = Meters(f64::from(reader.number::<i32>()) * MILLIMETER_M);
    reader.skip::<4>();
    let [north, east, _down]: [i16; 3] = std::array::from_fn(|_| reader.number());
    let heading_cdeg = reader.number::<u16>();
    let speed = |value| MetersPerSecond(f64::from(value) * CENTIMETER_PER_S);
    Message::GlobalPosition(GlobalPosition {
        stamp,
        position,
        altitude,
        east_speed: speed(east),
        north_speed: speed(north),
        heading: (heading_cdeg != HEADING_UNKNOWN).then(|| from_compass(i32::from(heading_cdeg), 100)),
    })
}

pub(super) fn write_global_position(message: &GlobalPosition) -> Payload {
    let speed = |speed: MetersPerSecond| (speed.0 / CENTIMETER_PER_S).round() as i16;
    let (height_mm, down) = (0, 0);
    let heading = message.heading.map_or(HEADING_UNKNOWN, |heading| compass(heading, 100) as u16);
    write_point(Payload::new(ids::GLOBAL_POSITION_INT).number(millis32(message.stamp)), message.position)
        .number::<i32>(millimeters(message.altitude))
        .number::<i32>(height_mm)
        .number::<i16>(speed(message.north_speed))
        .number::<i16>(speed(message.east_speed))
        .number::<i16>(down)
        .number::<u16>(heading)
}

pub(super) fn home_position(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let (position, altitude) = read_place(&mut reader);
    // Local position, quaternion, approach.
    reader.skip::<{ 10 * 4 }>();
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    Message::HomePosition(GlobalReference { stamp, position, altitude })
}

/// Home is the arena's origin, seen from its own ground.
pub(super) fn write_home_position(home: &GlobalReference) -> Payload {
    write_place(Payload::new(ids::HOME_POSITION), home.position, home.altitude)
        .f32s(&[0.0; 3])
        .f32s(&[1.0, 0.0, 0.0, 0.0])
        .f32s(&[0.0; 3])
        .number::<u64>(micros64(home.stamp))
}

pub(super) fn global_origin(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let (position, altitude) = read_place(&mut reader);
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    Message::GlobalOrigin(GlobalReference { stamp, position, altitude })
}

pub(super) fn write_global_origin(origin: &GlobalReference) -> Payload {
    write_place(Payload::new(ids::GPS_GLOBAL_ORIGIN), origin.position, origin.altitude)
        .number::<u64>(micros64(origin.stamp))
}

pub(super) fn set_global_origin(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let (position, altitude) = read_place(&mut reader);
    let system = SystemId(reader.number::<u8>());
    Message::SetGlobalOrigin(SetGlobalOrigin { system, position, altitude })
}

pub(super) fn write_set_global_origin(request: &SetGlobalOrigin) -> Payload {
    write_place(Payload::new(ids::SET_GPS_GLOBAL_ORIGIN), request.position, request.altitude)
        .number::<u8>(request.system.0)
}

pub(super) fn head_up_display(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    let [_air_speed, ground_speed, altitude, _climb] = reader.f32s();
    let heading_deg = reader.number::<i16>();
    let checked = |field, value| require_finite(ids::VFR_HUD, field, f64::from(value));
    Ok(Some(Message::HeadUpDisplay(HeadUpDisplay {
        ground_speed: MetersPerSecond(checked("groundspeed", ground_speed)?),
        heading: from_compass(i32::from(heading_deg), 1),
        altitude: Meters(checked("alt", altitude)?),
    })))
}

pub(super) fn write_head_up_display(message: &HeadUpDisplay) -> Payload {
    let speed = message.ground_speed.0 as f32;
    let (climb, throttle) = (0.0, 0);
    Payload::new(ids::VFR_HUD)
        .f32s(&[speed, speed, message.altitude.0 as f32, climb])
        .number::<i16>(compass(message.heading, 1) as i16)
        .number::<u16>(throttle)
}

pub(super) fn attitude_quaternion(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Millis32(reader.number::<u32>());
    let attitude: [f32; 4] = reader.f32s();
    let [_roll_rate, _pitch_rate, yaw_rate] = reader.f32s();
    let yaw_rad = require_finite(ids::ATTITUDE_QUATERNION, "q", yaw(attitude).unwrap_or(f64::NAN))?;
    Ok(Some(Message::AttitudeQuaternion(AttitudeQuaternion {
        stamp,
        heading: heading_from_yaw(yaw_rad),
        turn_rate: RadiansPerSecond(negate(f64::from(yaw_rate))),
    })))
}

pub(super) fn write_attitude_quaternion(message: &AttitudeQuaternion) -> Payload {
    Payload::new(ids::ATTITUDE_QUATERNION)
        .number::<u32>(millis32(message.stamp))
        .f32s(&quaternion(yaw_from_heading(message.heading)))
        .f32s(&[0.0, 0.0, negate(message.turn_rate.0) as f32])
}

pub(super) fn system_status(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let [sensors_present, _enabled, sensors_healthy]: [u32; 3] = std::array::from_fn(|_| reader.number());
    let _load = reader.number::<u16>();
    let voltage_mv = reader.number::<u16>();
    let current_ca = reader.number::<i16>();
    // Errors of its links.
    reader.skip::<{ 6 * 2 }>();
    let remaining_percent = reader.number::<i8>();
    let battery = Battery {
        voltage_v: (voltage_mv != VOLTAGE_UNKNOWN).then(|| f64::from(voltage_mv) * MILLIVOLT_V),
        current_a: current_of(current_ca),
        remaining: remaining_of(remaining_percent),
    };
    Message::SystemStatus(SystemStatus { sensors_present, sensors_healthy, battery })
}

pub(super) fn write_system_status(status: &SystemStatus) -> Payload {
    let (load, errors) = (0, 0);
    let payload = Payload::new(ids::SYS_STATUS)
        .number::<u32>(status.sensors_present)
        .number::<u32>(status.sensors_present)
        .number::<u32>(status.sensors_healthy)
        .number::<u16>(load)
        .number::<u16>(millivolts(&status.battery))
        .number::<i16>(centiamperes(&status.battery));
    let payload = [errors; 6].into_iter().fold(payload, Payload::number::<u16>);
    payload.number::<i8>(percent(&status.battery))
}

/// The first battery; its cells in series are one voltage. `None` for a further one: it would take turns with the first.
pub(super) fn battery_status(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    // Charge and energy drawn, temperature.
    reader.skip::<10>();
    let cells: [u16; CELLS] = std::array::from_fn(|_| reader.number());
    let current_ca = reader.number::<i16>();
    let [id, _function, _type] = reader.bytes();
    let remaining_percent = reader.number::<i8>();
    // Time remaining, state of charge.
    reader.skip::<5>();
    let extension: [u16; EXTENSION_CELLS] = std::array::from_fn(|_| reader.number());
    let known = cells.iter().take_while(|cell| **cell != VOLTAGE_UNKNOWN);
    // Unknown cells of the extension are 0.
    let voltage_mv: u32 = known.clone().chain(&extension).map(|cell| u32::from(*cell)).sum();
    (id == FIRST_BATTERY).then(|| {
        Message::BatteryStatus(Battery {
            voltage_v: known.clone().next().map(|_| f64::from(voltage_mv) * MILLIVOLT_V),
            current_a: current_of(current_ca),
            remaining: remaining_of(remaining_percent),
        })
    })
}

/// A voltage that does not fit into one cell goes on in the next, as the definition asks.
pub(super) fn write_battery_status(battery: &Battery) -> Payload {
    let drawn = i32::from(UNKNOWN);
    let payload =
        Payload::new(ids::BATTERY_STATUS).number::<i32>(drawn).number::<i32>(drawn).number::<i16>(TEMPERATURE_UNKNOWN);
    let mut rest_mv = battery.voltage_v.map(|volts| (volts / MILLIVOLT_V).round() as u32);
    let payload = (0..CELLS).fold(payload, |payload, _| {
        let cell_mv = rest_mv.map_or(VOLTAGE_UNKNOWN, |rest| rest.min(u32::from(VOLTAGE_UNKNOWN) - 1) as u16);
        rest_mv = rest_mv.map(|rest| rest - u32::from(cell_mv)).filter(|rest| *rest > 0);
        payload.number::<u16>(cell_mv)
    });
    payload
        .number::<i16>(centiamperes(battery))
        .number::<u8>(FIRST_BATTERY)
        .number::<u8>(BATTERY_FOR_ALL)
        .number::<u8>(BATTERY_TYPE_UNKNOWN)
        .number::<i8>(percent(battery))
}

/// EXTENDED_SYS_STATE of a vehicle that does not fly.
pub(super) fn write_on_ground() -> Payload {
    Payload::new(ids::EXTENDED_SYS_STATE).number::<u8>(NO_VTOL).number::<u8>(ON_GROUND)
}

/// `None` for a vehicle that flies, which no robot here does.
pub(super) fn on_ground(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    let [_vtol, landed] = reader.bytes();
    (landed == ON_GROUND).then_some(Message::OnGround)
}

pub(super) fn manual_control(payload: &[u8]) -> Message {
    let mut reader = PayloadReader::new(payload);
    let [forward, _right, _up, clockwise]: [i16; 4] = std::array::from_fn(|_| reader.number());
    let _buttons = reader.number::<u16>();
    let axis = |value: i16| (value != NO_AXIS).then(|| (f64::from(value) / FULL_STICK).clamp(-1.0, 1.0));
    Message::ManualControl(ManualControl {
        system: SystemId(reader.number::<u8>()),
        forward: axis(forward),
        turn: axis(clockwise).map(negate),
    })
}

pub(super) fn write_manual_control(control: &ManualControl) -> Payload {
    let axis = |value: Option<f64>| value.map_or(NO_AXIS, |value| (value * FULL_STICK).round() as i16);
    let (no_axis, buttons) = (NO_AXIS, 0);
    Payload::new(ids::MANUAL_CONTROL)
        .number::<i16>(axis(control.forward))
        .number::<i16>(no_axis)
        .number::<i16>(no_axis)
        .number::<i16>(axis(control.turn.map(negate)))
        .number::<u16>(buttons)
        .number::<u8>(control.system.0)
}

pub(super) fn position_target(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    reader.skip::<4>();
    let [north, east, _down] = reader.f32s();
    let [forward, _right, _below] = reader.f32s();
    reader.skip::<{ 4 * 4 }>();
    let yaw_rate: f32 = reader.number();
    let ignored = reader.number::<u16>();
    let target = reader.address();
    let frame = reader.number::<u8>();
    let checked = |field, value| require_finite(ids::SET_POSITION_TARGET_LOCAL_NED, field, f64::from(value));
    let is_of_body = matches!(frame, frame::BODY_NED | frame::BODY_FRD);
    let setpoint = if frame == frame::LOCAL_NED && ignored & IGNORED_POSITION == 0 {
        Setpoint::Position { x: Meters(checked("y", east)?), y: Meters(checked("x", north)?) }
    } else if is_of_body && ignored & IGNORED_FORWARD_SPEED == 0 {
        let turn = if ignored & IGNORED_YAW_RATE == 0 { negate(checked("yaw_rate", yaw_rate)?) } else { 0.0 };
        Setpoint::BodyVelocity { forward: MetersPerSecond(checked("vx", forward)?), turn: RadiansPerSecond(turn) }
    } else {
        Setpoint::Unsupported
    };
    Ok(Some(Message::PositionTarget(PositionTarget { target, setpoint })))
}

pub(super) fn write_position_target(request: &PositionTarget) -> Payload {
    const ALL_IGNORED: u16 = 0x0FFF;
    let (position, forward, yaw_rate, ignored, frame) = match request.setpoint {
        Setpoint::Position { x, y } => {
            ([y.0 as f32, x.0 as f32], 0.0, 0.0, ALL_IGNORED & !IGNORED_POSITION, frame::LOCAL_NED)
        }
        Setpoint::BodyVelocity { forward, turn } => {
            let used = IGNORED_FORWARD_SPEED | IGNORED_YAW_RATE;
            ([0.0; 2], forward.0 as f32, negate(turn.0) as f32, ALL_IGNORED & !used, frame::BODY_FRD)
        }
        Setpoint::Unsupported => ([0.0; 2], 0.0, 0.0, ALL_IGNORED, frame::LOCAL_NED),
    };
    let time_ms = 0;
    Payload::new(ids::SET_POSITION_TARGET_LOCAL_NED)
        .number::<u32>(time_ms)
        .f32s(&position)
        .f32s(&[0.0, forward, 0.0, 0.0])
        .f32s(&[0.0; 4])
        .f32s(&[yaw_rate])
        .number::<u16>(ignored)
        .address(request.target)
        .number::<u8>(frame)
}

fn read_point(reader: &mut PayloadReader<'_>) -> GeodeticPoint {
    let [latitude, longitude]: [i32; 2] = std::array::from_fn(|_| reader.number());
    geodetic_point(latitude, longitude)
}

fn write_point(payload: Payload, point: GeodeticPoint) -> Payload {
    payload.number::<i32>(latitude_e7(point)).number::<i32>(longitude_e7(point))
}

fn read_place(reader: &mut PayloadReader<'_>) -> (GeodeticPoint, Meters) {
    let point = read_point(reader);
    (point, Meters(f64::from(reader.number::<i32>()) * MILLIMETER_M))
}

fn write_place(payload: Payload, point: GeodeticPoint, altitude: Meters) -> Payload {
    write_point(payload, point).number::<i32>(millimeters(altitude))
}

fn millimeters(length: Meters) -> i32 {
    (length.0 / MILLIMETER_M).round() as i32
}

/// Clockwise from north, from 0 to a whole turn, in parts of a degree.
fn compass(heading: Heading, parts_of_degree: i32) -> i32 {
    let parts = (yaw_from_heading(heading).to_degrees() * f64::from(parts_of_degree)).round();
    (parts as i32).rem_euclid(360 * parts_of_degree)
}

fn from_compass(parts: i32, parts_of_degree: i32) -> Heading {
    // Whole turns are taken off first, so that one direction is one number.
    let parts = parts.rem_euclid(360 * parts_of_degree);
    heading_from_yaw((f64::from(parts) / f64::from(parts_of_degree)).to_radians())
}

fn current_of(centiamperes: i16) -> Option<f64> {
    (centiamperes != i16::from(UNKNOWN)).then(|| f64::from(centiamperes) * CENTIAMPERE_A)
}

fn remaining_of(percent: i8) -> Option<f64> {
    (0..=100).contains(&percent).then(|| f64::from(percent) / 100.0)
}

fn millivolts(battery: &Battery) -> u16 {
    battery.voltage_v.map_or(VOLTAGE_UNKNOWN, |volts| ((volts / MILLIVOLT_V).round() as u16).min(VOLTAGE_UNKNOWN - 1))
}

/// -1 means that the current is unknown; the known one next to it is none.
fn centiamperes(battery: &Battery) -> i16 {
    let known = battery.current_a.map(|amperes| (amperes / CENTIAMPERE_A).round() as i16);
    known.map_or(i16::from(UNKNOWN), |known| if known == i16::from(UNKNOWN) { 0 } else { known })
}

fn percent(battery: &Battery) -> i8 {
    battery.remaining.map_or(UNKNOWN, |share| (share.clamp(0.0, 1.0) * 100.0).round() as i8)
}
