//! Detects the protocol of a link from its bytes, to help people to set up a link; the station never chooses by it.
//!
//! ```text
//! MAVLink 2    one frame with the right checksum
//! MAVLink 1    two such frames, or one that is more than half of the bytes: noise gives three in 20 MB
//! NMEA 0183    one sentence with the right checksum
//! rosserial    two messages with the right checksums, or one that is more than half of the bytes
//! micro-ROS    the same
//! EV3, NXT     lengths lead from telegram to telegram to the end
//! text         19 of 20 bytes printable ASCII or white space, and a line end
//! columns      text, and most of its lines have the same number of numbers ([`text_columns`](crate::text_columns))
//! ```
//! The first row that fits is the result. Only telegrams that a brick sends are considered.
//!
//! # Sources
//! NMEA 0183: `$`, text, `*` and the exclusive or of the text as two hexadecimal digits, at most 82 characters. LEGO
//! MINDSTORMS NXT Bluetooth Developer Kit, appendix 1 (length) and 2 (reply 02, opcode, status; message write 80 09); EV3
//! Communication Developer Kit, section 3 (length, message counter, reply type; system command 81 9E writes a mailbox).

mod ros;
mod unit_counts;

use posebridge_telemetry::Timestamp;

use crate::bricks::nxt::NxtStatus;
use crate::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use crate::text_columns::ColumnTable;
use unit_counts::UnitCounts;

/// Detects the protocol of `bytes`, in the order of their arrival; datagrams are concatenated.
pub fn recognise(bytes: &[u8]) -> ProtocolDetection {
    if bytes.is_empty() {
        return ProtocolDetection::new(Protocol::NoData, UnitCounts::default());
    }
    let (v1, v2) = mavlink(bytes);
    if v2.frames > 0 && v2.bytes >= v1.bytes {
        return ProtocolDetection::new(Protocol::Mavlink2, v2);
    }
    if v1.frames >= 2 || 2 * v1.bytes > bytes.len() {
        return ProtocolDetection::new(Protocol::Mavlink1, v1);
    }
    let nmea = nmea_sentences(bytes);
    if nmea.frames > 0 {
        return ProtocolDetection::new(Protocol::Nmea, nmea);
    }
    for (protocol, tally) in [(Protocol::Rosserial, ros::rosserial(bytes)), (Protocol::MicroRos, ros::micro_ros(bytes))]
    {
        if tally.frames >= 2 || 2 * tally.bytes > bytes.len() {
            return ProtocolDetection::new(protocol, tally);
        }
    }
    if let Some((protocol, tally)) = detect_telegrams(bytes) {
        return ProtocolDetection::new(protocol, tally);
    }
    match text_lines(bytes) {
        Some(lines) => ProtocolDetection::new(text_protocol(bytes), lines),
        None => ProtocolDetection::new(Protocol::Unrecognized, UnitCounts::default()),
    }
}

/// Frames of MAVLink 1 and of MAVLink 2 whose checksum matches.
fn mavlink(bytes: &[u8]) -> (UnitCounts, UnitCounts) {
    let mut framer = Framer::new(FramerConfig { accept_v1: true, ..FramerConfig::default() });
    let (mut v1, mut v2) = (UnitCounts::default(), UnitCounts::default());
    framer.push(Timestamp::ZERO, bytes, &mut |found| {
        if let FramerOutput::Frame(frame) = found {
            match frame.version {
                WireVersion::V1 => v1.add(frame.raw.len()),
                WireVersion::V2 => v2.add(frame.raw.len()),
            }
        }
    });
    (v1, v2)
}

fn nmea_sentences(bytes: &[u8]) -> UnitCounts {
    let mut tally = UnitCounts::default();
    for line in bytes.split(|byte| *byte == b'\n') {
        if let Some(length) = nmea_length(line) {
            tally.add(length);
        }
    }
    tally
}

