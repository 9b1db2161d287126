//! The telegram format: type, opcode and the length of each command.
//!
//! ```text
//! request  type opcode ..      type 00 direct, 01 system; 80 and 81 the same without an answer
//! answer   02 opcode status ..
//! ```
//! # Sources
//! LEGO Bluetooth developer kit, appendix 2 (direct commands), and the communication protocol (system commands).

/// The type of a request, with or without the bit for no answer.
const DIRECT: u8 = 0x00;
const SYSTEM: u8 = 0x01;
const NO_ANSWER: u8 = 0x80;
const ANSWER: u8 = 0x02;

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

pub(super) mod system {
    pub(in super::super) const VERSIONS: u8 = 0x88;
    pub(in super::super) const READ_MAP: u8 = 0x94;
    pub(in super::super) const WRITE_MAP: u8 = 0x95;
    pub(in super::super) const SET_NAME: u8 = 0x98;
    pub(in super::super) const DEVICE_INFO: u8 = 0x9B;
    pub(in super::super) const POLL_LENGTH: u8 = 0xA1;
    pub(in super::super) const POLL: u8 = 0xA2;
}

/// The status bytes of the firmware, as its protocol documents list them.
pub(super) mod status {
    pub(in super::super) const OK: u8 = 0x00;
    /// The I2C transaction is not complete.
    pub(in super::super) const PENDING: u8 = 0x20;
    pub(in super::super) const MAILBOX_EMPTY: u8 = 0x40;
    pub(in super::super) const MODULE_NOT_FOUND: u8 = 0x90;
    /// Outside the IO map, or longer than a telegram.
    pub(in super::super) const OUT_OF_BOUNDS: u8 = 0x91;
    /// For instance there is no program of that name.
    pub(in super::super) const REQUEST_FAILED: u8 = 0xBD;
    pub(in super::super) const UNKNOWN_OPCODE: u8 = 0xBE;
    /// The length does not match the command.
    pub(in super::super) const INSANE_PACKET: u8 = 0xBF;
    pub(in super::super) const OUT_OF_RANGE: u8 = 0xC0;
    pub(in super::super) const BUS_ERROR: u8 = 0xDD;
    /// The port is not set up for I2C.
    pub(in super::super) const CHANNEL_NOT_CONFIGURED: u8 = 0xE0;
    pub(in super::super) const NO_ACTIVE_PROGRAM: u8 = 0xEC;
    pub(in super::super) const ILLEGAL_SIZE: u8 = 0xED;
    pub(in super::super) const ILLEGAL_MAILBOX: u8 = 0xEE;
}

/// The part of the firmware that executes a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CommandFamily {
    /// The virtual machine.
    Direct,
    /// The loader.
    System,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TelegramRequest<'a> {
    pub(super) family: CommandFamily,
    pub(super) is_answered: bool,
    pub(super) opcode: u8,
    pub(super) rest: &'a [u8],
}

impl<'a> TelegramRequest<'a> {
    /// `None` if the telegram is not a request.
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

    pub(super) fn byte(&self, index: usize) -> Result<u8, u8> {
        self.rest.get(index).copied().ok_or(status::INSANE_PACKET)
    }

    fn array<const N: usize>(&self, index: usize) -> Result<[u8; N], u8> {
        self.rest.get(index..).and_then(<[u8]>::first_chunk).copied().ok_or(status::INSANE_PACKET)
    }

    pub(super) fn word(&self, index: usize) -> Result<u16, u8> {
        self.array(index).map(u16::from_le_bytes)
    }

    pub(super) fn long(&self, index: usize) -> Result<u32, u8> {
        self.array(index).map(u32::from_le_bytes)
    }

    pub(super) fn bytes(&self, index: usize, count: usize) -> Result<&'a [u8], u8> {
        self.rest.get(index..index + count).ok_or(status::INSANE_PACKET)
    }
}

/// The data of a reply after its status, or an error status.
pub(super) type TelegramReply = Result<Vec<u8>, u8>;

pub(super) fn reply_telegram(opcode: u8, answer: &TelegramReply) -> Vec<u8> {
    match answer {
        Ok(body) => [&[ANSWER, opcode, status::OK], body.as_slice()].concat(),
        Err(status) => vec![ANSWER, opcode, *status],
    }
}

/// Length in bytes of a request with this beginning; `None` if its command is unknown or its length is not known yet.
pub(super) fn request_length(bytes: &[u8]) -> Option<usize> {
    use CommandFamily::{Direct, System};
    let request = TelegramRequest::parse(bytes)?;
    let counted = || request.byte(1).ok().map(usize::from);
    let length = match (request.family, request.opcode) {
        (
            Direct,
            direct::STOP_PROGRAM | direct::BATTERY | direct::STOP_SOUND | direct::KEEP_ALIVE | direct::PROGRAM_NAME,
        )
        | (System, system::VERSIONS | system::DEVICE_INFO) => 2,
        (
            Direct,
            direct::GET_OUTPUT | direct::GET_INPUT | direct::RESET_SCALED | direct::BUS_STATUS | direct::BUS_READ,
        )
        | (System, system::POLL_LENGTH) => 3,
        (Direct, direct::RESET_POSITION) | (System, system::POLL) => 4,
        (Direct, direct::SET_INPUT | direct::READ_MESSAGE) => 5,
        (Direct, direct::PLAY_TONE) => 6,
        (System, system::READ_MAP) => 10,
        (Direct, direct::SET_OUTPUT) => 12,
        (System, system::SET_NAME) => 18,
        (Direct, direct::START_PROGRAM) => 22,
        (Direct, direct::PLAY_SOUND) => 23,
        (Direct, direct::WRITE_MESSAGE) => 4 + counted()?,
        (Direct, direct::BUS_WRITE) => 5 + counted()?,
        (System, system::WRITE_MAP) => 10 + usize::from(request.word(6).ok()?),
        _ => return None,
    };
    Some(length)
}

pub(super) fn padded(bytes: &[u8], length: usize) -> Vec<u8> {
    let zeros = std::iter::repeat(&0);
    bytes.iter().chain(zeros).take(length).copied().collect()
}
