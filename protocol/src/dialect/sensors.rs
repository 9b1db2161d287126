//! Standard messages of sensors: wheels, inertial units, range finders, thermometers.
//!
//! Body rates are forward-right-down on the wire and change their sign here. Source: MAVLink common.xml.

use mavlink::dialects::common::{HIGHRES_IMU_DATA, HighresImuUpdatedFlags, SCALED_IMU_DATA, WHEEL_DISTANCE_DATA};
use posebridge_telemetry::{Celsius, ChannelName, Meters, MetersPerSecondSquared, RadiansPerSecond};

use super::frames::negate;
use super::ids;
use super::payload::{
    Decoded, Payload, PayloadError, PayloadReader, decode_generated, micros64, millis32, require_finite,
};
use super::services::{NAME_BYTES, write_named_value};
use crate::message::{ImuMessage, Message, NamedValue, PlanarImu, SCALED_PRESSURE_CHANNEL, WireStamp};

/// Unit of SCALED_IMU.xacc, a thousandth of the standard gravity (CGPM 1901).
const MILLI_GRAVITY_M_PER_S2: f64 = 9.806_65e-3;
/// Unit of SCALED_IMU.zgyro.
const MILLI_RAD_PER_S: f64 = 1e-3;
/// Unit of RPM: turns per minute.
const RPM_RAD_PER_S: f64 = std::f64::consts::TAU / 60.0;
/// RPM.rpm1 and rpm2 of a sensor that is missing or not healthy (ArduPilot, `GCS_MAVLINK::send_rpm`).
const RPM_UNKNOWN: f32 = -1.0;
/// RAW_IMU.id and HIGHRES_IMU.id of the first unit, also where the extension is missing.
const FIRST_UNIT: u8 = 0;
/// Unit of DISTANCE_SENSOR's distances.
const CENTIMETER_M: f64 = 1e-2;
/// MAV_SENSOR_ROTATION_NONE: looks forward.
const ORIENTATION_FORWARD: u8 = 0;
/// DISTANCE_SENSOR.covariance when the sender does not know it.
const VARIANCE_UNKNOWN: u8 = u8::MAX;
/// DISTANCE_SENSOR.signal_quality of a reading that must not be used.
const QUALITY_INVALID: u8 = 1;
/// Unit of SCALED_PRESSURE.temperature.
const CENTIDEGREE_C: f64 = 1e-2;
/// A named value whose name begins so is a temperature in degrees Celsius; the message's definition leaves the meaning
/// to its sender.
const TEMPERATURE_NAME: &[u8] = b"temp";
/// Absolute zero (SI brochure, section 2.3.1).
const MIN_TEMPERATURE_C: f64 = -273.15;
/// Above the melting point of tungsten (3422 degrees), beyond any contact thermometer.
const MAX_TEMPERATURE_C: f64 = 3_500.0;
/// MAV_DISTANCE_SENSOR_UNKNOWN.
const RANGER_UNKNOWN: u8 = 4;

pub(super) fn wheel_distance(payload: &[u8]) -> Decoded {
    let data: WHEEL_DISTANCE_DATA = decode_generated(payload)?;
    let [left, right, ..] = data.distance;
    if data.count < 2 {
        return Err(PayloadError::TooFewWheels { message_id: ids::WHEEL_DISTANCE, count: data.count });
    }
    let checked = |value| require_finite(ids::WHEEL_DISTANCE, "distance", value);
    Ok(Some(Message::WheelDistance {
        stamp: WireStamp::Micros64(data.time_usec),
        left: Meters(checked(left)?),
        right: Meters(checked(right)?),
    }))
}

pub(super) fn write_wheel_distance(stamp: WireStamp, left: Meters, right: Meters) -> Payload {
    let mut distance = [0.0; 16];
    (distance[0], distance[1]) = (left.0, right.0);
    Payload::encode(&WHEEL_DISTANCE_DATA { time_usec: micros64(stamp), distance, count: 2 })
}

/// SCALED_IMU, SCALED_IMU2 and SCALED_IMU3 have the same fields.
pub(super) fn scaled_imu(message: ImuMessage, payload: &[u8]) -> Decoded {
    let data: SCALED_IMU_DATA = decode_generated(payload)?;
    let stamp = WireStamp::Millis32(data.time_boot_ms);
    Ok(Some(Message::Imu(imu_in_thousandths(message, stamp, data.xacc, data.zgyro))))
}