/// The length of the sentence that ends the line, without the line end; noise may come before it.
fn nmea_length(line: &[u8]) -> Option<usize> {
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    let start = line.iter().rposition(|byte| *byte == b'$' || *byte == b'!')?;
    let (text, digits) = line.get(start + 1..)?.split_last_chunk::<2>()?;
    let text = text.strip_suffix(b"*")?;
    let digits = std::str::from_utf8(digits).ok()?;
    let expected = u8::from_str_radix(digits, 16).ok()?;
    let found = text.iter().fold(0, |sum, byte| sum ^ byte);
    let is_plausible = text.len() >= 5 && text.iter().all(|byte| is_printable(*byte));
    (found == expected && is_plausible).then_some(line.len() - start)
}

const fn is_printable(byte: u8) -> bool {
    matches!(byte, 0x20..=0x7E)
}

/// The lines, if nearly all bytes are text. The rest after the last line end does not count.
fn text_lines(bytes: &[u8]) -> Option<UnitCounts> {
    let is_text = |byte: &&u8| is_printable(**byte) || b"\r\n\t".contains(*byte);
    let text_bytes = bytes.iter().filter(is_text).count();
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let complete_bytes = bytes.iter().rposition(|byte| *byte == end)? + 1;
    (20 * text_bytes >= 19 * bytes.len())
        .then_some(UnitCounts { frames: memchr::memchr_iter(end, bytes).count(), bytes: complete_bytes })
}

/// Text, with numbers in columns or not, or the announcement of an EV3 by UDP in lines of text (LEGO MINDSTORMS EV3 Communication Developer Kit, WiFi).
fn text_protocol(bytes: &[u8]) -> Protocol {
    const ANNOUNCEMENT: &[u8] = b"Protocol: EV3";
    let announces = bytes.windows(ANNOUNCEMENT.len()).any(|window| window == ANNOUNCEMENT);
    match ColumnTable::read(bytes) {
        _ if announces => Protocol::Ev3,
        Some(_) => Protocol::Columns,
        None => Protocol::Text,
    }
}

/// A protocol that a link may carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Protocol {
    Mavlink2,
    Mavlink1,
    Nxt,
    /// EV3 telegrams, or the brick's announcement by UDP.
    Ev3,
    Nmea,
    /// ROS 1 on a board. Not decoded.
    Rosserial,
    /// ROS 2 on a board. Not decoded.
    MicroRos,
    Text,
    /// Text with numbers in columns.
    Columns,
    /// Another protocol, or the wrong baud rate.
    Unrecognized,
    NoData,
}

impl Protocol {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mavlink2 => "MAVLink 2",
            Self::Mavlink1 => "MAVLink 1",
            Self::Nxt => "NXT telegrams",
            Self::Ev3 => "EV3 telegrams",
            Self::Nmea => "NMEA 0183",
            Self::Rosserial => "rosserial",
            Self::MicroRos => "micro-ROS",
            Self::Text => "lines of text",
            Self::Columns => "numbers in columns",
            Self::Unrecognized => "noise",
            Self::NoData => "silence",
        }
    }

    /// The row of [`crate::bricks::BRICK_PROTOCOLS`] that decodes it; `None` if there is none.
    pub const fn codec(self) -> Option<&'static str> {
        match self {
            Self::Mavlink2 | Self::Mavlink1 => Some("mavlink"),
            Self::Nxt => Some("nxt"),
            Self::Ev3 => Some("ev3"),
            Self::Text => Some("line"),
            Self::Columns => Some("columns"),
            Self::Nmea | Self::Rosserial | Self::MicroRos | Self::Unrecognized | Self::NoData => None,
        }
    }

    /// Whether its frames have checksums, so that a few of them are proof.
    pub const fn is_checked(self) -> bool {
        matches!(self, Self::Mavlink2 | Self::Mavlink1 | Self::Nmea | Self::Rosserial | Self::MicroRos)
    }

    pub const fn is_known(self) -> bool {
        !matches!(self, Self::Unrecognized | Self::NoData)
    }
}

/// The result of a detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProtocolDetection {
    pub protocol: Protocol,
    /// Whole frames, telegrams, sentences or lines; 0 for noise and silence.
    pub frames: usize,
    /// Bytes of these, among all bytes.
    pub frame_bytes: usize,
}

