//! The NXT's four sensor ports as its A/D converter reads them, and the Input module.
//!
//! Configuring a port makes its readings invalid for a while. An empty port, or one with an I2C sensor, reads 1023 because of the
//! pull-up. The HiTechnic gyro reads its rest value, around 600 and different for each part, plus one count per degree per second.
//!
//! # Assumptions
//! Edge and pulse counting, RCX angles and temperature scales are not simulated: these modes return the normalised value. The firmware
//! inverts the readings of light sensors; here that is 1023 - raw. Read the raw value, as every gyro driver does.
//!
//! # Sources
//! LEGO's NXT firmware: struct of the Input module, types and modes. Rest values: 580 to 625 in people's reports. Times until a port is
//! valid: ours; nxt-python waits 100 ms.

use crate::random::RandomStream;
use crate::scenario::PortSensor;

use super::super::plugged_sensors::PluggedSensors;
use super::telegram::{TelegramReply, status};

pub(super) const PORTS: usize = 4;
const MAP_BYTES: usize = 20;
const FULL_SCALE: u16 = 1_023;
/// Sensor types: the first unknown one, light sensors, I2C without and with 9 V.
const TYPES: u8 = 19;
const LIGHT_ACTIVE: u8 = 5;
const LIGHT_INACTIVE: u8 = 6;
const LOW_SPEED: u8 = 10;
const LOW_SPEED_9V: u8 = 11;
/// The mode is in the upper three bits, a slope in the others.
const MODE_MASK: u8 = 0xE0;
const MODE_BOOLEAN: u8 = 0x20;
const MODE_PERCENT: u8 = 0x80;
const PRESSED_BELOW: u16 = 460;
/// Passes until a configured port is valid: analog, and I2C.
const ANALOG_PASSES: u32 = 10;
const LOW_SPEED_PASSES: u32 = 60;
const REST_COUNTS: (f64, f64) = (580.0, 625.0);

#[derive(Clone, Copy, Debug, Default)]
struct InputPort {
    sensor: PortSensor,
    kind: u8,
    mode: u8,
    raw: u16,
    invalid_passes: u32,
}

#[derive(Clone, Debug)]
pub(super) struct InputPorts {
    ports: [InputPort; PORTS],
    gyro_rest: f64,
}

impl InputPorts {
    /// Unconfigured ports; the gyro's rest value is drawn.
    pub(super) fn new(sensors: [PortSensor; PORTS], seed: u64) -> Self {
        let ports = sensors.map(|sensor| InputPort { sensor, raw: FULL_SCALE, ..InputPort::default() });
        let gyro_rest = RandomStream::new(seed, "gyro at rest").uniform(REST_COUNTS.0, REST_COUNTS.1);
        Self { ports, gyro_rest }
    }

    pub(super) fn step(&mut self, senses: &PluggedSensors) {
        let gyro = (self.gyro_rest + senses.gyro.rate_deg_per_s).round();
        for port in &mut self.ports {
            port.invalid_passes = port.invalid_passes.saturating_sub(1);
            port.raw = match port.sensor {
                PortSensor::Gyro => gyro.clamp(0.0, f64::from(FULL_SCALE)) as u16,
                PortSensor::None
                | PortSensor::Accelerometer
                | PortSensor::Compass
                | PortSensor::Ultrasonic
                | PortSensor::Temperature => FULL_SCALE,
            };
        }
    }

    pub(super) fn set(&mut self, port: u8, kind: u8, mode: u8) -> TelegramReply {
        let input = self.ports.get_mut(usize::from(port)).filter(|_| kind < TYPES).ok_or(status::OUT_OF_RANGE)?;
        (input.kind, input.mode) = (kind, mode);
        input.invalid_passes = if is_low_speed(kind) { LOW_SPEED_PASSES } else { ANALOG_PASSES };
        Ok(Vec::new())
    }

    /// A program was started or stopped: all ports are unconfigured.
    pub(super) fn reset(&mut self) {
        for port in &mut self.ports {
            (port.kind, port.mode, port.invalid_passes) = (0, 0, 0);
        }
    }

