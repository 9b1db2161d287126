//! Guesses from bytes which protocol a link carries.
//!
//! Gets what was heard on a link for some seconds, from any point of its stream; gives the protocol and how much of what
//! was heard it explains. It serves people who set up a link, not the pipeline: nothing is decoded, and the station never
//! chooses a protocol by it.
//!
//! # Model
//! ```text
//! protocol     believed when
//! MAVLink 2    one frame with the right checksum
//! MAVLink 1    two such frames, or one that is more than half of what was heard
//! NMEA 0183    one sentence with the right checksum
//! EV3, NXT     lengths lead from telegram to telegram to the end
//! text         19 of 20 bytes printable ASCII or white space, and a line end
//! noise        none of these
//! ```
//! The first row that fits is taken. MAVLink 1 needs more because its start byte and checksum alone let noise through:
//! three false frames in 20 MB of random bytes.
//!
//! # Sources
//! MAVLink: [`crate::framing`]. NMEA 0183: `$`, text, `*` and the exclusive or of the text as two hexadecimal digits, at
//! most 82 characters. NXT and EV3: LEGO's developer kits, quoted in `telegrams.rs`.

mod telegrams;

use posebridge_telemetry::Stamp;

use crate::framing::{Scanned, Scanner, ScannerConfig, WireVersion};

/// What a link may carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Protocol {
    /// MAVLink 2.
    Mavlink2,
    /// MAVLink 1.
    Mavlink1,
    /// NXT telegrams over Bluetooth, each behind its length.
    Nxt,
    /// EV3 telegrams, or the brick's announcement of itself by UDP.
    Ev3,
    /// NMEA 0183 sentences, as satellite receivers send them.
    Nmea,
    /// Lines of text.
    Text,
    /// Bytes that fit nothing: another protocol, or the wrong speed.
    Noise,
    /// No byte.
    Silence,
}

impl Protocol {
    /// Its name for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mavlink2 => "MAVLink 2",
            Self::Mavlink1 => "MAVLink 1",
            Self::Nxt => "NXT telegrams",
            Self::Ev3 => "EV3 telegrams",
            Self::Nmea => "NMEA 0183",
            Self::Text => "lines of text",
            Self::Noise => "noise",
            Self::Silence => "silence",
        }
    }

    /// The row of [`crate::bricks::BRICKS`] that would read it, if this program has it; `None` for what no robot speaks.
    #[must_use]
    pub const fn codec(self) -> Option<&'static str> {
        match self {
            Self::Mavlink2 | Self::Mavlink1 => Some("mavlink"),
            Self::Nxt => Some("nxt"),
            Self::Ev3 => Some("ev3"),
            Self::Text => Some("line"),
            Self::Nmea | Self::Noise | Self::Silence => None,
        }
    }

    /// True if each frame proves itself by a checksum, so that a few of them leave no doubt.
    #[must_use]
    pub const fn is_checked(self) -> bool {
        matches!(self, Self::Mavlink2 | Self::Mavlink1 | Self::Nmea)
    }

    /// True for everything but noise and silence.
    #[must_use]
    pub const fn is_known(self) -> bool {
        !matches!(self, Self::Noise | Self::Silence)
    }
}

/// What was recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recognised {
    /// The protocol.
    pub protocol: Protocol,
    /// Whole frames, telegrams, sentences or lines; 0 for noise and silence.
    pub frames: usize,
    /// Bytes of these, out of all that was heard.
    pub frame_bytes: usize,
}

/// Whole units of one protocol among the bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Tally {
    frames: usize,
    bytes: usize,
}

impl Tally {
    const fn add(&mut self, bytes: usize) {
        self.frames += 1;
        self.bytes += bytes;
    }

    const fn of(self, protocol: Protocol) -> Recognised {
        Recognised { protocol, frames: self.frames, frame_bytes: self.bytes }
    }
}

/// Guesses the protocol of `bytes`, in the order in which they came; datagrams one behind the other.
#[must_use]
pub fn recognise(bytes: &[u8]) -> Recognised {
    if bytes.is_empty() {
        return Tally::default().of(Protocol::Silence);
    }
    let (v1, v2) = mavlink(bytes);
    if v2.frames > 0 && v2.bytes >= v1.bytes {
        return v2.of(Protocol::Mavlink2);
    }
    if v1.frames >= 2 || 2 * v1.bytes > bytes.len() {
        return v1.of(Protocol::Mavlink1);
    }
    let nmea = nmea_sentences(bytes);
    if nmea.frames > 0 {
        return nmea.of(Protocol::Nmea);
    }
    if let Some((protocol, tally)) = telegrams::recognise(bytes) {
        return tally.of(protocol);
    }
    match text_lines(bytes) {
        Some(lines) => lines.of(text_protocol(bytes)),
        None => Tally::default().of(Protocol::Noise),
    }
}

/// Frames of MAVLink 1 and of MAVLink 2 whose checksum matches.
fn mavlink(bytes: &[u8]) -> (Tally, Tally) {
    let mut scanner = Scanner::new(ScannerConfig { accept_v1: true, ..ScannerConfig::default() });
    let (mut v1, mut v2) = (Tally::default(), Tally::default());
    scanner.push(Stamp::ZERO, bytes, &mut |found| {
        if let Scanned::Frame(frame) = found {
            match frame.version {
                WireVersion::V1 => v1.add(frame.raw.len()),
                WireVersion::V2 => v2.add(frame.raw.len()),
            }
        }
    });
    (v1, v2)
}

/// Sentences whose checksum matches.
fn nmea_sentences(bytes: &[u8]) -> Tally {
    let mut tally = Tally::default();
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
fn text_lines(bytes: &[u8]) -> Option<Tally> {
    let is_text = |byte: &&u8| is_printable(**byte) || b"\r\n\t".contains(*byte);
    let text_bytes = bytes.iter().filter(is_text).count();
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let whole = bytes.iter().rposition(|byte| *byte == end)? + 1;
    (20 * text_bytes >= 19 * bytes.len())
        .then_some(Tally { frames: memchr::memchr_iter(end, bytes).count(), bytes: whole })
}

/// Text, or an EV3 that announces itself by UDP in lines of text (LEGO MINDSTORMS EV3 Communication Developer Kit, WiFi).
fn text_protocol(bytes: &[u8]) -> Protocol {
    const ANNOUNCEMENT: &[u8] = b"Protocol: EV3";
    let announces = bytes.windows(ANNOUNCEMENT.len()).any(|window| window == ANNOUNCEMENT);
    if announces { Protocol::Ev3 } else { Protocol::Text }
}
