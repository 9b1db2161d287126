//! Telegrams to and from the brick, without state: commands, and replies with their status (SPEC.md, "Framing").
//!
//! # Sources
//! LEGO MINDSTORMS NXT Bluetooth Developer Kit, appendix 1 (file errors) and appendix 2 (direct commands, "Error message
//! back to the host"); where the firmware's source differs from them, the firmware.

use super::settings::MotorPort;

const DIRECT: u8 = 0x00;
const SYSTEM: u8 = 0x01;
/// Bit that requests no reply.
const NO_REPLY: u8 = 0x80;
pub(super) const REPLY: u8 = 0x02;
/// Type of a direct command without reply: how a brick writes to another's mailbox.
pub(super) const DIRECT_NO_REPLY: u8 = DIRECT | NO_REPLY;
/// Bytes of a file name in a command, zeros behind it.
const FILE_NAME_BYTES: usize = 20;
pub(super) const PREFIX_BYTES: usize = 2;
/// The brick's Bluetooth buffer: no telegram is longer.
pub(super) const MAX_TELEGRAM_BYTES: usize = 128;
/// Most bytes of a message besides its final zero.
const MAX_MESSAGE_BYTES: usize = 58;

pub(super) mod opcode {
    pub(in super::super) const START_PROGRAM: u8 = 0x00;
    pub(in super::super) const STOP_PROGRAM: u8 = 0x01;
    pub(in super::super) const SET_OUTPUT_STATE: u8 = 0x04;
    pub(in super::super) const SET_INPUT_MODE: u8 = 0x05;
    pub(in super::super) const GET_OUTPUT_STATE: u8 = 0x06;
    pub(in super::super) const GET_INPUT_VALUES: u8 = 0x07;
    pub(in super::super) const MESSAGE_WRITE: u8 = 0x09;
    pub(in super::super) const GET_BATTERY_LEVEL: u8 = 0x0B;
    pub(in super::super) const KEEP_ALIVE: u8 = 0x0D;
    pub(in super::super) const LS_WRITE: u8 = 0x0F;
    pub(in super::super) const LS_READ: u8 = 0x10;
    pub(in super::super) const FIRMWARE_VERSION: u8 = 0x88;
    pub(in super::super) const READ_IO_MAP: u8 = 0x94;
}

/// Whether a command requests a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplyRequest {
    Required,
    NotRequired,
}

impl ReplyRequest {
    const fn bit(self) -> u8 {
        match self {
            Self::Required => 0,
            Self::NotRequired => NO_REPLY,
        }
    }
}

/// A motor command (SETOUTPUTSTATE).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputState {
    /// `None` is all three.
    pub port: Option<MotorPort>,
    /// Per cent of the battery, negative backwards.
    pub power: i8,
    /// Bit 0 on, bit 1 brake between pulses, bit 2 regulated.
    pub mode: u8,
    /// 0 none, 1 speed, 2 two motors in step.
    pub regulation: u8,
    /// For two motors in step, per cent to one side.
    pub turn_ratio: i8,
    /// 00 idle, 10 ramp up, 20 run, 40 ramp down.
    pub run_state: u8,
    /// Degrees after which to stop; 0 is unlimited.
    pub tacho_limit: u32,
}

impl OutputState {
    /// Runs a motor at this power with its speed regulated, until the next command.
    pub const fn run(port: MotorPort, power: i8) -> Self {
        Self { port: Some(port), power, mode: 0b111, regulation: 1, turn_ratio: 0, run_state: 0x20, tacho_limit: 0 }
    }

    pub const fn coast() -> Self {
        Self { port: None, power: 0, mode: 0, regulation: 0, turn_ratio: 0, run_state: 0, tacho_limit: 0 }
    }
}

/// SETOUTPUTSTATE: drives a motor.
pub fn set_output_state(state: &OutputState, answer: ReplyRequest) -> Vec<u8> {
    let port = state.port.map_or(0xFF, MotorPort::number);
    let mut telegram = vec![
        DIRECT | answer.bit(),
        opcode::SET_OUTPUT_STATE,
        port,
        state.power.cast_unsigned(),
        state.mode,
        state.regulation,
        state.turn_ratio.cast_unsigned(),
        state.run_state,
    ];
    telegram.extend_from_slice(&state.tacho_limit.to_le_bytes());
    telegram
}

/// STARTPROGRAM: starts a program by its file name, cut to 19 bytes.
pub fn start_program(file_name: &str, answer: ReplyRequest) -> Vec<u8> {
    let mut telegram = vec![DIRECT | answer.bit(), opcode::START_PROGRAM];
    telegram.extend(file_name.bytes().take(FILE_NAME_BYTES - 1));
    telegram.resize(2 + FILE_NAME_BYTES, 0);
    telegram
}

/// STOPPROGRAM: stops the running program.
pub fn stop_program(answer: ReplyRequest) -> Vec<u8> {
    vec![DIRECT | answer.bit(), opcode::STOP_PROGRAM]
}

/// MESSAGEWRITE: a message into a mailbox, with its final zero; `None` if it is too long for one.
pub fn message_write(mailbox: u8, message: &[u8], answer: ReplyRequest) -> Option<Vec<u8>> {
    if message.len() > MAX_MESSAGE_BYTES {
        return None;
    }
    let size = message.len() as u8 + 1;
    let mut telegram = vec![DIRECT | answer.bit(), opcode::MESSAGE_WRITE, mailbox, size];
    telegram.extend_from_slice(message);
    telegram.push(0);
    Some(telegram)
}

pub(super) fn set_input_mode(port: u8, kind: u8) -> Vec<u8> {
    // Mode 00: the raw value, as it is.
    vec![DIRECT, opcode::SET_INPUT_MODE, port, kind, 0]
}

