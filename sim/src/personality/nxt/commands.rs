//! The NXT's commands: direct ones (programs, motors, sensors, I2C, mailboxes, battery), system ones (versions, name, poll buffers), and
//! the IO maps: the memory of the firmware's modules, which a station may read and in part write.
//!
//! ```text
//! Output   00020001   3 x 32 bytes        Input   00030001   4 x 20 bytes
//! LowSpeed 000B0001   4 x 19 bytes, ..    Command 00010001   name, tick at 20, state of the program at 28
//! ```
//! # Sources
//! LEGO's NXT firmware, the structs of the modules' IO maps.

use super::super::lego::FirmwarePass;
use super::outputs::{OutputCommand, TachoCounter};
use super::telegram::{TelegramReply, TelegramRequest, direct, padded, status, system};
use super::{MAX_MESSAGE_BYTES, Nxt, PATH_PROGRAM, SLEEP_TIMEOUT, low_speed};

const FILE_NAME_BYTES: usize = 20;
/// Protocol 1.124 and firmware 1.31, as an up-to-date brick answers: minor before major.
const VERSIONS: [u8; 4] = [124, 1, 31, 1];
/// LEGO's block of addresses with an invented number; the last byte is always zero.
const ADDRESS: [u8; 7] = [0x00, 0x16, 0x53, 0x0B, 0x0E, 0x01, 0x00];
/// Of four connections; the firmware reports none.
const SIGNALS: [u8; 4] = [0; 4];
const FREE_FLASH: u32 = 29_704;
/// In a telegram, with the final zero.
const NAME_BYTES: usize = 15;
/// Bytes of a reply besides the data of an IO map.
const MAP_HEAD: usize = 9;
const COMMAND: u32 = 0x0001_0001;
const OUTPUT: u32 = 0x0002_0001;
const INPUT: u32 = 0x0003_0001;
const LOW_SPEED: u32 = 0x000B_0001;
/// The Command module before the memory pool of the programs, which must not be read.
const COMMAND_BYTES: usize = 52;
const TICK_AT: usize = 20;
const PROGRAM_STATE_AT: usize = 28;
const FILE_NAME_AT: usize = 32;
const FORMAT: &[u8] = b"MindstormsNXT";
const RUNNING: u8 = 2;

impl Nxt {
    pub(super) fn direct(&mut self, request: TelegramRequest<'_>, pass: &mut FirmwarePass<'_>) -> TelegramReply {
        match request.opcode {
            direct::START_PROGRAM => self.start_program(request, pass),
            direct::STOP_PROGRAM => {
                self.program.as_ref().ok_or(status::NO_ACTIVE_PROGRAM)?;
                self.stop();
                Ok(Vec::new())
            }
            direct::PROGRAM_NAME => {
                let name = self.program.as_ref().ok_or(status::NO_ACTIVE_PROGRAM)?;
                Ok(padded(name, FILE_NAME_BYTES))
            }
            // The loudspeaker is not simulated.
            direct::PLAY_SOUND => request.bytes(0, 2).map(|_| Vec::new()),
            direct::PLAY_TONE => request.bytes(0, 4).map(|_| Vec::new()),
            direct::STOP_SOUND => Ok(Vec::new()),
            direct::SET_OUTPUT => self.set_output(request),
            direct::GET_OUTPUT => self.outputs.state(request.byte(0)?),
            direct::RESET_POSITION => {
                let is_rotation = request.byte(1)? == 0;
                let counter = if is_rotation { TachoCounter::Rotation } else { TachoCounter::Block };
                self.outputs.zero(request.byte(0)?, counter)
            }
            direct::SET_INPUT => self.inputs.set(request.byte(0)?, request.byte(1)?, request.byte(2)?),
            direct::GET_INPUT => self.inputs.values(request.byte(0)?),
            direct::RESET_SCALED => self.inputs.values(request.byte(0)?).map(|_| Vec::new()),
            direct::BUS_STATUS | direct::BUS_WRITE | direct::BUS_READ => self.bus(request),
            direct::WRITE_MESSAGE => self.write_message(request),
            direct::READ_MESSAGE => self.read_message(request),
            direct::BATTERY => {
                let millivolts = (pass.battery_v * 1e3).round() as u16;
                Ok(millivolts.to_le_bytes().to_vec())
            }
            direct::KEEP_ALIVE => {
                self.awake_since = pass.sim_time;
                let limit_ms = (SLEEP_TIMEOUT.as_nanos() / 1_000_000) as u32;
                Ok(limit_ms.to_le_bytes().to_vec())
            }
            _ => Err(status::UNKNOWN_OPCODE),
        }
    }

    fn start_program(&mut self, request: TelegramRequest<'_>, pass: &mut FirmwarePass<'_>) -> TelegramReply {
        let name = request.rest.split(|byte| *byte == 0).next();
        match name {
            Some(name) if name.eq_ignore_ascii_case(PATH_PROGRAM) => {
                self.start(PATH_PROGRAM, pass);
                Ok(Vec::new())
            }
            Some(_) | None => Err(status::REQUEST_FAILED),
        }
    }

    fn set_output(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        let order = OutputCommand {
            power: request.byte(1)? as i8,
            mode: request.byte(2)?,
            regulation: request.byte(3)?,
            turn_ratio: request.byte(4)? as i8,
            run_state: request.byte(5)?,
            limit: request.long(6)?,
        };
        self.outputs.command(request.byte(0)?, order)
    }

