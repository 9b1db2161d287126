//! What a telegram is: type, opcode and how long each command has to be.
//!
//! ```text
//! request  type opcode ..      type 00 direct, 01 system; 80 and 81 the same without an answer
//! answer   02 opcode status ..
//! ```
//! # Sources
//! LEGO Bluetooth developer kit, appendix 2 (direct commands), and the communication protocol (system commands).

use super::status;

/// The type of a request, with or without the bit for no answer.
const DIRECT: u8 = 0x00;
const SYSTEM: u8 = 0x01;
const NO_ANSWER: u8 = 0x80;
/// The type of an answer.
const ANSWER: u8 = 0x02;

/// Opcodes of direct commands.
pub(super) mod direct {
    pub(in super::super) const START_PROGRAM: u8 = 0x00;
    pub(in super::super) const STOP_PROGRAM: u8 = 0x01;
    pub(in super::super) const PLAY_SOUND: u8 = 0x02;
    pub(in super::super) const PLAY_TONE: u8 = 0x03;
    pub(in super::super) const SET_OUTPUT: u8 = 0x04;
    pub(in super::super) const SET_INPUT: u8 = 0x05;
    pub(in super::super) const GET_OUTPUT: u8 = 0x06;
    pub(in super::super) const GET_INPUT: u8 = 0x07;
    pub(in super::super) const RESET_SCALED: u8 = 0x08;
    pub(in super::super) const WRITE_MESSAGE: u8 = 0x09;
    pub(in super::super) const RESET_POSITION: u8 = 0x0A;
    pub(in super::super) const BATTERY: u8 = 0x0B;
    pub(in super::super) const STOP_SOUND: u8 = 0x0C;
    pub(in super::super) const KEEP_ALIVE: u8 = 0x0D;
    pub(in super::super) const BUS_STATUS: u8 = 0x0E;
    pub(in super::super) const BUS_WRITE: u8 = 0x0F;
    pub(in super::super) const BUS_READ: u8 = 0x10;
    pub(in super::super) const PROGRAM_NAME: u8 = 0x11;
    pub(in super::super) const READ_MESSAGE: u8 = 0x13;
}

/// Opcodes of system commands.
pub(super) mod system {
    pub(in super::super) const VERSIONS: u8 = 0x88;
    pub(in super::super) const READ_MAP: u8 = 0x94;
    pub(in super::super) const WRITE_MAP: u8 = 0x95;
    pub(in super::super) const SET_NAME: u8 = 0x98;
    pub(in super::super) const DEVICE_INFO: u8 = 0x9B;
    pub(in super::super) const POLL_LENGTH: u8 = 0xA1;
    pub(in super::super) const POLL: u8 = 0xA2;
}

/// Who is to follow a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CommandFamily {
    /// The virtual machine.
    Direct,
    /// The loader.
    System,
}

/// A request, taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TelegramRequest<'a> {
    /// Who is to follow it.
    pub(super) family: CommandFamily,
    /// Whether an answer is wanted.
    pub(super) is_answered: bool,
    /// What to do.
    pub(super) opcode: u8,
    /// Everything behind the opcode.
    pub(super) rest: &'a [u8],
}

impl<'a> TelegramRequest<'a> {
    /// Takes a telegram apart; `None` if it is no request.
    pub(super) fn parse(telegram: &'a [u8]) -> Option<Self> {
        let [kind, opcode, rest @ ..] = telegram else {
            return None;
        };
        let family = match kind & !NO_ANSWER {
            DIRECT => CommandFamily::Direct,
            SYSTEM => CommandFamily::System,
            _ => return None,
        };
        Some(Self { family, is_answered: kind & NO_ANSWER == 0, opcode: *opcode, rest })
    }

    /// The byte at `index` behind the opcode.
    pub(super) fn byte(&self, index: usize) -> Result<u8, u8> {
        self.rest.get(index).copied().ok_or(status::INSANE_PACKET)
    }

    /// The 16-bit word at `index` behind the opcode.
    pub(super) fn word(&self, index: usize) -> Result<u16, u8> {
        let bytes = self.rest.get(index..).and_then(<[u8]>::first_chunk);
        bytes.map(|bytes| u16::from_le_bytes(*bytes)).ok_or(status::INSANE_PACKET)
    }

    /// The 32-bit word at `index` behind the opcode.
    pub(super) fn long(&self, index: usize) -> Result<u32, u8> {
        let bytes = self.rest.get(index..).and_then(<[u8]>::first_chunk);
        bytes.map(|bytes| u32::from_le_bytes(*bytes)).ok_or(status::INSANE_PACKET)
    }

    /// `count` bytes at `index` behind the opcode.
    pub(super) fn bytes(&self, index: usize, count: usize) -> Result<&'a [u8], u8> {
        self.rest.get(index..index + count).ok_or(status::INSANE_PACKET)
    }
}

/// What an answer holds behind its status, or the status that says why there is none.
pub(super) type TelegramReply = Result<Vec<u8>, u8>;

/// The telegram of an answer.
pub(super) fn reply_telegram(opcode: u8, answer: &TelegramReply) -> Vec<u8> {
    match answer {
        Ok(body) => [&[ANSWER, opcode, status::OK], body.as_slice()].concat(),
        Err(status) => vec![ANSWER, opcode, *status],
    }
}

/// How long a request with this beginning is, in bytes; `None` if its command is unknown or its length is not known yet.
pub(super) fn request_length(bytes: &[u8]) -> Option<usize> {
    let request = TelegramRequest::parse(bytes)?;
    let counted = |index: usize| request.byte(index).ok().map(usize::from);
    match (request.family, request.opcode) {
        (CommandFamily::Direct, opcode) => match opcode {
            direct::STOP_PROGRAM | direct::BATTERY | direct::STOP_SOUND | direct::KEEP_ALIVE | direct::PROGRAM_NAME => {
                Some(2)
            }
            direct::GET_OUTPUT | direct::GET_INPUT | direct::RESET_SCALED | direct::BUS_STATUS | direct::BUS_READ => {
                Some(3)
            }
            direct::RESET_POSITION => Some(4),
            direct::SET_INPUT | direct::READ_MESSAGE => Some(5),
            direct::PLAY_TONE => Some(6),
            direct::SET_OUTPUT => Some(12),
            direct::START_PROGRAM => Some(22),
            direct::PLAY_SOUND => Some(23),
            direct::WRITE_MESSAGE => counted(1).map(|size| 4 + size),
            direct::BUS_WRITE => counted(1).map(|size| 5 + size),
            _ => None,
        },
        (CommandFamily::System, opcode) => match opcode {
            system::VERSIONS | system::DEVICE_INFO => Some(2),
            system::POLL_LENGTH => Some(3),
            system::POLL => Some(4),
            system::READ_MAP => Some(10),
            system::SET_NAME => Some(18),
            system::WRITE_MAP => request.word(6).ok().map(|size| 10 + usize::from(size)),
            _ => None,
        },
    }
}
