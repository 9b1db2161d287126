//! The protocols that can be detected, and the evidence for them.

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
    Unrecognized,
    /// No byte.
    NoData,
}

impl Protocol {
    /// Its name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mavlink2 => "MAVLink 2",
            Self::Mavlink1 => "MAVLink 1",
            Self::Nxt => "NXT telegrams",
            Self::Ev3 => "EV3 telegrams",
            Self::Nmea => "NMEA 0183",
            Self::Text => "lines of text",
            Self::Unrecognized => "noise",
            Self::NoData => "silence",
        }
    }

    /// The row of [`crate::bricks::BRICK_PROTOCOLS`] that would read it, if this program has it; `None` for what no robot speaks.
    pub const fn codec(self) -> Option<&'static str> {
        match self {
            Self::Mavlink2 | Self::Mavlink1 => Some("mavlink"),
            Self::Nxt => Some("nxt"),
            Self::Ev3 => Some("ev3"),
            Self::Text => Some("line"),
            Self::Nmea | Self::Unrecognized | Self::NoData => None,
        }
    }

    /// True if each frame proves itself by a checksum, so that a few of them leave no doubt.
    pub const fn is_checked(self) -> bool {
        matches!(self, Self::Mavlink2 | Self::Mavlink1 | Self::Nmea)
    }

    /// True for everything but noise and silence.
    pub const fn is_known(self) -> bool {
        !matches!(self, Self::Unrecognized | Self::NoData)
    }
}

/// What was recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProtocolDetection {
    /// The protocol.
    pub protocol: Protocol,
    /// Whole frames, telegrams, sentences or lines; 0 for noise and silence.
    pub frames: usize,
    /// Bytes of these, out of all that was heard.
    pub frame_bytes: usize,
}

/// Whole units of one protocol among the bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct UnitCounts {
    pub(super) frames: usize,
    pub(super) bytes: usize,
}

impl UnitCounts {
    pub(super) const fn add(&mut self, bytes: usize) {
        self.frames += 1;
        self.bytes += bytes;
    }

    pub(super) const fn detection(self, protocol: Protocol) -> ProtocolDetection {
        ProtocolDetection { protocol, frames: self.frames, frame_bytes: self.bytes }
    }
}
