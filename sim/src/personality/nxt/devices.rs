//! The sensors on the NXT's I2C buses: registers that a station writes and reads.
//!
//! A request is the device's address, a register, and what is written there; an answer is read from that register on.
//!
//! # Sources
//! HiTechnic's pages on accelerometer and compass; LEGO's hardware developer kit on the ultrasonic sensor; Texas Instruments' TMP275
//! data sheet, the part in LEGO's temperature sensor 9749.

use crate::scenario::PortSensor;

use super::super::plugged_sensors::PluggedSensors;

/// The address of HiTechnic's and LEGO's sensors, and that of the temperature sensor, both with the bit for reading at 0.
const USUAL_ADDRESS: u8 = 0x02;
const TEMPERATURE_ADDRESS: u8 = 0x98;
/// Registers: name tags, units, interval, command or mode, first reading.
const VERSION: u8 = 0x00;
const MAKER: u8 = 0x08;
const KIND: u8 = 0x10;
const UNITS: u8 = 0x14;
const INTERVAL: usize = 0x40;
const COMMAND: usize = 0x41;
const READINGS: u8 = 0x42;
/// Commands of the ultrasonic sensor.
const SINGLE_SHOT: u8 = 0x01;
const CONTINUOUS: u8 = 0x02;
const WARM_RESET: u8 = 0x04;
/// The TMP275's registers.
const POINT_TEMPERATURE: u8 = 0x00;
const POINT_CONFIGURATION: u8 = 0x01;
/// Its counts per kelvin when all twelve bits are used.
const COUNTS_PER_K: f64 = 16.0;

/// What a sensor's inside is like at this moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeviceInputs<'a> {
    /// Everything but the temperature.
    pub(super) senses: &'a PluggedSensors,
    /// In degrees Celsius.
    pub(super) temperature_c: f64,
}

/// The memory of whatever sits in one port.
#[derive(Clone, Debug)]
pub(super) struct I2cDevice {
    registers: [u8; 256],
    /// The TMP275's pointer and configuration.
    pointer: u8,
    configuration: u8,
}

impl Default for I2cDevice {
    fn default() -> Self {
        let mut registers = [0; 256];
        registers[INTERVAL] = 1;
        registers[COMMAND] = CONTINUOUS;
        Self { registers, pointer: POINT_TEMPERATURE, configuration: 0 }
    }
}

impl I2cDevice {
    /// One transaction with `sensor`: the request, then `wanted` bytes of answer. `None` if no device has that address.
    pub(super) fn transact(
        &mut self,
        sensor: PortSensor,
        request: &[u8],
        wanted: usize,
        inside: DeviceInputs<'_>,
    ) -> Option<Vec<u8>> {
        let (address, rest) = request.split_first()?;
        match (sensor, *address) {
            (PortSensor::Temperature, TEMPERATURE_ADDRESS) => {
                Some(self.thermometer(rest, wanted, inside.temperature_c))
            }
            (PortSensor::Accelerometer | PortSensor::Compass | PortSensor::Ultrasonic, USUAL_ADDRESS) => {
                let (first, values) = rest.split_first().map_or((0, rest), |(r, v)| (*r, v));
                for (register, value) in (usize::from(first)..).zip(values) {
                    self.put(register, *value);
                }
                self.refresh(sensor, inside.senses);
                if (sensor, first) == (PortSensor::Ultrasonic, UNITS) {
                    // Read by its own number, the unit is there; read through from the kind on, it is not.
                    self.write_registers(UNITS, b"10E-2m\0");
                }
                let from = usize::from(first);
                let bytes = self.registers.iter().cycle().skip(from).take(wanted);
                Some(bytes.copied().collect())
            }
            _ => None,
        }
    }

    /// Only the command and the interval can be written.
    fn put(&mut self, register: usize, value: u8) {
        match register {
            INTERVAL => self.registers[INTERVAL] = value,
            COMMAND if value == WARM_RESET => *self = Self::default(),
            COMMAND => self.registers[COMMAND] = value,
            _ => {}
        }
    }

    fn refresh(&mut self, sensor: PortSensor, senses: &PluggedSensors) {
        let (version, maker, kind): (&[u8], &[u8], &[u8]) = match sensor {
            PortSensor::Accelerometer => (b"\xfdV1.1   ", b"HiTechnc", b"Accel.  "),
            PortSensor::Compass => (b"\xfdV1.23  ", b"HiTechnc", b"Compass "),
            PortSensor::Ultrasonic => (b"V1.0\0\0\0\0", b"LEGO\0\0\0\0", b"Sonar\0\0\0"),
            PortSensor::None | PortSensor::Gyro | PortSensor::Temperature => (b"", b"", b""),
        };
        self.write_registers(VERSION, version);
        self.write_registers(MAKER, maker);
        self.write_registers(KIND, kind);
        match sensor {
            PortSensor::Accelerometer => {
                let [high, low] = acceleration_registers(senses.acceleration_counts());
                self.write_registers(READINGS, &high);
                self.write_registers(READINGS + 3, &low);
            }
            PortSensor::Compass => {
                let degrees = senses.compass_deg();
                // Measuring, whatever mode was written.
                self.registers[COMMAND] = 0;
                self.write_registers(READINGS, &[(degrees / 2) as u8, (degrees % 2) as u8]);
                self.write_registers(READINGS + 2, &degrees.to_le_bytes());
            }
            PortSensor::Ultrasonic => {
                if matches!(self.registers[COMMAND], SINGLE_SHOT | CONTINUOUS) {
                    let others = [255; 7];
                    self.write_registers(READINGS, &[senses.range_cm()]);
                    self.write_registers(READINGS + 1, &others);
                }
                if self.registers[COMMAND] == SINGLE_SHOT {
                    self.registers[COMMAND] = 0;
                }
            }
            PortSensor::None | PortSensor::Gyro | PortSensor::Temperature => {}
        }
    }

