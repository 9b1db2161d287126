//! A brick that runs the direct commands of an EV3, as far as the station uses them, and the link to it in virtual time.
//!
//! Written from LEGO's firmware and communication developer kits, without our encoder: it takes the bytecodes of a telegram one by one.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// A sensor as the firmware sees it.
#[derive(Clone, Copy)]
pub(crate) struct PluggedSensor {
    pub(crate) kind: u8,
    pub(crate) mode: u8,
    pub(crate) values: [f32; 2],
}

/// The brick.
pub(crate) struct Ev3Double {
    /// What its counter of microseconds showed at host zero.
    pub(crate) start_micros: u64,
    /// By how much its clock runs faster than the host's.
    pub(crate) skew: f64,
    /// The counts of motors A to D at an instant of the host.
    pub(crate) counts: fn(f64) -> [i32; 4],
    pub(crate) sensors: [Option<PluggedSensor>; 4],
    /// Sensors that are not there make a command fail; otherwise they show no number.
    pub(crate) failure: FailureMode,
    /// Volts and amperes, and per cent; `None` if the firmware does not know the command.
    pub(crate) battery: Option<([f32; 2], u8)>,
    pub(crate) telegrams: usize,
    pub(crate) is_waiting: bool,
}

/// What a sensor does that is not there.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum FailureMode {
    ErrorReply,
    NanValue,
    /// It waits for the sensor, and answers only the next command.
    NoReply,
}

/// Counts of a robot that drives a gentle curve: 300 degrees per second left, 330 right; no step falls on a multiple of a millisecond.
pub(crate) fn curve(host_s: f64) -> [i32; 4] {
    let left = (300.0 * host_s + 0.27).floor() as i32;
    let right = (330.0 * host_s + 0.27).floor() as i32;
    [0, 1_000 + left, 2_000 + right, 0]
}

impl Default for Ev3Double {
    fn default() -> Self {
        let gyro = PluggedSensor { kind: 32, mode: 0, values: [12.0, 0.0] };
        Self {
            start_micros: 7_000_000,
            skew: 0.0,
            counts: curve,
            sensors: [None, Some(gyro), None, None],
            failure: FailureMode::NanValue,
            battery: Some(([7.5, 0.25], 80)),
            telegrams: 0,
            is_waiting: false,
        }
    }
}

impl Ev3Double {
    pub(crate) fn micros(&self, host: Timestamp<HostClock>) -> u32 {
        let ran = host.as_secs_f64() * 1e6 * (1.0 + self.skew);
        (self.start_micros + ran as u64) as u32
    }

    /// The host instant at which the clock showed this, near another.
    pub(crate) fn host_s(&self, micros: u32, near: Timestamp<HostClock>) -> f64 {
        let behind = self.micros(near).wrapping_sub(micros) as i32;
        near.as_secs_f64() - f64::from(behind) * 1e-6 / (1.0 + self.skew)
    }

    /// The brick's reply to a complete telegram that it handles at `now`.
    pub(crate) fn answer(&mut self, now: Timestamp<HostClock>, telegram: &[u8]) -> Option<Vec<u8>> {
        let length = usize::from(u16::from_le_bytes([telegram[0], telegram[1]]));
        assert_eq!(telegram.len(), length + 2, "one telegram: {telegram:02x?}");
        self.telegrams += 1;
        if telegram[4] == 0x81 {
            return None;
        }
        assert_eq!(telegram[4], 0x00, "a direct command with a reply");
        let globals = usize::from(u16::from_le_bytes([telegram[5], telegram[6]]) & 0x3FF);
        let mut memory = vec![0; globals];
        self.is_waiting = false;
        let is_done = self.run(now, &telegram[7..], &mut memory).is_some();
        if self.is_waiting {
            return None;
        }
        let mut reply = ((3 + globals) as u16).to_le_bytes().to_vec();
        reply.extend_from_slice(&telegram[2..4]);
        reply.push(if is_done { 0x02 } else { 0x04 });
        reply.extend(memory);
        Some(reply)
    }

