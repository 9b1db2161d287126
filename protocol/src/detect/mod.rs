//! Detects the protocol of a link from its bytes.
//!
//! Takes the bytes of some seconds, from any point of the stream; returns the protocol and the share of the bytes that
//! it explains. It helps people to set up a link: nothing is decoded, and the station never chooses a protocol by it.
//!
//! # Model
//! ```text
//! protocol     detected by
//! MAVLink 2    one frame with the right checksum
//! MAVLink 1    two such frames, or one that is more than half of the bytes
//! NMEA 0183    one sentence with the right checksum
//! EV3, NXT     lengths lead from telegram to telegram to the end
//! text         19 of 20 bytes printable ASCII or white space, and a line end
//! noise        none of these
//! ```
//! The first row that fits is the result. MAVLink 1 needs more because its start byte and checksum alone let noise
//! through: three false frames in 20 MB of random bytes.
//!
//! # Sources
//! MAVLink: [`crate::framing`]. NMEA 0183: `$`, text, `*` and the exclusive or of the text as two hexadecimal digits,
//! at most 82 characters. NXT and EV3: LEGO's developer kits, quoted in `telegrams.rs`.

mod protocol;
mod telegrams;

use posebridge_telemetry::Timestamp;

use self::protocol::UnitCounts;
pub use self::protocol::{Protocol, ProtocolDetection};
use crate::framing::{Framer, FramerConfig, FramerOutput, WireVersion};

/// Guesses the protocol of `bytes`, in the order in which they came; datagrams one behind the other.
pub fn recognise(bytes: &[u8]) -> ProtocolDetection {
    if bytes.is_empty() {
        return UnitCounts::default().detection(Protocol::NoData);
    }
    let (v1, v2) = mavlink(bytes);
    if v2.frames > 0 && v2.bytes >= v1.bytes {
        return v2.detection(Protocol::Mavlink2);
    }
    if v1.frames >= 2 || 2 * v1.bytes > bytes.len() {
        return v1.detection(Protocol::Mavlink1);
    }
    let nmea = nmea_sentences(bytes);
    if nmea.frames > 0 {
        return nmea.detection(Protocol::Nmea);
    }
    if let Some((protocol, tally)) = telegrams::detect_telegrams(bytes) {
        return tally.detection(protocol);
    }
    match text_lines(bytes) {
        Some(lines) => lines.detection(text_protocol(bytes)),
        None => UnitCounts::default().detection(Protocol::Unrecognized),
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

/// Sentences whose checksum matches.
fn nmea_sentences(bytes: &[u8]) -> UnitCounts {
    let mut tally = UnitCounts::default();
    for line in bytes.split(|byte| *byte == b'\n') {
        if let Some(length) = nmea_length(line) {
            tally.add(length);
        }
    }
    tally
}

/// The length of the sentence that ends the line, without the line end; noise may stand in front.
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

/// The lines, if nearly all bytes are text. What follows the last line end is not a whole line.
fn text_lines(bytes: &[u8]) -> Option<UnitCounts> {
    let is_text = |byte: &&u8| is_printable(**byte) || b"\r\n\t".contains(*byte);
    let text_bytes = bytes.iter().filter(is_text).count();
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let whole = bytes.iter().rposition(|byte| *byte == end)? + 1;
    (20 * text_bytes >= 19 * bytes.len())
        .then_some(UnitCounts { frames: memchr::memchr_iter(end, bytes).count(), bytes: whole })
}

/// Text, or an EV3 that announces itself by UDP in lines of text (LEGO MINDSTORMS EV3 Communication Developer Kit, WiFi).
fn text_protocol(bytes: &[u8]) -> Protocol {
    const ANNOUNCEMENT: &[u8] = b"Protocol: EV3";
    let announces = bytes.windows(ANNOUNCEMENT.len()).any(|window| window == ANNOUNCEMENT);
    if announces { Protocol::Ev3 } else { Protocol::Text }
}
