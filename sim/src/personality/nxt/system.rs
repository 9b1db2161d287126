//! The NXT's system commands: versions, name, IO maps, poll buffers.

use super::super::firmware_pass::FirmwarePass;
use super::direct::padded;
use super::telegram::{TelegramReply, TelegramRequest, system};
use super::{Nxt, io_map, status};

/// Protocol 1.124 and firmware 1.31, as an up-to-date brick answers: minor before major.
const VERSIONS: [u8; 4] = [124, 1, 31, 1];
/// LEGO's block of addresses, a made-up brick in it, and the byte that is always zero.
const ADDRESS: [u8; 7] = [0x00, 0x16, 0x53, 0x0B, 0x0E, 0x01, 0x00];
/// Signal strengths of four connections; the firmware reports none.
const SIGNALS: [u8; 4] = [0; 4];
/// Flash memory that is free, in bytes.
const FREE_FLASH: u32 = 29_704;
/// Bytes of the brick's name in a telegram, with its final zero.
const NAME_BYTES: usize = 15;
/// Bytes of an answer besides the data of an IO map.
const MAP_HEAD: usize = 9;

impl Nxt {
    /// Follows a system command.
    pub(super) fn system(&mut self, request: TelegramRequest<'_>, moment: &FirmwarePass<'_>) -> TelegramReply {
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
            system::READ_MAP => self.read_map(request, moment),
            system::WRITE_MAP => self.write_map(request),
            // Nothing ever waits in the buffers of USB and high-speed port.
            system::POLL_LENGTH | system::POLL => Ok(vec![poll_buffer(request)?, 0]),
            _ => Err(status::UNKNOWN_OPCODE),
        }
    }

    fn read_map(&mut self, request: TelegramRequest<'_>, moment: &FirmwarePass<'_>) -> TelegramReply {
        let (id, offset, count) = (request.long(0)?, request.word(4)?, request.word(6)?);
        let map = self.map(id, moment).ok_or(status::MODULE_NOT_FOUND)?;
        if usize::from(count) + MAP_HEAD > self.wire.longest() {
            return Err(status::OUT_OF_BOUNDS);
        }
        let from = usize::from(offset);
        let data = map.get(from..from + usize::from(count));
        let data = data.ok_or(status::OUT_OF_BOUNDS)?;
        Ok([&id.to_le_bytes()[..], &count.to_le_bytes(), data].concat())
    }

    fn write_map(&mut self, request: TelegramRequest<'_>) -> TelegramReply {
        let (id, offset, count) = (request.long(0)?, request.word(4)?, request.word(6)?);
        let data = request.bytes(8, usize::from(count))?;
        let from = usize::from(offset);
        let length = io_map::length(id).ok_or(status::MODULE_NOT_FOUND)?;
        if from + data.len() > length {
            return Err(status::OUT_OF_BOUNDS);
        }
        match id {
            io_map::OUTPUT => self.outputs.write(from, data),
            io_map::INPUT => self.inputs.write(from, data),
            // What these modules hold is the firmware's own.
            _ => {}
        }
        Ok([&id.to_le_bytes()[..], &count.to_le_bytes()].concat())
    }
}

/// Buffer 0 is that of USB, 1 that of the high-speed port.
fn poll_buffer(request: TelegramRequest<'_>) -> Result<u8, u8> {
    let buffer = request.byte(0)?;
    if buffer > 1 {
        return Err(status::OUT_OF_RANGE);
    }
    Ok(buffer)
}
