//! The NXT's four I2C channels: transactions that take their time, and the LowSpeed module.
//!
//! # Model
//! ```text
//! time on the bus = (bytes out + [1 for the address again] + bytes in) * 10 bits / 9600 per second
//! answer          pushed into a ring of 16 bytes at InPtr; LSREAD takes everything between OutPtr and InPtr out
//! ```
//! A station that reads the module instead finds its answer in the bytes before InPtr, and BytesToRx at 0 when it is there.
//!
//! # Sources
//! LEGO's NXT firmware: struct of the LowSpeed module, ring buffers, states. 9600 bits per second: LEGO's hardware developer kit.

use crate::scenario::PortSensor;

use super::devices::{DeviceInputs, I2cDevice};
use super::inputs::PORTS;
use super::status;

/// Bytes that a request or an answer can have.
pub(super) const MAX_MESSAGE_BYTES: usize = 16;
/// Milliseconds that a byte takes on the bus.
const MS_PER_BYTE: f64 = 10.0 / 9.6;
/// The module's status of a channel.
const STATE_IDLE: u8 = 0;
const STATE_COMMUNICATING: u8 = 3;
const STATE_ERROR: u8 = 4;
/// No acknowledgement on the bus.
const ERROR_NO_DEVICE: u8 = 3;

/// What a channel does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ChannelState {
    #[default]
    Idle,
    Busy {
        passes: u32,
    },
    Failed,
}

/// One channel.
#[derive(Clone, Debug, Default)]
struct LowSpeedChannel {
    device: I2cDevice,
    sensor: PortSensor,
    state: ChannelState,
    request: Vec<u8>,
    wanted: usize,
    ring: [u8; MAX_MESSAGE_BYTES],
    next_in: usize,
    next_out: usize,
    unread: usize,
}

/// All channels.
#[derive(Clone, Debug, Default)]
pub(super) struct LowSpeedBus {
    channels: [LowSpeedChannel; PORTS],
}

impl LowSpeedBus {
    /// Passes one millisecond on all buses.
    pub(super) fn step(&mut self, inside: DeviceInputs<'_>) {
        for channel in &mut self.channels {
            channel.step(inside);
        }
    }

    /// Begins a transaction on a port that is set up and holds `sensor`.
    pub(super) fn write(&mut self, port: u8, sensor: PortSensor, request: &[u8], wanted: usize) -> Result<(), u8> {
        let channel = self.channels.get_mut(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        if request.is_empty() || request.len() > MAX_MESSAGE_BYTES || wanted > MAX_MESSAGE_BYTES {
            return Err(status::ILLEGAL_SIZE);
        }
        if matches!(channel.state, ChannelState::Busy { .. }) {
            return Err(status::PENDING);
        }
        let bytes = request.len() + usize::from(wanted > 0) + wanted;
        channel.state = ChannelState::Busy { passes: (bytes as f64 * MS_PER_BYTE).ceil() as u32 };
        channel.sensor = sensor;
        channel.request = request.to_vec();
        channel.wanted = wanted;
        Ok(())
    }

    /// How many bytes wait to be read.
    pub(super) fn ready(&self, port: u8) -> Result<usize, u8> {
        let channel = self.channels.get(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        match channel.state {
            ChannelState::Idle => Ok(channel.unread),
            ChannelState::Busy { .. } => Err(status::PENDING),
            ChannelState::Failed => Err(status::BUS_ERROR),
        }
    }

    /// Takes out what waits.
    pub(super) fn read(&mut self, port: u8) -> Result<Vec<u8>, u8> {
        let unread = self.ready(port)?;
        let channel = self.channels.get_mut(usize::from(port)).ok_or(status::OUT_OF_RANGE)?;
        let ring = channel.ring.iter().cycle().skip(channel.next_out);
        let bytes = ring.take(unread).copied().collect();
        channel.next_out = channel.next_in;
        channel.unread = 0;
        Ok(bytes)
    }

    /// A program was started or stopped: what was under way is forgotten, the sensors keep their settings.
    pub(super) fn reset(&mut self) {
        for channel in &mut self.channels {
            *channel = LowSpeedChannel { device: channel.device.clone(), ..LowSpeedChannel::default() };
        }
    }

    /// The LowSpeed module.
    pub(super) fn map(&self) -> Vec<u8> {
        let mut map = Vec::with_capacity(167);
        for channel in &self.channels {
            map.extend(channel.ring);
            map.extend([channel.next_in as u8, channel.next_out as u8]);
            map.push(match channel.state {
                ChannelState::Busy { .. } => channel.wanted as u8,
                ChannelState::Idle | ChannelState::Failed => 0,
            });
        }
        for channel in &self.channels {
            let mut request = [0; MAX_MESSAGE_BYTES];
            for (place, byte) in request.iter_mut().zip(&channel.request) {
                *place = *byte;
            }
            map.extend(request);
            map.extend([channel.request.len() as u8, 0, 0]);
        }
        // Modes, states, errors, which channels are at work, and the speed.
        map.extend([0; PORTS]);
        map.extend(self.channels.each_ref().map(LowSpeedChannel::shown_state));
        map.extend(self.channels.each_ref().map(LowSpeedChannel::shown_error));
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
        match self.device.transact(self.sensor, &self.request, self.wanted, inside) {
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
        if let Some(place) = self.ring.get_mut(self.next_in) {
            *place = byte;
        }
        self.next_in = (self.next_in + 1) % MAX_MESSAGE_BYTES;
        if self.unread == MAX_MESSAGE_BYTES {
            self.next_out = self.next_in;
        } else {
            self.unread += 1;
        }
    }

    const fn shown_state(&self) -> u8 {
        match self.state {
            ChannelState::Idle => STATE_IDLE,
            ChannelState::Busy { .. } => STATE_COMMUNICATING,
            ChannelState::Failed => STATE_ERROR,
        }
    }

    const fn shown_error(&self) -> u8 {
        match self.state {
            ChannelState::Failed => ERROR_NO_DEVICE,
            ChannelState::Idle | ChannelState::Busy { .. } => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::personality::plugged_sensors::PluggedSensors;
    use crate::scenario::Scenario;

    fn pass(bus: &mut LowSpeedBus, count: u32) {
        let senses = PluggedSensors::new(&Scenario::default());
        let inside = DeviceInputs { senses: &senses, temperature_c: 20.0 };
        (0..count).for_each(|_| bus.step(inside));
    }

    const REQUEST: &[u8] = &[0x02, 0x42];

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
    fn an_empty_port_is_a_bus_error_until_the_next_transaction() {
        let mut bus = LowSpeedBus::default();
        bus.write(2, PortSensor::None, REQUEST, 6).unwrap();
        pass(&mut bus, 10);
        assert_eq!(bus.ready(2), Err(status::BUS_ERROR));
        assert_eq!(bus.read(2), Err(status::BUS_ERROR));
        bus.write(2, PortSensor::Ultrasonic, REQUEST, 6).unwrap();
        pass(&mut bus, 10);
        assert_eq!(bus.ready(2), Ok(6));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut bus = LowSpeedBus::default();
        assert_eq!(bus.write(4, PortSensor::None, REQUEST, 6), Err(status::OUT_OF_RANGE));
        assert_eq!(bus.write(0, PortSensor::None, &[], 1), Err(status::ILLEGAL_SIZE));
        assert_eq!(bus.write(0, PortSensor::None, &[2], 17), Err(status::ILLEGAL_SIZE));
        assert_eq!(bus.map().len(), 166);
    }
}