/// Of the first unit: the same turn, measured by several, must not count several times.
pub(super) fn raw_imu(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Micros64(reader.number::<u64>());
    let [x_acceleration, _, _, _, _, z_rate]: [i16; 6] = std::array::from_fn(|_| reader.number());
    // The magnetometer.
    reader.skip::<6>();
    let unit = reader.number::<u8>();
    (unit == FIRST_UNIT).then(|| Message::Imu(imu_in_thousandths(ImuMessage::Raw, stamp, x_acceleration, z_rate)))
}

fn imu_in_thousandths(message: ImuMessage, stamp: WireStamp, x_acceleration: i16, z_rate: i16) -> PlanarImu {
    PlanarImu {
        message,
        stamp,
        turn_rate: Some(RadiansPerSecond(negate(f64::from(z_rate)) * MILLI_RAD_PER_S)),
        forward_acceleration: Some(MetersPerSecondSquared(f64::from(x_acceleration) * MILLI_GRAVITY_M_PER_S2)),
    }
}

pub(super) fn write_imu(imu: &PlanarImu) -> Payload {
    let message_id = match imu.message {
        ImuMessage::Highres => return write_highres(imu),
        ImuMessage::Raw => return write_in_thousandths(Payload::new(ids::RAW_IMU).number(micros64(imu.stamp)), imu),
        ImuMessage::Scaled => ids::SCALED_IMU,
        ImuMessage::Scaled2 => ids::SCALED_IMU2,
        ImuMessage::Scaled3 => ids::SCALED_IMU3,
    };
    write_in_thousandths(Payload::new(message_id).number(millis32(imu.stamp)), imu)
}

/// These messages have no value for "missing": zero is written.
fn write_in_thousandths(stamped: Payload, imu: &PlanarImu) -> Payload {
    let acceleration = imu.forward_acceleration.unwrap_or_default().0 / MILLI_GRAVITY_M_PER_S2;
    let turn_rate = negate(imu.turn_rate.unwrap_or_default().0) / MILLI_RAD_PER_S;
    let [x_acceleration, z_rate] = [acceleration, turn_rate].map(|value| value.round() as i16);
    [x_acceleration, 0, 0, 0, 0, z_rate].into_iter().fold(stamped, Payload::number::<i16>)
}

/// `None` while one of the two sensors is missing. The left speed is the first one, as in WHEEL_DISTANCE.
pub(super) fn wheel_speeds(payload: &[u8]) -> Decoded {
    let [left, right] = PayloadReader::new(payload).f32s();
    if [left, right].contains(&RPM_UNKNOWN) {
        return Ok(None);
    }
    let checked = |value| require_finite(ids::RPM, "rpm", f64::from(value));
    Ok(Some(Message::WheelSpeeds {
        left: RadiansPerSecond(checked(left)? * RPM_RAD_PER_S),
        right: RadiansPerSecond(checked(right)? * RPM_RAD_PER_S),
    }))
}

pub(super) fn write_wheel_speeds(left: RadiansPerSecond, right: RadiansPerSecond) -> Payload {
    Payload::new(ids::RPM).f32s(&[left, right].map(|speed| (speed.0 / RPM_RAD_PER_S) as f32))
}

/// Of the first unit, as [`raw_imu`].
pub(super) fn highres_imu(payload: &[u8]) -> Decoded {
    let data: HIGHRES_IMU_DATA = decode_generated(payload)?;
    if data.id != FIRST_UNIT {
        return Ok(None);
    }
    let has = |field| data.fields_updated.contains(field);
    let has_turn_rate = has(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZGYRO);
    let has_acceleration = has(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XACC);
    Ok(Some(Message::Imu(PlanarImu {
        message: ImuMessage::Highres,
        stamp: WireStamp::Micros64(data.time_usec),
        turn_rate: has_turn_rate.then(|| RadiansPerSecond(negate(f64::from(data.zgyro)))),
        forward_acceleration: has_acceleration.then(|| MetersPerSecondSquared(f64::from(data.xacc))),
    })))
}

fn write_highres(imu: &PlanarImu) -> Payload {
    // Not the generated default: that is the first flag, not the empty set.
    let mut fields_updated = HighresImuUpdatedFlags::empty();
    fields_updated.set(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZGYRO, imu.turn_rate.is_some());
    fields_updated.set(HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XACC, imu.forward_acceleration.is_some());
    let data = HIGHRES_IMU_DATA {
        time_usec: micros64(imu.stamp),
        xacc: imu.forward_acceleration.unwrap_or_default().0 as f32,
        zgyro: negate(imu.turn_rate.unwrap_or_default().0) as f32,
        fields_updated,
        ..HIGHRES_IMU_DATA::DEFAULT
    };
    Payload::encode(&data)
}

