//! Sensors on the I2C bus: requests without a reply, and answers that are read with the next round of IO maps.
//!
//! A buffer is an answer when nothing is to come on the bus and its write index has moved since it was looked at last. An
//! index that remains still is an answer only of a firmware that was seen to write each answer to the ring's start: with an
//! index before it that no answers of this length lead from. The first reading after a set-up only gives the index.
//!
//! # Sources
//! HiTechnic's register tables of NAC1040 and NMC1034; LEGO MINDSTORMS NXT Hardware Developer Kit, ultrasonic sensor; Texas
//! Instruments TMP275 datasheet, tables 2 to 8, for LEGO 9749.

use posebridge_telemetry::{Celsius, HostClock, Meters, MetersPerSecondSquared, TimeDelta, Timestamp};

use super::io_maps::DigitalBuffer;
use super::settings::{ForwardAxis, NxtSensor};
use super::telegram;

/// Address of LEGO's and HiTechnic's digital sensors.
const SENSOR: u8 = 0x02;
/// First register of their measurements.
const MEASURED: u8 = 0x42;
/// Address of LEGO's thermometer.
const THERMOMETER: u8 = 0x98;
/// Standard gravity over 200 counts.
const ACCELERATION_UNIT_M_PER_S2: f64 = 9.806_65 / 200.0;
const NO_ECHO: u8 = 255;
const RING_BYTES: u8 = 16;
/// Rounds in which an answer may still come before the sensor is polled again.
const MAX_REPLY_ROUNDS: u8 = 3;
/// Requests in a row without a reply after which a warning is sent.
const UNANSWERED_LIMIT: u8 = 10;
/// Settling time of a sensor's mode.
const SETTLING_TIME: TimeDelta = TimeDelta::from_millis(100);
const MAX_REPLY_BYTES: usize = 6;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum DigitalMeasurement {
    /// Along the robot's forward direction.
    Acceleration(MetersPerSecondSquared),
    /// Clockwise from magnetic north.
    CompassDegrees(f64),
    Range(Meters),
    NoEcho,
    Temperature(Celsius),
}

#[derive(Clone, Copy, Debug)]
struct BusProtocol {
    request: &'static [u8],
    reply_bytes: u8,
    /// Sent once after the set-up.
    prepare: Option<&'static [u8]>,
    period: TimeDelta,
}

const fn bus_protocol(sensor: NxtSensor) -> Option<BusProtocol> {
    let (request, answer_bytes, prepare, period): (_, _, Option<&'static [u8]>, _) = match sensor {
        NxtSensor::None | NxtSensor::HtGyro => return None,
        NxtSensor::HtAccelerometer { .. } => (&[SENSOR, MEASURED], 6, None, 0),
        NxtSensor::HtCompass => (&[SENSOR, MEASURED], 2, None, 100),
        NxtSensor::Ultrasonic => (&[SENSOR, MEASURED], 1, Some(&[SENSOR, 0x41, 0x02]), 100),
        NxtSensor::Temperature => (&[THERMOMETER, 0x00], 2, Some(&[THERMOMETER, 0x01, 0x60]), 1_000),
    };
    Some(BusProtocol { request, reply_bytes: answer_bytes, prepare, period: TimeDelta::from_millis(period) })
}

pub(super) const fn is_digital(sensor: NxtSensor) -> bool {
    bus_protocol(sensor).is_some()
}

#[derive(Clone, Copy, Debug)]
pub(super) struct DigitalSensor {
    sensor: NxtSensor,
    protocol: BusProtocol,
    is_prepared: bool,
    due: Timestamp<HostClock>,
    requested_at: Option<Timestamp<HostClock>>,
    rounds: u8,
    unanswered: u8,
    last_ring_end: Option<u8>,
    /// The firmware writes answers to the start of the ring.
    ring_restarts: bool,
}

