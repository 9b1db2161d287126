//! The station's requests, and which reply matches which.

use super::io_maps::{FirmwareModule, IoMapWindow, parse_reply};
use super::settings::MotorPort;
use super::telegram::{self, NxtReply, bytes_at, opcode};

/// A question that waits for its reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum NxtRequest {
    /// For the firmware's version; it is used for nothing else, so its reply proves that every earlier request is answered or lost.
    SyncBarrier,
    /// For a part of an IO map.
    IoMap(IoMapWindow),
    /// For one motor.
    Motor(MotorPort),
    /// For one analog port, 0 to 3.
    Analog(u8),
    /// For what a digital port's sensor has answered.
    Digital(u8),
    /// That a port be set up for a sensor of this type.
    SetUp { port: u8, kind: u8 },
    /// Puts this telegram into a mailbox, to learn whether a program reads it.
    Mailbox(Vec<u8>),
}

impl NxtRequest {
    pub(super) fn telegram(&self) -> Vec<u8> {
        match self {
            Self::SyncBarrier => telegram::firmware_version(),
            Self::IoMap(window) => telegram::read_io_map(window.module.id(), window.offset, window.length),
            Self::Motor(port) => telegram::get_output_state(*port),
            Self::Analog(port) => telegram::get_input_values(*port),
            Self::Digital(port) => telegram::ls_read(*port),
            Self::SetUp { port, kind } => telegram::set_input_mode(*port, *kind),
            Self::Mailbox(telegram) => telegram.clone(),
        }
    }

    const fn opcode(&self) -> u8 {
        match self {
            Self::SyncBarrier => opcode::FIRMWARE_VERSION,
            Self::IoMap(_) => opcode::READ_IO_MAP,
            Self::Motor(_) => opcode::GET_OUTPUT_STATE,
            Self::Analog(_) => opcode::GET_INPUT_VALUES,
            Self::Digital(_) => opcode::LS_READ,
            Self::SetUp { .. } => opcode::SET_INPUT_MODE,
            Self::Mailbox(_) => opcode::MESSAGE_WRITE,
        }
    }

    /// Whether a reply can be to this question: by its opcode, and by the port or the map where the reply repeats it. A refusal need
    /// not repeat anything.
    pub(super) fn matches_reply(&self, reply: &NxtReply<'_>) -> bool {
        if reply.opcode != self.opcode() {
            return false;
        }
        let repeated = bytes_at::<1>(reply.values, 0);
        match self {
            _ if reply.status.0 != 0 => true,
            Self::IoMap(window) => parse_reply(reply)
                .is_some_and(|(module, length, _)| module == window.module.id() && length == window.length),
            Self::Motor(port) => repeated == Some([port.number()]),
            Self::Analog(port) => repeated == Some([*port]),
            Self::SyncBarrier | Self::Digital(_) | Self::SetUp { .. } | Self::Mailbox(_) => true,
        }
    }

    /// True if it is asked in every round, or nearly.
    pub(super) const fn is_for_data(&self) -> bool {
        match self {
            Self::IoMap(window) => !matches!(window.module, FirmwareModule::Command),
            Self::Motor(_) | Self::Analog(_) | Self::Digital(_) => true,
            Self::SyncBarrier | Self::SetUp { .. } | Self::Mailbox(_) => false,
        }
    }
}