/// Forward-looking ranges inside the sensor's own limits; others are not used.
pub(super) fn distance_sensor(payload: &[u8]) -> Option<Message> {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Millis32(reader.number::<u32>());
    let min_cm = reader.number::<u16>();
    let max_cm = reader.number::<u16>();
    let current_cm = reader.number::<u16>();
    let (_kind, _id) = (reader.number::<u8>(), reader.number::<u8>());
    let orientation = reader.number::<u8>();
    let variance_cm2 = reader.number::<u8>();
    // Extensions: two fields of view and a quaternion for a custom orientation, then the quality.
    reader.skip::<24>();
    let quality = reader.number::<u8>();
    let is_in_range = current_cm >= min_cm && (current_cm < max_cm || max_cm == 0);
    if orientation != ORIENTATION_FORWARD || quality == QUALITY_INVALID || !is_in_range {
        return None;
    }
    Some(Message::DistanceSensor {
        stamp,
        range: Meters(f64::from(current_cm) * CENTIMETER_M),
        sigma: (variance_cm2 != VARIANCE_UNKNOWN).then(|| Meters(f64::from(variance_cm2).sqrt() * CENTIMETER_M)),
    })
}

pub(super) fn write_distance(stamp: WireStamp, range: Meters, sigma: Option<Meters>) -> Payload {
    let variance_cm2 = sigma.map_or(VARIANCE_UNKNOWN, |sigma| {
        let variance = (sigma.0 / CENTIMETER_M).powi(2).round();
        variance.clamp(0.0, f64::from(VARIANCE_UNKNOWN - 1)) as u8
    });
    let (min_cm, max_cm) = (0, u16::MAX);
    // One below the limit: a range at the limit means that nothing was seen.
    let current_cm = ((range.0 / CENTIMETER_M).round() as u16).min(max_cm - 1);
    let id = 0;
    Payload::new(ids::DISTANCE_SENSOR)
        .number::<u32>(millis32(stamp))
        .number::<u16>(min_cm)
        .number::<u16>(max_cm)
        .number::<u16>(current_cm)
        .number::<u8>(RANGER_UNKNOWN)
        .number::<u8>(id)
        .number::<u8>(ORIENTATION_FORWARD)
        .number::<u8>(variance_cm2)
}

/// Only the temperature; the pressures are not used.
pub(super) fn scaled_pressure(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Millis32(reader.number::<u32>());
    reader.skip::<8>();
    let temperature_cdeg_c = reader.number::<i16>();
    Ok(Some(Message::Thermometer {
        stamp,
        channel: ChannelName::from_bytes(SCALED_PRESSURE_CHANNEL),
        temperature: check_temperature(ids::SCALED_PRESSURE, f64::from(temperature_cdeg_c) * CENTIDEGREE_C)?,
    }))
}

/// Only named values whose names mark them as temperatures are used.
pub(super) fn named_value(payload: &[u8]) -> Decoded {
    let mut reader = PayloadReader::new(payload);
    let stamp = WireStamp::Millis32(reader.number::<u32>());
    let value = reader.number::<f32>();
    let name = reader.bytes::<NAME_BYTES>();
    let channel = ChannelName::from_bytes(&name);
    if !name.starts_with(TEMPERATURE_NAME) {
        return Ok(Some(Message::NamedValue(NamedValue { stamp, name: channel, value })));
    }
    let degrees_c = require_finite(ids::NAMED_VALUE_FLOAT, "value", f64::from(value))?;
    Ok(Some(Message::Thermometer {
        stamp,
        channel,
        temperature: check_temperature(ids::NAMED_VALUE_FLOAT, degrees_c)?,
    }))
}

fn check_temperature(message_id: u32, degrees_c: f64) -> Result<Celsius, PayloadError> {
    if (MIN_TEMPERATURE_C..=MAX_TEMPERATURE_C).contains(&degrees_c) {
        Ok(Celsius(degrees_c))
    } else {
        Err(PayloadError::Temperature { message_id, degrees_c })
    }
}

pub(super) fn write_thermometer(stamp: WireStamp, channel: &ChannelName, temperature: Celsius) -> Payload {
    if channel.as_str().as_bytes() == SCALED_PRESSURE_CHANNEL {
        let (absolute_hpa, differential_hpa) = (0.0, 0.0);
        Payload::new(ids::SCALED_PRESSURE)
            .number::<u32>(millis32(stamp))
            .f32s(&[absolute_hpa, differential_hpa])
            .number::<i16>((temperature.0 / CENTIDEGREE_C).round() as i16)
    } else {
        write_named_value(&NamedValue { stamp, name: *channel, value: temperature.0 as f32 })
    }
}