pub(super) fn get_output_state(port: MotorPort) -> Vec<u8> {
    vec![DIRECT, opcode::GET_OUTPUT_STATE, port.number()]
}

pub(super) fn get_input_values(port: u8) -> Vec<u8> {
    vec![DIRECT, opcode::GET_INPUT_VALUES, port]
}

/// Writes `bytes` to a sensor and reads `answer_bytes` from it; at most 16 each.
pub(super) fn ls_write(port: u8, bytes: &[u8], answer_bytes: u8) -> Vec<u8> {
    let length = bytes.len() as u8;
    let mut telegram = vec![DIRECT_NO_REPLY, opcode::LS_WRITE, port, length, answer_bytes];
    telegram.extend_from_slice(bytes);
    telegram
}

pub(super) fn ls_read(port: u8) -> Vec<u8> {
    vec![DIRECT, opcode::LS_READ, port]
}

pub(super) fn keep_alive() -> Vec<u8> {
    vec![DIRECT_NO_REPLY, opcode::KEEP_ALIVE]
}

/// The reply has millivolts, 16 bits.
pub(super) fn get_battery_level() -> Vec<u8> {
    vec![DIRECT, opcode::GET_BATTERY_LEVEL]
}

pub(super) fn firmware_version() -> Vec<u8> {
    vec![SYSTEM, opcode::FIRMWARE_VERSION]
}

pub(super) fn read_io_map(module: u32, offset: u16, length: u16) -> Vec<u8> {
    let mut telegram = vec![SYSTEM, opcode::READ_IO_MAP];
    telegram.extend_from_slice(&module.to_le_bytes());
    telegram.extend_from_slice(&offset.to_le_bytes());
    telegram.extend_from_slice(&length.to_le_bytes());
    telegram
}

/// A telegram with its length before it, as on the link.
pub fn framed(telegram: &[u8]) -> Vec<u8> {
    let mut bytes = (telegram.len() as u16).to_le_bytes().to_vec();
    bytes.extend_from_slice(telegram);
    bytes
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NxtReply<'a> {
    pub(super) opcode: u8,
    pub(super) status: NxtStatus,
    pub(super) values: &'a [u8],
}

impl<'a> NxtReply<'a> {
    pub(super) const fn parse(telegram: &'a [u8]) -> Option<Self> {
        match telegram {
            [REPLY, opcode, status, values @ ..] => Some(Self { opcode: *opcode, status: NxtStatus(*status), values }),
            _ => None,
        }
    }
}

/// Length of a successful reply to this opcode, except IO maps, whose length was requested; `None` for opcodes that are
/// never requested.
pub(super) const fn reply_bytes(opcode: u8) -> Option<usize> {
    match opcode {
        opcode::START_PROGRAM
        | opcode::STOP_PROGRAM
        | opcode::SET_OUTPUT_STATE
        | opcode::SET_INPUT_MODE
        | opcode::MESSAGE_WRITE
        | opcode::LS_WRITE => Some(3),
        opcode::GET_BATTERY_LEVEL => Some(5),
        opcode::GET_OUTPUT_STATE => Some(25),
        opcode::GET_INPUT_VALUES => Some(16),
        opcode::KEEP_ALIVE | opcode::FIRMWARE_VERSION => Some(7),
        opcode::LS_READ => Some(20),
        _ => None,
    }
}

pub(super) fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// The status of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NxtStatus(pub u8);

impl NxtStatus {
    pub const OK: Self = Self(0x00);
    /// The sensor has not answered yet.
    pub const PENDING: Self = Self(0x20);
    /// Mailboxes are not read: no program runs.
    pub const NO_PROGRAM: Self = Self(0xEC);

    /// Whether the firmware has such a status.
    pub const fn is_known(self) -> bool {
        matches!(
            self.0,
            0x00 | 0x20 | 0x40 | 0x81..=0x93 | 0xBD..=0xC0 | 0xDD..=0xE0 | 0xEC..=0xF0 | 0xFB | 0xFF
        )
    }

    /// The meaning and a remedy; lower case, no full stop.
    pub const fn meaning(self) -> &'static str {
        match self.0 {
            0x00 => "it was done",
            0x20 => "the sensor is still busy with the last question",
            0x40 => "the mailbox is empty",
            0x81..=0x90 | 0x92..=0x93 => "the file or module is not there or in use",
            0x91 => "more bytes were asked for than this firmware has",
            0xBD => "the brick could not do it",
            0xBE => "this firmware does not know the command",
            0xBF => "the brick found no sense in the command",
            0xC0 => "a value of the command is out of range",
            0xDD => "the sensor does not answer: is it plugged in, and is it the configured one?",
            0xDE => "the brick's buffer is full",
            0xDF => "there is no such channel",
            0xE0 => "the port is not set up for such a sensor, or is busy",
            0xEC => "no program runs on the brick",
            0xED => "the size is not allowed",
            0xEE => "there is no such mailbox",
            0xEF => "there is no such field",
            0xF0 => "there is no such port",
            0xFB => "the brick has no memory left",
            0xFF => "the brick does not accept the arguments",
            _ => "the brick gives a reason that nobody knows",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_known_status_has_its_own_text() {
        let unknown = NxtStatus(0x01).meaning();
        for byte in 0..=u8::MAX {
            let status = NxtStatus(byte);
            assert_eq!(status.is_known(), status.meaning() != unknown, "{byte:02x}");
        }
        assert!(NxtStatus::NO_PROGRAM.meaning().contains("no program"));
        assert!(NxtStatus(0xDD).meaning().contains("plugged in"));
        assert!(NxtStatus(0xBE).meaning().contains("does not know"));
    }
}
