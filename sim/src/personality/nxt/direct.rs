//! The NXT's direct commands: programs, motors, sensors, I2C, mailboxes, battery.

use super::super::firmware_pass::FirmwarePass;
use super::outputs::{OutputCommand, TachoCounter};
use super::telegram::{TelegramReply, TelegramRequest, direct};
use super::{Nxt, PATH_PROGRAM, SLEEP_TIMEOUT, low_speed, mailboxes, status};

/// Bytes of a file name in a telegram.
const NAME_BYTES: usize = 20;

impl Nxt {
    /// Follows a direct command.
    pub(super) fn direct(&mut self, request: TelegramRequest<'_>, moment: &mut FirmwarePass<'_>) -> TelegramReply {
        match request.opcode {
            direct::START_PROGRAM => self.start_program(request, moment),
            direct::STOP_PROGRAM => self.stop_program(),
            direct::PROGRAM_NAME => self.program_name(),
            // The loudspeaker is not simulated.
            direct::PLAY_SOUND => request.bytes(0, 2).map(|_| Vec::new()),
            direct::PLAY_TONE => request.bytes(0, 4).map(|_| Vec::new()),
            direct::STOP_SOUND => Ok(Vec::new()),
            direct::SET_OUTPUT => self.set_output(request),
            direct::GET_OUTPUT => {
                let state = self.outputs.state(request.byte(0)?);
                state.ok_or(status::OUT_OF_RANGE)
            }
            direct::RESET_POSITION => self.reset_position(request),
            direct::SET_INPUT => self.set_input(request),
            direct::GET_INPUT => {
                let values = self.inputs.values(request.byte(0)?);
                values.ok_or(status::OUT_OF_RANGE)
            }
            direct::RESET_SCALED => {
                let is_there = self.inputs.has(request.byte(0)?);
                is_there.then(Vec::new).ok_or(status::OUT_OF_RANGE)
            }
            direct::BUS_STATUS | direct::BUS_WRITE | direct::BUS_READ => self.bus(request),
            direct::WRITE_MESSAGE => self.write_message(request),
            direct::READ_MESSAGE => self.read_message(request),
            direct::BATTERY => {
                let millivolts = (moment.battery_v * 1e3).round() as u16;
                Ok(millivolts.to_le_bytes().to_vec())
            }
            direct::KEEP_ALIVE => {
                self.awake_since = moment.sim_time;
                let limit_ms = (SLEEP_TIMEOUT.as_nanos() / 1_000_000) as u32;
                Ok(limit_ms.to_le_bytes().to_vec())
            }
            _ => Err(status::UNKNOWN_OPCODE),
        }
    }

    fn start_program(&mut self, request: TelegramRequest<'_>, moment: &mut FirmwarePass<'_>) -> TelegramReply {
        let name = request.rest.split(|byte| *byte == 0).next();
        match name {
            Some(name) if name.eq_ignore_ascii_case(PATH_PROGRAM) => {
                self.start(PATH_PROGRAM, moment);
                Ok(Vec::new())
            }
            Some(_) | None => Err(status::REQUEST_FAILED),
        }
    }

    fn stop_program(&mut self) -> TelegramReply {
        if self.program.is_none() {
            return Err(status::NO_ACTIVE_PROGRAM);
        }
        self.stop();
        Ok(Vec::new())
    }

    fn program_name(&self) -> TelegramReply {
        let name = self.program.as_ref().ok_or(status::NO_ACTIVE_PROGRAM)?;
        Ok(padded(name, NAME_BYTES))
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
        let is_done = self.outputs.command(request.byte(0)?, order);
        is_done.then(Vec::new).ok_or(status::OUT_OF_RANGE)
    }

    fn reset_position(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        let counter = match request.byte(1)? {
            0 => TachoCounter::Rotation,
            _ => TachoCounter::Block,
        };
        let is_done = self.outputs.zero(request.byte(0)?, counter);
        is_done.then(Vec::new).ok_or(status::OUT_OF_RANGE)
    }

    fn set_input(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        let (port, kind, mode) = (request.byte(0)?, request.byte(1)?, request.byte(2)?);
        let is_done = self.inputs.set(port, kind, mode);
        is_done.then(Vec::new).ok_or(status::OUT_OF_RANGE)
    }

    fn bus(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        let port = request.byte(0)?;
        if !self.inputs.has(port) {
            return Err(status::OUT_OF_RANGE);
        }
        let sensor = self.inputs.on_bus(port);
        let sensor = sensor.ok_or(status::CHANNEL_NOT_CONFIGURED)?;
        match request.opcode {
            direct::BUS_WRITE => {
                let wanted = usize::from(request.byte(2)?);
                let bytes = request.bytes(3, usize::from(request.byte(1)?))?;
                self.low_speed.write(port, sensor, bytes, wanted)?;
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
        let answer = [head, padded(message, mailboxes::MAX_MESSAGE_BYTES)].concat();
        if is_taken {
            drop(self.mailboxes.pop(remote));
        }
        Ok(answer)
    }
}

/// With zeros behind it up to a length.
pub(super) fn padded(bytes: &[u8], length: usize) -> Vec<u8> {
    let zeros = std::iter::repeat(&0);
    bytes.iter().chain(zeros).take(length).copied().collect()
}