impl DigitalSensor {
    pub(super) const fn new(sensor: NxtSensor) -> Option<Self> {
        let Some(manner) = bus_protocol(sensor) else {
            return None;
        };
        Some(Self {
            sensor,
            protocol: manner,
            is_prepared: manner.prepare.is_none(),
            due: Timestamp::ZERO,
            requested_at: None,
            rounds: 0,
            unanswered: 0,
            last_ring_end: None,
            ring_restarts: false,
        })
    }

    pub(super) const fn restart(&mut self, now: Timestamp<HostClock>) {
        self.is_prepared = self.protocol.prepare.is_none();
        self.due = now;
        self.requested_at = None;
        self.unanswered = 0;
        self.last_ring_end = None;
    }

    pub(super) const fn pending_since(&self) -> Option<Timestamp<HostClock>> {
        self.requested_at
    }

    pub(super) const fn is_silent(&self) -> bool {
        self.unanswered >= UNANSWERED_LIMIT
    }

    pub(super) fn write(&mut self, port: u8, now: Timestamp<HostClock>) -> Option<Vec<u8>> {
        if self.requested_at.is_some() || now < self.due {
            return None;
        }
        if let (false, Some(prepare)) = (self.is_prepared, self.protocol.prepare) {
            self.is_prepared = true;
            self.due = now + SETTLING_TIME;
            return Some(telegram::ls_write(port, prepare, 0));
        }
        self.requested_at = Some(now);
        self.rounds = 0;
        self.due = now + self.protocol.period;
        let BusProtocol { request, reply_bytes: answer_bytes, .. } = self.protocol;
        Some(telegram::ls_write(port, request, answer_bytes))
    }

    pub(super) fn read_ring(&mut self, buffer: DigitalBuffer) -> Option<DigitalMeasurement> {
        if buffer.pending_bytes > 0 {
            self.keep_waiting();
            return None;
        }
        let Some(before) = self.last_ring_end.replace(buffer.end) else {
            // The value may be of any time: request again.
            self.requested_at = None;
            return None;
        };
        self.ring_restarts |= self.is_at_start(buffer.end) && !self.is_multiple_of_reply(before, buffer.end);
        let is_rewritten = self.ring_restarts && self.is_at_start(buffer.end);
        if before == buffer.end && !is_rewritten {
            self.keep_waiting();
            return None;
        }
        self.record_reply();
        self.decode_last(buffer.last_bytes())
    }

    const fn is_at_start(&self, end: u8) -> bool {
        end == self.protocol.reply_bytes
    }

    /// Whether a few answers, one after the other in the ring, or none lead from one index to another.
    fn is_multiple_of_reply(&self, before: u8, end: u8) -> bool {
        let step = self.protocol.reply_bytes;
        (0..=MAX_REPLY_ROUNDS).any(|answers| (before % RING_BYTES + answers * step) % RING_BYTES == end)
    }

    /// Parses the answer in the buffer: `length` bytes of `data`.
    pub(super) fn read_fetched(&mut self, length: u8, data: [u8; 16]) -> Option<DigitalMeasurement> {
        if length < self.protocol.reply_bytes {
            self.keep_waiting();
            return None;
        }
        self.record_reply();
        let end = length % RING_BYTES;
        let pending_bytes = 0;
        self.decode_last(DigitalBuffer { ring: data, end, pending_bytes }.last_bytes())
    }

    pub(super) fn keep_waiting(&mut self) {
        self.rounds += 1;
        if self.rounds >= MAX_REPLY_ROUNDS {
            self.requested_at = None;
            self.unanswered = self.unanswered.saturating_add(1);
        }
    }

    const fn record_reply(&mut self) {
        self.requested_at = None;
        self.unanswered = 0;
    }

