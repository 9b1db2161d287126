//! Telegrams to the brick: direct commands that read it, and the estimate for a mailbox (SPEC.md, "Link" and "Questions").
//!
//! # Sources
//! LEGO MINDSTORMS EV3 Firmware Developer Kit (bytecodes, parameter encoding) and Communication Developer Kit, section 3
//! (WRITEMAILBOX) and 4; `bytecodes.h` and `c_com.h` of the firmware lms2012; captures by QUT's robotics toolbox for the
//! EV3, in which the length of the name counts its final zero.

use super::settings::{MotorPort, SensorPort};
use crate::bricks::codec::estimate_bytes;
use crate::message::PlanarPose;

/// opTIMER_READ_US: microseconds of the brick's clock, 32 bits.
const TIMER_READ_US: u8 = 0x8F;
/// opOUTPUT_GET_COUNT: layer, port, count.
const OUTPUT_GET_COUNT: u8 = 0xB3;
/// opUI_READ: subcommand, value.
const UI_READ: u8 = 0x81;
/// Its subcommands: volts and amperes as float, and a byte of per cent.
const GET_VBATT: u8 = 0x01;
const GET_IBATT: u8 = 0x02;
const GET_LBATT: u8 = 0x12;
const INPUT_DEVICE: u8 = 0x99;
/// Its subcommand READY_SI: layer, port, type, mode, number of values, values as float.
const READY_SI: u8 = 0x1D;
/// opINPUT_READSI: layer, port, type, mode, value as float.
const INPUT_READ_SI: u8 = 0x9D;
/// The brick itself, not one that is daisy-chained to it.
const LAYER: u8 = 0;
const ANY_TYPE: u8 = 0;
/// Mode -1: the present one.
const SAME_MODE: u8 = 0x3F;
/// A constant that needs a byte of its own.
const LONG_CONSTANT: u8 = 0x81;
/// The largest constant in one byte.
const SHORT_CONSTANT: u8 = 31;
/// A global variable in one byte.
const GLOBAL: u8 = 0x60;
/// Bytes of every value that is read here, but for the percentage of the battery.
const VALUE_BYTES: u8 = 4;
const WITH_REPLY: u8 = 0x00;
/// Counter, type and header.
const HEAD_BYTES: usize = 5;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SensorMode {
    pub(super) kind: u8,
    pub(super) mode: u8,
}

/// A direct command under construction. Each read value takes the next bytes of the reply.
#[derive(Clone, Debug, Default)]
pub(super) struct DirectCommand {
    bytecodes: Vec<u8>,
    /// At most 31.
    globals: u8,
}

impl DirectCommand {
    pub(super) fn read_clock(&mut self) {
        let global = self.global();
        self.bytecodes.extend([TIMER_READ_US, global]);
    }

    pub(super) fn read_count(&mut self, port: MotorPort) {
        let global = self.global();
        self.bytecodes.extend([OUTPUT_GET_COUNT, LAYER, port.number(), global]);
    }

    /// Reads volts and amperes of the battery, f32 each, and its percentage in one byte.
    pub(super) fn read_battery(&mut self) {
        for subcommand in [GET_VBATT, GET_IBATT] {
            let global = self.global();
            self.bytecodes.extend([UI_READ, subcommand, global]);
        }
        self.bytecodes.extend([UI_READ, GET_LBATT, GLOBAL | self.globals]);
        self.globals += 1;
    }

    /// Reads values of a sensor, f32 each, once it is ready. `mode` is set before; `None` keeps the present one.
    pub(super) fn wait_for(&mut self, port: SensorPort, mode: Option<SensorMode>, values: u8) {
        self.bytecodes.extend([INPUT_DEVICE, READY_SI, LAYER, port.number()]);
        match mode {
            Some(SensorMode { kind, mode }) => {
                self.constant(kind);
                self.constant(mode);
            }
            None => self.bytecodes.extend([ANY_TYPE, SAME_MODE]),
        }
        self.constant(values);
        for _ in 0..values {
            let global = self.global();
            self.bytecodes.push(global);
        }
    }

    /// Reads the present value of a sensor, f32; NaN if there is none.
    pub(super) fn read_value(&mut self, port: SensorPort) {
        let global = self.global();
        self.bytecodes.extend([INPUT_READ_SI, LAYER, port.number(), ANY_TYPE, SAME_MODE, global]);
    }

    /// Length of the reply after its type.
    pub(super) const fn reply_bytes(&self) -> usize {
        self.globals as usize
    }

    pub(super) fn telegram(&self, counter: u16) -> Vec<u8> {
        let length = (HEAD_BYTES + self.bytecodes.len()) as u16;
        let mut telegram = Vec::with_capacity(usize::from(length) + 2);
        telegram.extend(length.to_le_bytes());
        telegram.extend(counter.to_le_bytes());
        telegram.push(WITH_REPLY);
        telegram.extend(u16::from(self.globals).to_le_bytes());
        telegram.extend(&self.bytecodes);
        telegram
    }