    /// The sensor on a port that is configured for I2C and valid.
    pub(super) fn on_bus(&self, port: u8) -> Result<PortSensor, u8> {
        let input = self.ports.get(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        let is_configured = is_low_speed(input.kind) && input.is_valid();
        is_configured.then_some(input.sensor).ok_or(status::CHANNEL_NOT_CONFIGURED)
    }

    /// The reply to GETINPUTVALUES after its status.
    pub(super) fn values(&self, port: u8) -> TelegramReply {
        let input = self.ports.get(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        let is_calibrated = 0;
        let mut values = vec![port, u8::from(input.is_valid()), is_calibrated];
        values.extend([input.kind, input.mode]);
        values.extend(input.raw.to_le_bytes());
        values.extend(input.normalised().to_le_bytes());
        values.extend(input.scaled().to_le_bytes());
        values.extend(input.normalised().to_le_bytes());
        Ok(values)
    }

    pub(super) fn map(&self) -> Vec<u8> {
        self.ports.iter().flat_map(InputPort::map).collect()
    }

    /// Applies a write into the module: type and mode.
    pub(super) fn write(&mut self, offset: usize, bytes: &[u8]) {
        for (index, byte) in (offset..).zip(bytes) {
            let port = (index / MAP_BYTES) as u8;
            let Some(input) = self.ports.get(usize::from(port)).copied() else {
                return;
            };
            match index % MAP_BYTES {
                8 => drop(self.set(port, *byte, input.mode)),
                9 => drop(self.set(port, input.kind, *byte)),
                _ => {}
            }
        }
    }
}

impl InputPort {
    const fn is_valid(&self) -> bool {
        self.invalid_passes == 0
    }

    const fn normalised(&self) -> u16 {
        if matches!(self.kind, LIGHT_ACTIVE | LIGHT_INACTIVE) { FULL_SCALE - self.raw } else { self.raw }
    }

    const fn is_pressed(&self) -> bool {
        self.normalised() < PRESSED_BELOW
    }

    fn scaled(&self) -> i16 {
        let normalised = self.normalised();
        match self.mode & MODE_MASK {
            MODE_BOOLEAN => i16::from(self.is_pressed()),
            MODE_PERCENT => (u32::from(normalised) * 100 / u32::from(FULL_SCALE)) as i16,
            _ => normalised as i16,
        }
    }

    fn map(&self) -> [u8; MAP_BYTES] {
        let mut map = [0; MAP_BYTES];
        map[2..4].copy_from_slice(&self.raw.to_le_bytes());
        map[4..6].copy_from_slice(&self.normalised().to_le_bytes());
        map[6..8].copy_from_slice(&self.scaled().to_le_bytes());
        map[8] = self.kind;
        map[9] = self.mode;
        map[10] = u8::from(self.is_pressed());
        map[16] = u8::from(!self.is_valid());
        map
    }
}

const fn is_low_speed(kind: u8) -> bool {
    matches!(kind, LOW_SPEED | LOW_SPEED_9V)
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;

    use super::*;

    #[test]
    fn a_port_that_was_set_up_is_invalid_until_it_has_settled() {
        let mut inputs = InputPorts::new(PortSensor::USUAL, 5);
        let senses = PluggedSensors::new(&Scenario::default());
        inputs.set(0, LIGHT_INACTIVE, 0).unwrap();
        let valid = |inputs: &InputPorts| (inputs.values(0).unwrap()[1], inputs.map()[16]);
        for _ in 0..ANALOG_PASSES {
            assert_eq!(valid(&inputs), (0, 1));
            inputs.step(&senses);
        }
        assert_eq!(valid(&inputs), (1, 0));
        let raw = u16::from_le_bytes([inputs.map()[2], inputs.map()[3]]);
        assert!((570..=635).contains(&raw), "{raw}");
        // What a light sensor would show is another thing than the raw value.
        assert_eq!(inputs.values(0).unwrap()[7..9], (1_023 - raw).to_le_bytes());
        assert_ne!(inputs.gyro_rest, InputPorts::new(PortSensor::USUAL, 6).gyro_rest, "each gyro has its own");
    }
}
