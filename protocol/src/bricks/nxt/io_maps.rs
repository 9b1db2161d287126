//! The brick's IO maps: its firmware's own variables (SPEC.md, "What is asked"). One telegram reads up to 119 bytes.
//!
//! # Sources
//! The firmware's interface files c_output.iom, c_input.iom, c_lowspeed.iom, c_cmd.iom; its loader limits a read over
//! Bluetooth to 128 - 9 bytes and over USB to 64 - 9.

use super::telegram::{NxtReply, bytes_at, opcode};

/// A part of a module's map. Outstanding reads of one module must have different lengths, because a reply repeats the
/// module and the length, but not the offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct IoMapWindow {
    pub(super) module: FirmwareModule,
    pub(super) offset: u16,
    pub(super) length: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FirmwareModule {
    Command,
    Output,
    Input,
    LowSpeed,
}

impl FirmwareModule {
    pub(super) const fn id(self) -> u32 {
        match self {
            Self::Command => 0x0001_0001,
            Self::Output => 0x0002_0001,
            Self::Input => 0x0003_0001,
            Self::LowSpeed => 0x000B_0001,
        }
    }
}

pub(super) const TICK: IoMapWindow = IoMapWindow { module: FirmwareModule::Command, offset: 20, length: 4 };

const MOTOR_BYTES: u16 = 32;
const INPUT_BYTES: u16 = 20;
const BUFFER_BYTES: u16 = 19;
/// Bytes of one motor up to its overload flag, the last documented one.
const MOTOR_USED_BYTES: u16 = 28;
/// Bytes of a port up to the last that is used, @16.
const PORT_USED_BYTES: u16 = 17;

pub(super) const ALL_MOTORS: IoMapWindow =
    IoMapWindow { module: FirmwareModule::Output, offset: 0, length: 3 * MOTOR_BYTES };
pub(super) const ALL_INPUTS: IoMapWindow =
    IoMapWindow { module: FirmwareModule::Input, offset: 0, length: 4 * INPUT_BYTES };
pub(super) const ALL_BUFFERS: IoMapWindow =
    IoMapWindow { module: FirmwareModule::LowSpeed, offset: 0, length: 4 * BUFFER_BYTES };

/// Two neighbouring motors, the first completely and the second's count: 36 of the 55 bytes that every firmware allows.
pub(super) const fn motor_pair(first: u8) -> IoMapWindow {
    IoMapWindow { module: FirmwareModule::Output, offset: MOTOR_BYTES * first as u16, length: MOTOR_BYTES + 4 }
}

pub(super) const fn motor(index: u8) -> IoMapWindow {
    IoMapWindow {
        module: FirmwareModule::Output,
        offset: MOTOR_BYTES * index as u16,
        length: MOTOR_USED_BYTES - index as u16,
    }
}

pub(super) const fn input(port: u8) -> IoMapWindow {
    IoMapWindow {
        module: FirmwareModule::Input,
        offset: INPUT_BYTES * port as u16,
        length: PORT_USED_BYTES + port as u16,
    }
}

pub(super) const fn buffer(port: u8) -> IoMapWindow {
    IoMapWindow {
        module: FirmwareModule::LowSpeed,
        offset: BUFFER_BYTES * port as u16,
        length: BUFFER_BYTES + port as u16,
    }
}

/// Bytes of a map in a reply, and their position in the module.
#[derive(Clone, Copy, Debug)]
pub(super) struct IoMapData<'a> {
    window: IoMapWindow,
    bytes: &'a [u8],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AnalogInput {
    /// Of the ten-bit converter.
    pub(super) raw: u16,
    /// The type to which the port is set up.
    pub(super) kind: u8,
    /// False until the first conversion after the set-up.
    pub(super) is_valid: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DigitalBuffer {
    pub(super) ring: [u8; 16],
    pub(super) end: u8,
    /// Bytes of an answer that are still on the bus; zero also for a sensor that failed.
    pub(super) pending_bytes: u8,
}

/// The id and the length that a reply to READ IO MAP repeats, and the data.
pub(super) fn parse_reply<'a>(reply: &NxtReply<'a>) -> Option<(u32, u16, &'a [u8])> {
    if reply.opcode != opcode::READ_IO_MAP {
        return None;
    }
    let module = u32::from_le_bytes(bytes_at(reply.values, 0)?);
    let length = u16::from_le_bytes(bytes_at(reply.values, 4)?);
    let data = reply.values.get(6..)?;
    (data.len() == usize::from(length)).then_some((module, length, data))
}

impl<'a> IoMapData<'a> {
    /// The data of the window that was requested.
    pub(super) fn from_reply(window: IoMapWindow, reply: &NxtReply<'a>) -> Option<Self> {
        let (module, length, bytes) = parse_reply(reply)?;
        let fits = module == window.module.id() && length == window.length;
        fits.then_some(Self { window, bytes })
    }

    fn bytes_at<const N: usize>(&self, in_module: u16) -> Option<[u8; N]> {
        let inside = in_module.checked_sub(self.window.offset)?;
        bytes_at(self.bytes, usize::from(inside))
    }

    pub(super) fn tick_millis(&self) -> Option<u32> {
        self.bytes_at(TICK.offset).map(u32::from_le_bytes)
    }

    /// In degrees; `None` if the window does not contain it.
    pub(super) fn count(&self, motor: u8) -> Option<i32> {
        self.bytes_at(MOTOR_BYTES * u16::from(motor)).map(i32::from_le_bytes)
    }

    pub(super) fn input(&self, port: u8) -> Option<AnalogInput> {
        let base = INPUT_BYTES * u16::from(port);
        Some(AnalogInput {
            raw: u16::from_le_bytes(self.bytes_at(base + 2)?),
            kind: u8::from_le_bytes(self.bytes_at(base + 8)?),
            is_valid: self.bytes_at(base + 16)? == [0],
        })
    }

    /// A digital port's receive buffer; `None` if the window does not contain it.
    pub(super) fn buffer(&self, port: u8) -> Option<DigitalBuffer> {
        let base = BUFFER_BYTES * u16::from(port);
        let [end, _, to_come] = self.bytes_at(base + 16)?;
        Some(DigitalBuffer { ring: self.bytes_at(base)?, end, pending_bytes: to_come })
    }
}

impl DigitalBuffer {
    /// The last `N` received bytes. The firmware continues round the ring, or restarts at its beginning: in both cases
    /// they are before the write index.
    pub(super) fn last_bytes<const N: usize>(&self) -> [u8; N] {
        let size = self.ring.len();
        let first = usize::from(self.end) % size + size - N % size;
        std::array::from_fn(|index| self.ring[(first + index) % size])
    }
}