    fn bus(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        let port = request.byte(0)?;
        let sensor = self.inputs.on_bus(port)?;
        match request.opcode {
            direct::BUS_WRITE => {
                let reply_length = usize::from(request.byte(2)?);
                let bytes = request.bytes(3, usize::from(request.byte(1)?))?;
                self.low_speed.write(port, sensor, bytes, reply_length)?;
                Ok(Vec::new())
            }
            direct::BUS_STATUS => Ok(vec![self.low_speed.ready(port)? as u8]),
            _ => {
                let bytes = self.low_speed.read(port)?;
                let count = bytes.len() as u8;
                Ok([vec![count], padded(&bytes, low_speed::MAX_MESSAGE_BYTES)].concat())
            }
        }
    }

    fn write_message(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        if self.program.is_none() {
            return Err(status::NO_ACTIVE_PROGRAM);
        }
        let size = request.byte(1)?;
        let message = request.bytes(2, usize::from(size))?;
        self.mailboxes.write(request.byte(0)?, size, message)?;
        Ok(Vec::new())
    }

    fn read_message(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        if self.program.is_none() {
            return Err(status::NO_ACTIVE_PROGRAM);
        }
        let (remote, local, is_taken) = (request.byte(0)?, request.byte(1)?, request.byte(2)? != 0);
        let message = self.mailboxes.oldest(remote)?;
        let head = vec![local, message.len() as u8];
        let answer = [head, padded(message, MAX_MESSAGE_BYTES)].concat();
        if is_taken {
            drop(self.mailboxes.pop(remote));
        }
        Ok(answer)
    }

    pub(super) fn system(&mut self, request: TelegramRequest<'_>, pass: &FirmwarePass<'_>) -> TelegramReply {
        match request.opcode {
            system::VERSIONS => Ok(VERSIONS.to_vec()),
            system::DEVICE_INFO => {
                let name = padded(&self.name, NAME_BYTES);
                let flash = FREE_FLASH.to_le_bytes();
                Ok([&name[..], &ADDRESS, &SIGNALS, &flash].concat())
            }
            system::SET_NAME => {
                let name = request.rest.split(|byte| *byte == 0).next();
                let name = name.filter(|name| (1..NAME_BYTES).contains(&name.len()));
                self.name = name.ok_or(status::OUT_OF_RANGE)?.to_vec();
                Ok(Vec::new())
            }
            system::READ_MAP => self.read_map(request, pass),
            system::WRITE_MAP => self.write_map(request, pass),
            // Nothing ever waits in the buffers of USB (0) and high-speed port (1).
            system::POLL_LENGTH | system::POLL => match request.byte(0)? {
                buffer @ 0..=1 => Ok(vec![buffer, 0]),
                _ => Err(status::OUT_OF_RANGE),
            },
            _ => Err(status::UNKNOWN_OPCODE),
        }
    }

    fn read_map(&mut self, request: TelegramRequest<'_>, pass: &FirmwarePass<'_>) -> TelegramReply {
        let (id, offset, count) = (request.long(0)?, request.word(4)?, request.word(6)?);
        let map = self.map(id, pass).ok_or(status::MODULE_NOT_FOUND)?;
        if usize::from(count) + MAP_HEAD > self.wire.longest {
            return Err(status::OUT_OF_BOUNDS);
        }
        let from = usize::from(offset);
        let data = map.get(from..from + usize::from(count));
        let data = data.ok_or(status::OUT_OF_BOUNDS)?;
        Ok([&id.to_le_bytes()[..], &count.to_le_bytes(), data].concat())
    }

    fn write_map(&mut self, request: TelegramRequest<'_>, pass: &FirmwarePass<'_>) -> TelegramReply {
        let (id, offset, count) = (request.long(0)?, request.word(4)?, request.word(6)?);
        let data = request.bytes(8, usize::from(count))?;
        let from = usize::from(offset);
        let map = self.map(id, pass).ok_or(status::MODULE_NOT_FOUND)?;
        if from + data.len() > map.len() {
            return Err(status::OUT_OF_BOUNDS);
        }
        match id {
            OUTPUT => self.outputs.write(from, data),
            INPUT => self.inputs.write(from, data),
            // What these modules hold is the firmware's own.
            _ => {}
        }
        Ok([&id.to_le_bytes()[..], &count.to_le_bytes()].concat())
    }

    fn map(&self, id: u32, pass: &FirmwarePass<'_>) -> Option<Vec<u8>> {
        match id {
            COMMAND => Some(self.command_map(pass)),
            OUTPUT => Some(self.outputs.map()),
            INPUT => Some(self.inputs.map()),
            LOW_SPEED => Some(self.low_speed.map()),
            _ => None,
        }
    }

    fn command_map(&self, pass: &FirmwarePass<'_>) -> Vec<u8> {
        let mut map = vec![0; COMMAND_BYTES];
        let mut put = |offset: usize, bytes: &[u8]| {
            for (byte, value) in map.iter_mut().skip(offset).zip(bytes) {
                *byte = *value;
            }
        };
        put(0, FORMAT);
        put(TICK_AT, &pass.tick_ms().to_le_bytes());
        if let Some(name) = &self.program {
            put(PROGRAM_STATE_AT, &[RUNNING]);
            put(FILE_NAME_AT, name);
        }
        map
    }
}
