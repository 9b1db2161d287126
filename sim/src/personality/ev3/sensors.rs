//! The devices on the EV3's ports: a gyro in port 2, an ultrasonic sensor in port 4, large motors in B and C.
//!
//! # Model
//! ```text
//! gyro          mode 0 angle, 1 rate, 3 both; whole degrees, clockwise positive       ultrasonic   mode 0 centimetres; 255 without an echo
//! motor         mode 0 degrees, 2 percent of the speed                                a new mode takes 100 ms, in which a READY
//! command waits
//! ```
//! # Sources
//! LEGO MINDSTORMS EV3 hardware developer kit (types, modes, units; the gyro's sign); how long a change of mode takes: ours.

use posebridge_telemetry::TimeDelta;

use super::super::plugged_sensors::PluggedSensors;
use super::motors::Motors;
use crate::scenario::MissingSensor;

pub(super) const LARGE_MOTOR: u8 = 7;
const ULTRASONIC: u8 = 30;
const GYRO: u8 = 32;
pub(super) const NO_SENSOR: u8 = 126;
/// Sensor ports count from 0, the motors follow at 16.
const SENSOR_PORTS: usize = 4;
const FIRST_MOTOR: usize = 16;
const GYRO_PORT: usize = 1;
const ULTRASONIC_PORT: usize = 3;
const MODE_CHANGE: TimeDelta = TimeDelta::from_millis(100);
/// Readings that are 100 percent.
const GYRO_FULL_DEG_PER_S: f64 = 440.0;
const RANGE_FULL_CM: f64 = 255.0;
const MOTOR_FULL: f64 = 100.0;

#[derive(Clone, Debug, Default)]
pub(super) struct SensorPorts {
    missing: MissingSensor,
    /// A command waits for a sensor that is not there.
    pub(super) is_waited_for_in_vain: bool,
    ports: [SensorPort; SENSOR_PORTS],
    /// Zero point of the gyro's angle.
    angle_zero_deg: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct SensorPort {
    mode: u8,
    /// End of the last change of the mode.
    ready_at: TimeDelta,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SensorRequest {
    pub(super) port: usize,
    /// Device type; 0 accepts any.
    pub(super) kind: i32,
    /// -1 keeps the mode.
    pub(super) mode: i32,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum SensorReading {
    NotYet,
    NoSensor,
    /// Values in the device's units, and the value that is 100 percent.
    Values(Vec<f64>, f64),
}

impl SensorPorts {
    pub(super) fn new(missing: MissingSensor) -> Self {
        Self { missing, ..Self::default() }
    }

    pub(super) fn reset(&mut self) {
        *self = Self::new(self.missing);
    }

    /// The result for a command that waits for a reading: without a sensor it depends on the firmware.
    pub(super) fn await_reading(&mut self, reading: SensorReading) -> SensorReading {
        if reading == SensorReading::NoSensor && self.missing == MissingSensor::Awaited {
            self.is_waited_for_in_vain = true;
            return SensorReading::NotYet;
        }
        reading
    }

    pub(super) fn kind_and_mode(&self, port: usize) -> (u8, u8) {
        let kind = kind(port);
        (kind, if kind == NO_SENSOR { 0 } else { self.port(port).mode })
    }

    pub(super) fn read(
        &mut self,
        now: TimeDelta,
        request: SensorRequest,
        senses: &PluggedSensors,
        motors: &Motors,
    ) -> SensorReading {
        let SensorRequest { port, kind: requested_kind, mode } = request;
        let kind = kind(port);
        if kind == NO_SENSOR || (requested_kind != 0 && requested_kind != i32::from(kind)) {
            return SensorReading::NoSensor;
        }
        if let Some(motor) = port.checked_sub(FIRST_MOTOR) {
            return match mode {
                0 | -1 => SensorReading::Values(vec![f64::from(motors.count(motor))], MOTOR_FULL),
                2 => SensorReading::Values(vec![f64::from(motors.tacho(motor).1)], MOTOR_FULL),
                _ => SensorReading::NoSensor,
            };
        }
        self.set_mode(now, port, mode);
        if !self.is_ready(now, port) {
            return SensorReading::NotYet;
        }
        let rate = -senses.gyro.rate_deg_per_s.round();
        let angle = (self.angle_zero_deg - senses.gyro.angle_deg).round();
        match (kind, self.port(port).mode) {
            (GYRO, 0) => SensorReading::Values(vec![angle], GYRO_FULL_DEG_PER_S),
            (GYRO, 1) => SensorReading::Values(vec![rate], GYRO_FULL_DEG_PER_S),
            (GYRO, 3) => SensorReading::Values(vec![angle, rate], GYRO_FULL_DEG_PER_S),
            (ULTRASONIC, 0) => {
                let range_cm = f64::from(senses.range_cm);
                SensorReading::Values(vec![range_cm], RANGE_FULL_CM)
            }
            _ => SensorReading::NoSensor,
        }
    }

    pub(super) fn is_ready(&self, now: TimeDelta, port: usize) -> bool {
        now >= self.port(port).ready_at
    }

    fn port(&self, port: usize) -> SensorPort {
        self.ports.get(port).copied().unwrap_or_default()
    }

    /// Zeroes the gyro's angle, as a sensor does on the command to clear changes.
    pub(super) const fn clear(&mut self, senses: &PluggedSensors) {
        self.angle_zero_deg = senses.gyro.angle_deg;
    }

    fn set_mode(&mut self, now: TimeDelta, port: usize, mode: i32) {
        if let (Ok(mode), Some(port)) = (u8::try_from(mode), self.ports.get_mut(port))
            && port.mode != mode
        {
            *port = SensorPort { mode, ready_at: now + MODE_CHANGE };
        }
    }
}

fn kind(port: usize) -> u8 {
    match port.checked_sub(FIRST_MOTOR) {
        None if port == GYRO_PORT => GYRO,
        None if port == ULTRASONIC_PORT => ULTRASONIC,
        Some(motor) if Motors::is_motor(motor) => LARGE_MOTOR,
        None | Some(_) => NO_SENSOR,
    }
}