    fn write_registers(&mut self, first: u8, bytes: &[u8]) {
        let from = usize::from(first);
        for (register, byte) in self.registers.iter_mut().skip(from).zip(bytes) {
            *register = *byte;
        }
    }

    fn thermometer(&mut self, request: &[u8], wanted: usize, temperature_c: f64) -> Vec<u8> {
        if let Some((pointer, values)) = request.split_first() {
            self.pointer = *pointer;
            if let (POINT_CONFIGURATION, Some(value)) = (self.pointer, values.first()) {
                self.configuration = *value;
            }
        }
        if self.pointer == POINT_CONFIGURATION {
            return vec![self.configuration; wanted];
        }
        // Bits 6 and 5: 9, 10, 11 or 12 bits are converted, the others are zero.
        let unused_bits = 3 - ((self.configuration >> 5) & 3);
        let counts = (temperature_c * COUNTS_PER_K).floor().clamp(-2_048.0, 2_047.0) as i16;
        let register = (counts >> unused_bits << unused_bits) << 4;
        let bytes = register.to_be_bytes().into_iter().chain(std::iter::repeat(0xFF));
        bytes.take(wanted).collect()
    }
}

/// Ten bits of each axis with a sign: the upper eight, then the lower two.
fn acceleration_registers(counts: [i16; 3]) -> [[u8; 3]; 2] {
    [counts.map(|count| (count >> 2) as u8), counts.map(|count| (count & 3) as u8)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    fn request(sensor: PortSensor, request: &[u8], wanted: usize, temperature_c: f64) -> Option<Vec<u8>> {
        let senses = PluggedSensors::new(&Scenario::default());
        let inside = DeviceInputs { senses: &senses, temperature_c };
        I2cDevice::default().transact(sensor, request, wanted, inside)
    }

    #[test]
    fn the_accelerometer_at_rest_shows_one_g_upwards_in_ten_bits() {
        let answer = request(PortSensor::Accelerometer, &[0x02, 0x42], 6, 0.0).unwrap();
        assert_eq!(answer, [0, 0, 50, 0, 0, 0]);
    }

    #[test]
    fn an_acceleration_is_eight_bits_with_a_sign_and_two_without() {
        let registers = acceleration_registers([-1, 2, 203]);
        assert_eq!(registers, [[0xFF, 0, 50], [3, 2, 3]]);
        assert_eq!(acceleration_registers([-512, 511, -6])[0], [0x80, 0x7F, 0xFE]);
    }

    #[test]
    fn every_sensor_tells_its_name() {
        let answer = request(PortSensor::Ultrasonic, &[0x02, 0x08], 16, 0.0).unwrap();
        assert_eq!(&answer, b"LEGO\0\0\0\0Sonar\0\0\0");
        let unit = request(PortSensor::Ultrasonic, &[0x02, 0x14], 7, 0.0).unwrap();
        assert_eq!(&unit, b"10E-2m\0");
        assert_eq!(request(PortSensor::Compass, &[0x02, 0x10], 8, 0.0).unwrap(), b"Compass ");
        assert_eq!(request(PortSensor::Ultrasonic, &[0x02, 0x42], 1, 0.0).unwrap(), [255]);
    }

    #[test]
    fn the_thermometer_has_nine_bits_until_it_is_told_otherwise() {
        // 21.7 is 0x15b sixteenths; 9 bits keep halves of a degree.
        let read = |request_bytes: &[u8], wanted, temperature_c| {
            request(PortSensor::Temperature, request_bytes, wanted, temperature_c).unwrap()
        };
        assert_eq!(read(&[0x98, 0x00], 2, 21.7), [0x15, 0x80]);
        assert_eq!(read(&[0x98, 0x00], 2, -0.1), [0xFF, 0x80]);
        let senses = PluggedSensors::new(&Scenario::default());
        let inside = DeviceInputs { senses: &senses, temperature_c: 21.7 };
        let mut device = I2cDevice::default();
        let mut twelve =
            |request: &[u8], wanted| device.transact(PortSensor::Temperature, request, wanted, inside).unwrap();
        assert_eq!(twelve(&[0x98, 0x01, 0x60], 1), [0x60]);
        assert_eq!(twelve(&[0x98, 0x00], 2), [0x15, 0xB0]);
    }

    #[test]
    fn nobody_answers_at_another_address() {
        assert_eq!(request(PortSensor::Compass, &[0x98, 0x00], 2, 0.0), None);
        assert_eq!(request(PortSensor::Temperature, &[0x02, 0x42], 2, 0.0), None);
        assert_eq!(request(PortSensor::Gyro, &[0x02, 0x42], 1, 0.0), None);
        assert_eq!(request(PortSensor::Compass, &[], 1, 0.0), None);
    }
}
