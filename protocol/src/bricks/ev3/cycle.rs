//! One cycle: the request that reads clock, motors and sensors, and the values of its reply; and those of the battery.
//!
//! The clock is read first, microseconds before the rest: the firmware runs the bytecodes of a telegram without a break.

use posebridge_telemetry::{EncoderTicks, Radians, RadiansPerSecond, TimeDelta};

use super::sensors::{CycleSensors, MAX_SENSORS, SensorBank, SensorRole, TurnAccumulator};
use super::settings::{Ev3Settings, GyroMounting, GyroReading, GyroSettings, MotorDirection};
use super::telegrams::DirectCommand;
use crate::bricks::battery::plausible_battery;
use crate::message::{Battery, Inertial, Message, WheelTicks, WireStamp};

const VALUE_BYTES: usize = 4;
/// Largest rate of LEGO's gyros (EV3: 440 degrees per second) with a factor of two; more is damage.
const MAX_DEG_PER_S: f64 = 880.0;
/// The gyro's angle has 16 bits.
const MAX_DEG: f64 = 32_768.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CycleValues {
    pub(super) micros: u32,
    pub(super) counts: [i32; 2],
    /// Two values of each sensor; NaN where there is none.
    pub(super) sensors: [[f64; 2]; MAX_SENSORS],
}

impl CycleValues {
    pub(super) const fn stamp(&self) -> WireStamp {
        WireStamp::Micros32(self.micros)
    }
}

pub(super) fn encode_request(settings: &Ev3Settings, sensors: &SensorBank) -> (DirectCommand, CycleSensors) {
    let mut command = DirectCommand::default();
    command.read_clock();
    command.read_count(settings.left_motor);
    command.read_count(settings.right_motor);
    let included = sensors.write_reading(&mut command);
    (command, included)
}

pub(super) fn decode_reply(answer: &[u8], included: CycleSensors) -> Option<CycleValues> {
    let mut values = answer.as_chunks::<VALUE_BYTES>().0.iter().copied();
    let micros = u32::from_le_bytes(values.next()?);
    let counts = [i32::from_le_bytes(values.next()?), i32::from_le_bytes(values.next()?)];
    let mut sensors = [[f64::NAN; 2]; MAX_SENSORS];
    for (slots, role) in sensors.iter_mut().zip(included.0) {
        let count = role.map_or(0, SensorRole::value_count);
        for slot in slots.iter_mut().take(usize::from(count)) {
            *slot = f64::from(f32::from_le_bytes(values.next()?));
        }
    }
    Some(CycleValues { micros, counts, sensors })
}

/// Largest current, A: four stalled large motors draw 1.8 each at 9 V (Philohome).
const MAX_CURRENT_A: f32 = 10.0;

/// Volts and amperes as f32, per cent in a byte. `None` if the voltage is none of a battery.
pub(super) fn decode_battery(answer: &[u8]) -> Option<Battery> {
    let (numbers, rest) = answer.as_chunks::<VALUE_BYTES>();
    let [voltage_v, current_a] = *numbers else {
        return None;
    };
    let current_a = f32::from_le_bytes(current_a);
    let percent = rest.first().filter(|percent| **percent <= 100);
    Some(Battery {
        current_a: (current_a.abs() <= MAX_CURRENT_A).then_some(f64::from(current_a)),
        remaining: percent.map(|percent| f64::from(*percent) / 100.0),
        ..plausible_battery(f64::from(f32::from_le_bytes(voltage_v)))?
    })
}

pub(super) const fn wheel_ticks(settings: &Ev3Settings, stamp: WireStamp, total: [i64; 2]) -> Message {
    let [left, right] = total;
    let (left, right) = match settings.motors {
        MotorDirection::Forward => (left, right),
        MotorDirection::Backward => (-left, -right),
    };
    Message::WheelTicks(WheelTicks { stamp, left: EncoderTicks(left), right: EncoderTicks(right) })
}

/// The message of a sensor's values; `None` without a valid one.
pub(super) fn sensor_message(
    role: SensorRole,
    stamp: WireStamp,
    values: [f64; 2],
    turn: &mut TurnAccumulator,
    elapsed: TimeDelta,
) -> Option<Message> {
    match role {
        SensorRole::Gyro(gyro) => gyro_message(gyro, stamp, values, turn, elapsed),
        SensorRole::Distance(kind) => {
            let (range, sigma) = kind.range(values[0])?;
            Some(Message::DistanceSensor { stamp, range, sigma })
        }
    }
}

/// In the combined mode the angle is the first value.
fn gyro_message(
    gyro: GyroSettings,
    stamp: WireStamp,
    values: [f64; 2],
    turn: &mut TurnAccumulator,
    elapsed: TimeDelta,
) -> Option<Message> {
    let (angle_deg, rate_deg_per_s) = match gyro.reading {
        GyroReading::Rate => (None, values[0]),
        GyroReading::RateAndAngle => (Some(values[0]), values[1]),
    };
    let is_sound =
        rate_deg_per_s.abs() <= MAX_DEG_PER_S && angle_deg.is_none_or(|angle_deg| angle_deg.abs() <= MAX_DEG);
    if !is_sound {
        return None;
    }
    // The sensor's arrow turns clockwise.
    let sign = match gyro.mounting {
        GyroMounting::Upright => -1.0,
        GyroMounting::UpsideDown => 1.0,
    };
    let turned_deg = angle_deg.map(|angle_deg| turn.push(elapsed, angle_deg, rate_deg_per_s));
    Some(Message::Inertial(Inertial {
        stamp,
        turn_rate: Some(RadiansPerSecond((sign * rate_deg_per_s).to_radians())),
        turn: turned_deg.map(|turned_deg| Radians((sign * turned_deg).to_radians())),
        wheel_accelerations: None,
    }))
}
