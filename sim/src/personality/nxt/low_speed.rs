//! The NXT's four I2C channels, and the registers of the sensors on them.
//!
//! # Model
//! ```text
//! time on the bus = (bytes out + [1 for the address again] + bytes in) * 10 bits / 9600 per second
//! answer          pushed into a ring of 16 bytes at InPtr; LSREAD takes everything between OutPtr and InPtr out
//! request         the device's address, a register, and what is written there; an answer is read from that register on
//! ```
//! A station that reads the LowSpeed module instead finds the reply in the bytes before InPtr, and BytesToRx at 0 once it is complete.
//!
//! # Sources
//! LEGO's NXT firmware: struct of the LowSpeed module, ring buffers, states. 9600 bits per second and the ultrasonic sensor: LEGO's
//! hardware developer kit. HiTechnic's pages on accelerometer and compass; Texas Instruments' TMP275 data sheet, the part in LEGO's
//! temperature sensor 9749.

use super::super::plugged_sensors::PluggedSensors;
use super::inputs::PORTS;
use super::telegram::{padded, status};
use crate::scenario::PortSensor;

pub(super) const MAX_MESSAGE_BYTES: usize = 16;
const MS_PER_BYTE: f64 = 10.0 / 9.6;
const STATE_IDLE: u8 = 0;
const STATE_COMMUNICATING: u8 = 3;
const STATE_ERROR: u8 = 4;
/// No acknowledgement on the bus.
const ERROR_NO_DEVICE: u8 = 3;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ChannelState {
    #[default]
    Idle,
    Busy {
        passes: u32,
    },
    Failed,
}

#[derive(Clone, Debug, Default)]
struct LowSpeedChannel {
    device: I2cDevice,
    sensor: PortSensor,
    state: ChannelState,
    request: Vec<u8>,
    reply_length: usize,
    ring: [u8; MAX_MESSAGE_BYTES],
    next_in: usize,
    next_out: usize,
    unread: usize,
}

#[derive(Clone, Debug, Default)]
pub(super) struct LowSpeedBus {
    channels: [LowSpeedChannel; PORTS],
}

impl LowSpeedBus {
    pub(super) fn step(&mut self, inside: DeviceInputs<'_>) {
        for channel in &mut self.channels {
            channel.step(inside);
        }
    }