    fn global(&mut self) -> u8 {
        let global = GLOBAL | self.globals;
        self.globals += VALUE_BYTES;
        global
    }

    fn constant(&mut self, value: u8) {
        if value > SHORT_CONSTANT {
            self.bytecodes.push(LONG_CONSTANT);
        }
        self.bytecodes.push(value);
    }
}

/// System command without reply, WRITEMAILBOX.
const WRITE_MAILBOX: [u8; 2] = [0x81, 0x9E];
/// Counter, type, command, length of the name, length of the payload.
const MAILBOX_HEAD_BYTES: usize = 7;
/// The length of a name has one byte and includes the final zero.
const MAX_NAME_BYTES: usize = 254;

/// Writes to a mailbox. A name that is too long is cut.
pub(super) fn encode_mailbox_write(counter: u16, name: &str, payload: &[u8]) -> Vec<u8> {
    let name = name.as_bytes();
    let name = name.get(..MAX_NAME_BYTES).unwrap_or(name);
    let length = (MAILBOX_HEAD_BYTES + name.len() + 1 + payload.len()) as u16;
    let mut telegram = Vec::with_capacity(usize::from(length) + 2);
    telegram.extend(length.to_le_bytes());
    telegram.extend(counter.to_le_bytes());
    telegram.extend(WRITE_MAILBOX);
    telegram.push((name.len() + 1) as u8);
    telegram.extend(name);
    telegram.push(0);
    telegram.extend((payload.len() as u16).to_le_bytes());
    telegram.extend(payload);
    telegram
}

/// The payload of an estimate; `None` if a number in it is not finite.
pub(super) fn encode_estimate(pose: &PlanarPose, sequence: u16) -> Option<[u8; 24]> {
    let tick_ms = (pose.stamp.as_micros() / 1_000) as u32;
    let sigma_m = pose.position_sigma_m();
    let numbers = [pose.pose.x.0, pose.pose.y.0, pose.pose.heading.rad(), sigma_m];
    numbers.iter().all(|number| number.is_finite()).then(|| estimate_bytes(tick_ms, pose, sigma_m, sequence))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Written by ev3-dc 0.9.10.2: clock, counts of B and C, and a gyro at port 2 in its mode 1.
    const CLOCK_COUNTS_GYRO: [u8; 26] = [
        0x18, 0x00, 0x01, 0x00, 0x00, 0x10, 0x00, 0x8F, 0x60, 0xB3, 0x00, 0x01, 0x64, 0xB3, 0x00, 0x02, 0x68, 0x99,
        0x1D, 0x00, 0x01, 0x81, 0x20, 0x01, 0x01, 0x6C,
    ];

    #[test]
    fn the_telegram_of_clock_counts_and_gyro_is_that_of_another_implementation() {
        let mut command = DirectCommand::default();
        command.read_clock();
        command.read_count(MotorPort::B);
        command.read_count(MotorPort::C);
        let gyro_rate = SensorMode { kind: 32, mode: 1 };
        command.wait_for(SensorPort::P2, Some(gyro_rate), 1);
        assert_eq!(command.telegram(1), CLOCK_COUNTS_GYRO);
        assert_eq!(command.reply_bytes(), 16);
    }

    #[test]
    fn the_bytecodes_of_the_battery_are_those_of_another_implementation() {
        let mut command = DirectCommand::default();
        command.read_battery();
        // ev3-dc 0.9.10.2, `EV3.battery`, which asks for 9 global bytes.
        let expected = [0x0E, 0, 7, 0, 0, 9, 0, 0x81, 0x01, 0x60, 0x81, 0x02, 0x64, 0x81, 0x12, 0x68];
        assert_eq!(command.telegram(7), expected);
        assert_eq!(command.reply_bytes(), 9);
    }

    #[test]
    fn small_types_take_one_byte_and_two_values_two_globals() {
        let mut command = DirectCommand::default();
        command.wait_for(SensorPort::P4, Some(SensorMode { kind: 30, mode: 0 }), 2);
        command.read_value(SensorPort::P1);
        let expected = [0x99, 0x1D, 0x00, 0x03, 0x1E, 0x00, 0x02, 0x60, 0x64, 0x9D, 0x00, 0x00, 0x00, 0x3F, 0x68];
        assert_eq!(command.telegram(0x1234)[7..], expected);
        assert_eq!(command.telegram(0x1234)[..7], [20, 0, 0x34, 0x12, 0, 12, 0]);
    }

    #[test]
    fn a_message_for_a_mailbox_is_that_of_a_capture() {
        let captured = include_bytes!("../../../tests/data/ev3_mailbox.bin");
        assert_eq!(encode_mailbox_write(1, "abc", b"hello!\0"), captured);
    }
}