    fn decode_last(&self, last: [u8; MAX_REPLY_BYTES]) -> Option<DigitalMeasurement> {
        let [x, y, z, x_low, y_low, z_low] = last;
        match self.sensor {
            NxtSensor::None | NxtSensor::HtGyro => None,
            NxtSensor::HtAccelerometer { forward, .. } => {
                let counts = |high: u8, low: u8| f64::from((i16::from(high.cast_signed()) << 2) | i16::from(low & 3));
                let along = match forward {
                    ForwardAxis::X => counts(x, x_low),
                    ForwardAxis::MinusX => -counts(x, x_low),
                    ForwardAxis::Y => counts(y, y_low),
                    ForwardAxis::MinusY => -counts(y, y_low),
                    ForwardAxis::Z => counts(z, z_low),
                    ForwardAxis::MinusZ => -counts(z, z_low),
                };
                let along = MetersPerSecondSquared(along * ACCELERATION_UNIT_M_PER_S2);
                Some(DigitalMeasurement::Acceleration(along))
            }
            NxtSensor::HtCompass => {
                let degrees = 2.0 * f64::from(y_low) + f64::from(z_low);
                (degrees < 360.0).then_some(DigitalMeasurement::CompassDegrees(degrees))
            }
            NxtSensor::Ultrasonic if z_low == NO_ECHO => Some(DigitalMeasurement::NoEcho),
            NxtSensor::Ultrasonic => Some(DigitalMeasurement::Range(Meters(f64::from(z_low) / 100.0))),
            NxtSensor::Temperature => {
                let sixteenths = i16::from_be_bytes([y_low, z_low]) >> 4;
                let celsius = Celsius(f64::from(sixteenths) / 16.0);
                Some(DigitalMeasurement::Temperature(celsius))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bricks::nxt::settings::AccelerometerMounting;

    fn answered(sensor: NxtSensor, answer: &[u8]) -> Option<DigitalMeasurement> {
        let mut device = DigitalSensor::new(sensor).unwrap();
        let mut ring = [0xAA; 16];
        assert_eq!(device.read_ring(buffer_at(ring, 0)), None);
        ring[..answer.len()].copy_from_slice(answer);
        device.read_ring(buffer_at(ring, answer.len() as u8))
    }

    const fn buffer_at(ring: [u8; 16], end: u8) -> DigitalBuffer {
        DigitalBuffer { ring, end, pending_bytes: 0 }
    }

    fn accelerometer(forward: ForwardAxis) -> NxtSensor {
        NxtSensor::HtAccelerometer { forward, place: AccelerometerMounting::Centre }
    }

    #[test]
    fn an_acceleration_has_ten_bits_and_a_sign() {
        // x = -1 (ff 03), y = 200 (32 00), z = -200 (ce 00).
        let answer = [0xFF, 0x32, 0xCE, 0x03, 0x00, 0x00];
        for (axis, expected_g) in [
            (ForwardAxis::X, -1.0 / 200.0),
            (ForwardAxis::MinusX, 1.0 / 200.0),
            (ForwardAxis::Y, 1.0),
            (ForwardAxis::MinusY, -1.0),
            (ForwardAxis::Z, -1.0),
            (ForwardAxis::MinusZ, 1.0),
        ] {
            let Some(DigitalMeasurement::Acceleration(found)) = answered(accelerometer(axis), &answer) else {
                panic!("{axis:?}");
            };
            assert!((found.0 - expected_g * 9.80665).abs() < 1e-9, "{axis:?}");
        }
    }

    #[test]
    fn compass_range_and_temperature_are_decoded_as_documented() {
        let compass = answered(NxtSensor::HtCompass, &[0x87, 0x01]);
        assert_eq!(compass, Some(DigitalMeasurement::CompassDegrees(271.0)));
        assert_eq!(answered(NxtSensor::HtCompass, &[0xFF, 0x01]), None);
        let range = answered(NxtSensor::Ultrasonic, &[0x2A]);
        assert_eq!(range, Some(DigitalMeasurement::Range(Meters(0.42))));
        let nothing = answered(NxtSensor::Ultrasonic, &[0xFF]);
        assert_eq!(nothing, Some(DigitalMeasurement::NoEcho));
        // TMP275 datasheet, table 5: 19 00 is 25 degrees, e7 00 is -25, ff f0 is -0.0625.
        for (bytes, degrees) in [([0x19, 0x00], 25.0), ([0xE7, 0x00], -25.0), ([0xFF, 0xF0], -0.0625)] {
            let found = answered(NxtSensor::Temperature, &bytes);
            assert_eq!(found, Some(DigitalMeasurement::Temperature(Celsius(degrees))));
        }
    }

    #[test]
    fn a_reply_that_wraps_in_the_ring_is_complete() {
        let mut device = DigitalSensor::new(NxtSensor::HtCompass).unwrap();
        let mut ring = [0; 16];
        (ring[15], ring[0]) = (0x10, 0x01);
        assert_eq!(device.read_ring(buffer_at(ring, 15)), None);
        let found = device.read_ring(buffer_at(ring, 1));
        assert_eq!(found, Some(DigitalMeasurement::CompassDegrees(33.0)));
    }

    #[test]
    fn a_sensor_is_prepared_then_polled_at_its_period_with_one_request_at_a_time() {
        let mut device = DigitalSensor::new(NxtSensor::Ultrasonic).unwrap();
        device.restart(Timestamp::from_millis(1_000));
        let at = |device: &mut DigitalSensor, millis| device.write(3, Timestamp::from_millis(millis));
        let prepare = vec![0x80, 0x0F, 0x03, 0x03, 0x00, 0x02, 0x41, 0x02];
        assert_eq!(at(&mut device, 1_000), Some(prepare));
        assert_eq!(at(&mut device, 1_099), None);
        let request = vec![0x80, 0x0F, 0x03, 0x02, 0x01, 0x02, 0x42];
        assert_eq!(at(&mut device, 1_100), Some(request.clone()));
        assert_eq!(at(&mut device, 1_300), None);
        device.read_fetched(1, [7; 16]);
        assert_eq!(at(&mut device, 1_300), Some(request));
    }

    #[test]
    fn an_absent_sensor_is_polled_again_and_then_reported() {
        let mut device = DigitalSensor::new(NxtSensor::HtCompass).unwrap();
        let empty = buffer_at([0; 16], 0);
        device.read_ring(empty);
        for second in 0..10 {
            assert!(!device.is_silent());
            assert!(device.write(0, Timestamp::from_millis(1_000 * second)).is_some());
            for _ in 0..3 {
                assert_eq!(device.read_ring(empty), None);
            }
            assert_eq!(device.pending_since(), None);
        }
        assert!(device.is_silent());
    }

    #[test]
    fn a_dead_sensor_measures_nothing_at_any_ring_index() {
        for end in 0..16 {
            let mut device = DigitalSensor::new(accelerometer(ForwardAxis::X)).unwrap();
            device.restart(Timestamp::ZERO);
            device.read_ring(buffer_at([7; 16], end));
            for _ in 0..50 {
                assert_eq!(device.read_ring(buffer_at([7; 16], end)), None, "at {end}");
            }
            // Nor when the port is set up again.
            device.restart(Timestamp::from_millis(9_000));
            assert_eq!(device.read_ring(buffer_at([7; 16], end)), None, "at {end}");
            assert_eq!(device.read_ring(buffer_at([7; 16], end)), None, "at {end}");
        }
    }

    #[test]
    fn an_answer_that_is_still_on_the_bus_is_waited_for() {
        let mut device = DigitalSensor::new(NxtSensor::HtCompass).unwrap();
        device.read_ring(buffer_at([9; 16], 0));
        let half = DigitalBuffer { ring: [9; 16], end: 1, pending_bytes: 1 };
        assert_eq!(device.read_ring(half), None);
        let found = device.read_ring(buffer_at([9; 16], 2));
        assert_eq!(found, Some(DigitalMeasurement::CompassDegrees(27.0)));
    }

    #[test]
    fn a_firmware_that_writes_to_the_rings_start_is_recognized_and_then_accepted() {
        let mut device = DigitalSensor::new(NxtSensor::HtCompass).unwrap();
        let ring = [9; 16];
        device.read_ring(buffer_at(ring, 9));
        // Two, four or six bytes lead from 9 to 11, 13 or 15, never to 2.
        let found = Some(DigitalMeasurement::CompassDegrees(27.0));
        for _ in 0..5 {
            assert_eq!(device.read_ring(buffer_at(ring, 2)), found);
        }
    }
}