impl ProtocolDetection {
    const fn new(protocol: Protocol, units: UnitCounts) -> Self {
        Self { protocol, frames: units.frames, frame_bytes: units.bytes }
    }
}

/// Longest telegram that an NXT sends: its buffer for Bluetooth.
const NXT_MAX_BYTES: usize = 128;
/// Longest that an EV3 sends: its buffer for replies.
const EV3_MAX_BYTES: usize = 1024;
/// Largest offset of the first complete telegram, the EV3's longest.
const MAX_SKIPPED: usize = EV3_MAX_BYTES + LENGTH_BYTES;
const LENGTH_BYTES: usize = 2;
/// Least number of telegrams in a row when they do not start at the first byte.
const MIN_TELEGRAMS: usize = 3;

/// Whether bytes, without their length, are a telegram from a brick of this kind.
type TelegramPredicate = fn(&[u8]) -> bool;

/// The predicates exclude each other.
const TELEGRAM_KINDS: &[(Protocol, TelegramPredicate)] = &[(Protocol::Ev3, is_of_ev3), (Protocol::Nxt, is_of_nxt)];

fn detect_telegrams(bytes: &[u8]) -> Option<(Protocol, UnitCounts)> {
    for skipped in 0..bytes.len().min(MAX_SKIPPED) {
        let rest = bytes.get(skipped..).unwrap_or_default();
        for (protocol, is_telegram) in TELEGRAM_KINDS {
            if let Some(tally) = count_chain(rest, *is_telegram)
                && (tally.frames >= MIN_TELEGRAMS || tally.bytes == bytes.len())
            {
                return Some((*protocol, tally));
            }
        }
    }
    None
}

/// The telegrams, if they follow each other until fewer bytes remain than the last one's length.
fn count_chain(mut rest: &[u8], is_telegram: TelegramPredicate) -> Option<UnitCounts> {
    let mut tally = UnitCounts::default();
    while let Some((length, behind)) = rest.split_first_chunk::<LENGTH_BYTES>() {
        let length = usize::from(u16::from_le_bytes(*length));
        let Some((telegram, behind)) = behind.split_at_checked(length) else {
            // The last one is cut off by the end of the listening; a length that no telegram has is none.
            return (length <= EV3_MAX_BYTES).then_some(tally);
        };
        if !is_telegram(telegram) {
            return None;
        }
        tally.add(LENGTH_BYTES + length);
        rest = behind;
    }
    Some(tally)
}

/// A reply with a known status, or a message from a program on the brick.
fn is_of_nxt(telegram: &[u8]) -> bool {
    if telegram.len() > NXT_MAX_BYTES {
        return false;
    }
    match telegram {
        [0x02, opcode, status, ..] => is_nxt_opcode(*opcode) && NxtStatus(*status).is_known(),
        [0x80, 0x09, inbox, size, message @ ..] => *inbox < 20 && usize::from(*size) == message.len(),
        _ => false,
    }
}

/// Direct commands 00 to 13, system commands 80 to A2.
const fn is_nxt_opcode(opcode: u8) -> bool {
    matches!(opcode, 0x00..=0x13 | 0x80..=0xA2)
}

/// A reply after its counter, or a mailbox write by a program on the brick.
fn is_of_ev3(telegram: &[u8]) -> bool {
    match telegram {
        // Replies to direct and to system commands, with and without an error.
        [_, _, 0x02..=0x05, ..] => telegram.len() <= EV3_MAX_BYTES,
        [_, _, 0x81, 0x9E, rest @ ..] => is_mailbox(rest),
        _ => false,
    }
}

/// Length of the name, name, length of the payload, payload.
fn is_mailbox(rest: &[u8]) -> bool {
    let Some((name_length, rest)) = rest.split_first() else {
        return false;
    };
    let Some((_, payload)) = rest.split_at_checked(usize::from(*name_length)) else {
        return false;
    };
    payload
        .split_first_chunk::<LENGTH_BYTES>()
        .is_some_and(|(length, payload)| usize::from(u16::from_le_bytes(*length)) == payload.len())
}