    /// Begins a transaction on a configured port that holds `sensor`.
    pub(super) fn write(
        &mut self,
        port: u8,
        sensor: PortSensor,
        request: &[u8],
        reply_length: usize,
    ) -> Result<(), u8> {
        let channel = self.channels.get_mut(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        if request.is_empty() || request.len() > MAX_MESSAGE_BYTES || reply_length > MAX_MESSAGE_BYTES {
            return Err(status::ILLEGAL_SIZE);
        }
        if matches!(channel.state, ChannelState::Busy { .. }) {
            return Err(status::PENDING);
        }
        let bytes = request.len() + usize::from(reply_length > 0) + reply_length;
        channel.state = ChannelState::Busy { passes: (bytes as f64 * MS_PER_BYTE).ceil() as u32 };
        channel.sensor = sensor;
        channel.request = request.to_vec();
        channel.reply_length = reply_length;
        Ok(())
    }

    pub(super) fn ready(&self, port: u8) -> Result<usize, u8> {
        let channel = self.channels.get(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        match channel.state {
            ChannelState::Idle => Ok(channel.unread),
            ChannelState::Busy { .. } => Err(status::PENDING),
            ChannelState::Failed => Err(status::BUS_ERROR),
        }
    }

    pub(super) fn read(&mut self, port: u8) -> Result<Vec<u8>, u8> {
        let unread = self.ready(port)?;
        let channel = self.channels.get_mut(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        let ring = channel.ring.iter().cycle().skip(channel.next_out);
        let bytes = ring.take(unread).copied().collect();
        channel.next_out = channel.next_in;
        channel.unread = 0;
        Ok(bytes)
    }

    /// A program was started or stopped: transactions are aborted, the sensors keep their settings.
    pub(super) fn reset(&mut self) {
        for channel in &mut self.channels {
            *channel = LowSpeedChannel { device: channel.device.clone(), ..LowSpeedChannel::default() };
        }
    }

    pub(super) fn map(&self) -> Vec<u8> {
        let mut map = Vec::with_capacity(167);
        for channel in &self.channels {
            map.extend(channel.ring);
            map.extend([channel.next_in as u8, channel.next_out as u8]);
            map.push(match channel.state {
                ChannelState::Busy { .. } => channel.reply_length as u8,
                ChannelState::Idle | ChannelState::Failed => 0,
            });
        }
        for channel in &self.channels {
            map.extend(padded(&channel.request, MAX_MESSAGE_BYTES));
            map.extend([channel.request.len() as u8, 0, 0]);
        }
        // Modes, states, errors, which channels are at work, and the speed.
        map.extend([0; PORTS]);
        let shown = self.channels.each_ref().map(LowSpeedChannel::shown_state_and_error);
        map.extend(shown.map(|(state, _)| state));
        map.extend(shown.map(|(_, error)| error));
        let is_busy = |channel: &LowSpeedChannel| matches!(channel.state, ChannelState::Busy { .. });
        let busy = (0_u8..).zip(&self.channels);
        map.push(busy.fold(0, |bits, (port, channel)| bits | (u8::from(is_busy(channel)) << port)));
        map.push(0);
        map
    }
}

impl LowSpeedChannel {
    fn step(&mut self, inside: DeviceInputs<'_>) {
        let ChannelState::Busy { passes } = self.state else {
            return;
        };
        if passes > 1 {
            self.state = ChannelState::Busy { passes: passes - 1 };
            return;
        }
        match self.device.transact(self.sensor, &self.request, self.reply_length, inside) {
            Some(answer) => {
                self.state = ChannelState::Idle;
                for byte in answer {
                    self.push(byte);
                }
            }
            None => self.state = ChannelState::Failed,
        }
    }

    fn push(&mut self, byte: u8) {
        if let Some(slot) = self.ring.get_mut(self.next_in) {
            *slot = byte;
        }
        self.next_in = (self.next_in + 1) % MAX_MESSAGE_BYTES;
        if self.unread == MAX_MESSAGE_BYTES {
            self.next_out = self.next_in;
        } else {
            self.unread += 1;
        }
    }

    const fn shown_state_and_error(&self) -> (u8, u8) {
        match self.state {
            ChannelState::Idle => (STATE_IDLE, 0),
            ChannelState::Busy { .. } => (STATE_COMMUNICATING, 0),
            ChannelState::Failed => (STATE_ERROR, ERROR_NO_DEVICE),
        }
    }
}

/// I2C addresses of HiTechnic's and LEGO's sensors, and of the temperature sensor, both with the read bit 0.
const USUAL_ADDRESS: u8 = 0x02;
const TEMPERATURE_ADDRESS: u8 = 0x98;
/// Registers: version, maker and kind in eight bytes each, units, interval, command or mode, first reading.
const NAMES: u8 = 0x00;
const UNITS: u8 = 0x14;
const INTERVAL: usize = 0x40;
const COMMAND: usize = 0x41;
const READINGS: u8 = 0x42;
const SINGLE_SHOT: u8 = 0x01;
const CONTINUOUS: u8 = 0x02;
const WARM_RESET: u8 = 0x04;
/// The TMP275's registers.
const POINT_TEMPERATURE: u8 = 0x00;
const POINT_CONFIGURATION: u8 = 0x01;
/// At the full resolution of twelve bits.
const COUNTS_PER_K: f64 = 16.0;

#[derive(Clone, Copy, Debug)]
pub(super) struct DeviceInputs<'a> {
    /// Everything but the temperature.
    pub(super) senses: &'a PluggedSensors,
    pub(super) temperature_c: f64,
}

#[derive(Clone, Debug)]
pub(super) struct I2cDevice {
    registers: [u8; 256],
    /// Pointer and configuration of the TMP275.
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
    /// One transaction with `sensor`: the request, then `reply_length` bytes of reply. `None` if no device has that address.
    pub(super) fn transact(
        &mut self,
        sensor: PortSensor,
        request: &[u8],
        reply_length: usize,
        inside: DeviceInputs<'_>,
    ) -> Option<Vec<u8>> {
        let (address, rest) = request.split_first()?;
        match (sensor, *address) {
            (PortSensor::Temperature, TEMPERATURE_ADDRESS) => {
                Some(self.thermometer(rest, reply_length, inside.temperature_c))
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
                let bytes = self.registers.iter().cycle().skip(from).take(reply_length);
                Some(bytes.copied().collect())
            }
            _ => None,
        }
    }

    /// Only the command and the interval are writable.
    fn put(&mut self, register: usize, value: u8) {
        match register {
            INTERVAL => self.registers[INTERVAL] = value,
            COMMAND if value == WARM_RESET => *self = Self::default(),
            COMMAND => self.registers[COMMAND] = value,
            _ => {}
        }
    }

    fn refresh(&mut self, sensor: PortSensor, senses: &PluggedSensors) {
        match sensor {
            PortSensor::Accelerometer => {
                self.write_registers(NAMES, b"\xfdV1.1   HiTechncAccel.  ");
                let [high, low] = acceleration_registers(senses.accelerometer.counts);
                self.write_registers(READINGS, &high);
                self.write_registers(READINGS + 3, &low);
            }
            PortSensor::Compass => {
                self.write_registers(NAMES, b"\xfdV1.23  HiTechncCompass ");
                let degrees = senses.compass_deg;
                // Measuring, whatever mode was written.
                self.registers[COMMAND] = 0;
                self.write_registers(READINGS, &[(degrees / 2) as u8, (degrees % 2) as u8]);
                self.write_registers(READINGS + 2, &degrees.to_le_bytes());
            }
            PortSensor::Ultrasonic => {
                self.write_registers(NAMES, b"V1.0\0\0\0\0LEGO\0\0\0\0Sonar\0\0\0");
                if matches!(self.registers[COMMAND], SINGLE_SHOT | CONTINUOUS) {
                    let others = [255; 7];
                    self.write_registers(READINGS, &[senses.range_cm]);
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

    fn thermometer(&mut self, request: &[u8], reply_length: usize, temperature_c: f64) -> Vec<u8> {
        if let Some((pointer, values)) = request.split_first() {
            self.pointer = *pointer;
            if let (POINT_CONFIGURATION, Some(value)) = (self.pointer, values.first()) {
                self.configuration = *value;
            }
        }
        if self.pointer == POINT_CONFIGURATION {
            return vec![self.configuration; reply_length];
        }
        // Bits 6 and 5: 9, 10, 11 or 12 bits are converted, the others are zero.
        let unused_bits = 3 - ((self.configuration >> 5) & 3);
        let counts = (temperature_c * COUNTS_PER_K).floor().clamp(-2_048.0, 2_047.0) as i16;
        let register = (counts >> unused_bits << unused_bits) << 4;
        let bytes = register.to_be_bytes().into_iter().chain(std::iter::repeat(0xFF));
        bytes.take(reply_length).collect()
    }
}

/// Ten bits of each axis with a sign: the upper eight, then the lower two.
fn acceleration_registers(counts: [i16; 3]) -> [[u8; 3]; 2] {
    [counts.map(|count| (count >> 2) as u8), counts.map(|count| (count & 3) as u8)]
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;

    use super::*;

    const REQUEST: &[u8] = &[0x02, 0x42];

    fn pass(bus: &mut LowSpeedBus, count: u32) {
        let senses = PluggedSensors::new(&Scenario::default());
        let inside = DeviceInputs { senses: &senses, temperature_c: 20.0 };
        (0..count).for_each(|_| bus.step(inside));
    }

    #[test]
    fn an_answer_is_pending_for_as_long_as_its_bytes_take() {
        let mut bus = LowSpeedBus::default();
        bus.write(1, PortSensor::Accelerometer, REQUEST, 6).unwrap();
        // 2 out, the address again, 6 in: 9 bytes of 1.04 ms.
        pass(&mut bus, 9);
        assert_eq!(bus.ready(1), Err(status::PENDING));
        assert_eq!(bus.write(1, PortSensor::Accelerometer, REQUEST, 6), Err(status::PENDING));
        assert_eq!((bus.map()[19 + 18], bus.map()[157], bus.map()[164]), (6, 3, 2));
        pass(&mut bus, 1);
        assert_eq!(bus.ready(1), Ok(6));
        assert_eq!(bus.map()[19..19 + 19], [0, 0, 50, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 6, 0, 0]);
        assert_eq!(bus.read(1).unwrap(), [0, 0, 50, 0, 0, 0]);
        assert_eq!(bus.read(1).unwrap(), [0_u8; 0]);
    }

    #[test]
    fn a_ring_that_nobody_empties_holds_the_last_sixteen_bytes() {
        let mut bus = LowSpeedBus::default();
        for _ in 0..3 {
            bus.write(0, PortSensor::Accelerometer, REQUEST, 6).unwrap();
            pass(&mut bus, 10);
        }
        assert_eq!((bus.map()[16], bus.ready(0)), (2, Ok(16)));
        // The third answer went over the end of the ring.
        assert_eq!(bus.map()[12..16], [0, 0, 50, 0]);
        assert_eq!(bus.read(0).unwrap().len(), 16);
    }

    #[test]
    fn an_acceleration_is_eight_bits_with_a_sign_and_two_without() {
        assert_eq!(acceleration_registers([-1, 2, 203]), [[0xFF, 0, 50], [3, 2, 3]]);
        assert_eq!(acceleration_registers([-512, 511, -6])[0], [0x80, 0x7F, 0xFE]);
    }
}