    fn run(&mut self, now: Timestamp<HostClock>, mut code: &[u8], memory: &mut [u8]) -> Option<()> {
        while let Some((opcode, rest)) = code.split_first() {
            code = rest;
            match opcode {
                0x8F => store(memory, variable(&mut code), self.micros(now).to_le_bytes()),
                0xB3 => {
                    assert_eq!(constant(&mut code), 0, "layer");
                    let port = constant(&mut code) as usize;
                    let count = (self.counts)(now.as_secs_f64())[port];
                    store(memory, variable(&mut code), count.to_le_bytes());
                }
                0x81 => {
                    let ([volts, amperes], percent) = self.battery?;
                    match constant(&mut code) {
                        0x01 => store(memory, variable(&mut code), volts.to_le_bytes()),
                        0x02 => store(memory, variable(&mut code), amperes.to_le_bytes()),
                        0x12 => memory[variable(&mut code)] = percent,
                        other => panic!("subcommand {other:02x} of UI_READ"),
                    }
                }
                0x99 => {
                    assert_eq!(next_byte(&mut code), 0x1D, "READY_SI");
                    let values = self.select(&mut code);
                    self.is_waiting = values.is_none() && self.failure == FailureMode::NoReply;
                    let values = values?;
                    for value in values.iter().take(constant(&mut code) as usize) {
                        store(memory, variable(&mut code), value.to_le_bytes());
                    }
                }
                0x9D => {
                    let values = self.select(&mut code)?;
                    store(memory, variable(&mut code), values[0].to_le_bytes());
                }
                _ => panic!("bytecode {opcode:02x}"),
            }
        }
        Some(())
    }

    /// Layer, port, type, mode, and what the sensor shows; `None` ends the command with an error.
    fn select(&mut self, code: &mut &[u8]) -> Option<[f32; 2]> {
        assert_eq!(constant(code), 0, "layer");
        let (port, kind, mode) = (constant(code) as usize, constant(code), constant(code));
        let Some(sensor) = &mut self.sensors[port] else {
            return (self.failure == FailureMode::NanValue).then_some([f32::NAN; 2]);
        };
        if kind != 0 {
            assert_eq!(kind, i32::from(sensor.kind), "type at port {port}");
            sensor.mode = mode as u8;
        } else {
            assert_eq!(mode, -1, "the mode stays");
        }
        Some(sensor.values)
    }
}

fn next_byte(code: &mut &[u8]) -> u8 {
    let (first, rest) = code.split_first().expect("bytecodes go on");
    *code = rest;
    *first
}

fn constant(code: &mut &[u8]) -> i32 {
    match next_byte(code) {
        short @ 0x00..=0x1F => i32::from(short),
        negative @ 0x20..=0x3F => i32::from(negative) - 0x40,
        0x81 => i32::from(next_byte(code) as i8),
        other => panic!("constant {other:02x}"),
    }
}

fn variable(code: &mut &[u8]) -> usize {
    match next_byte(code) {
        short @ 0x60..=0x7F => usize::from(short - 0x60),
        other => panic!("global variable {other:02x}"),
    }
}

fn store(memory: &mut [u8], at: usize, bytes: [u8; 4]) {
    memory[at..at + 4].copy_from_slice(&bytes);
}

/// The way to the brick and back: it handles a telegram half a turn-around after it was sent; answers keep their order.
pub(crate) struct DelayLine {
    pub(crate) latency: TimeDelta,
    /// Answers on their way, with their arrival.
    in_flight: VecDeque<(Timestamp<HostClock>, Vec<u8>)>,
    /// Nothing moves between these instants.
    pub(crate) stall: Option<(Timestamp<HostClock>, Timestamp<HostClock>)>,
}

impl DelayLine {
    pub(crate) fn new(latency: TimeDelta) -> Self {
        Self { latency, in_flight: VecDeque::new(), stall: None }
    }

    /// A telegram of the station leaves.
    pub(crate) fn send(&mut self, brick: &mut Ev3Double, now: Timestamp<HostClock>, bytes: &[u8]) {
        let half = TimeDelta::from_nanos(self.latency.as_nanos() / 2);
        let handled = self.release_time(now + half);
        let Some(answer) = brick.answer(handled, bytes) else {
            return;
        };
        let arrival = self.release_time(handled + half);
        let arrival = self.in_flight.back().map_or(arrival, |last| last.0.max(arrival));
        self.in_flight.push_back((arrival, answer));
    }

    /// When the next answer arrives.
    pub(crate) fn next(&self) -> Option<Timestamp<HostClock>> {
        self.in_flight.front().map(|(arrival, _)| *arrival)
    }

    pub(crate) fn pop(&mut self) -> Option<Vec<u8>> {
        self.in_flight.pop_front().map(|(_, bytes)| bytes)
    }

    fn release_time(&self, instant: Timestamp<HostClock>) -> Timestamp<HostClock> {
        match self.stall {
            Some((from, until)) if from <= instant && instant < until => until,
            _ => instant,
        }
    }
}
